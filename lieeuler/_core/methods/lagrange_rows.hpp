// The rows of a Lagrangian Euler step (methods/euler_lagrange.hpp), each beside its derivatives: those of the
// constraints at the step's level, of mimics, and of rotors.
#pragma once

#include <optional>

#include "methods/euler.hpp"
#include "methods/generalized_alpha.hpp"

namespace lieeuler {

struct Gains {
  double alpha = 0, beta = 0;  // 1/s
};

template <class Map>
class LagrangeStepper;

template <class Map>
class LagrangeRows : public EulerStepper<LagrangeStepper<Map>, Map> {
  using Base = EulerStepper<LagrangeStepper<Map>, Map>;

 protected:
  LagrangeRows(const Plan& plan, Level level, bool index1_output, const Layout& layout, Gains gains,
               const std::optional<GeneralizedAlpha>& alpha)
      : Base(plan, level, index1_output, layout),
        gains_(gains),
        alpha_(alpha),
        force_share_(alpha_ ? alpha_->force_share() : 1),
        velocity_share_(alpha_ ? alpha_->velocity_share() : 1),
        turned_(system_.n() + 1) {
    for (int k = 0; k < nodes_.parts(); ++k) {
      const Part& part = this->part_of(k);
      knows_left_out_ = knows_left_out_ && !part.contact;
      if (part.spherical || part.turn) continue;
      const bool grounded = this->body_of(k, kParent) == system_.n() || this->body_of(k, kChild) == system_.n();
      if (!grounded || !AxisRows::suits(part)) coupled_.push_back(k);
    }
  }

  using Base::h_, Base::joints_, Base::level_, Base::nodes_, Base::plan_, Base::start_, Base::state_, Base::system_;

  bool stabilised() const { return level_ == Level::stabilised; }
  // theta: the time for which a force acts in a step.
  double force_time() const { return force_share_ * h_; }

  // The rows that belong to Lam; positions are divided by h.
  Vec3 constraint_residual(int k) const {
    const Part& part = this->part_of(k);
    if (level_ == Level::position && !part.slips) return this->here(k).position(part) / h_;
    const Vec3 rate = this->velocity_rows(k, state_, this->here(k));
    if (level_ != Level::acceleration) return rate;
    const Twist &parent = state_.u[this->body_of(k, kParent)], &child = state_.u[this->body_of(k, kChild)];
    const Vec3 before = this->velocity_rows(k, start_, this->here(k));
    return (rate - before) + h_ * (this->here(k).gamma(part, parent, child) + 2 * gains_.alpha * rate +
                                   gains_.beta * gains_.beta * this->here(k).position(part));
  }
  // Derivative of the velocity or acceleration rows with respect to xi, without G itself. At the acceleration level the
  // third derivatives of Phi are left out: they are O(h^2), and the iteration still solves the exact equations.
  Rows rate_slope(int k, Side side, const Rows& G, const Mat3& T) const {
    const int i = this->body_of(k, kParent), j = this->body_of(k, kChild);
    const JointState& joint = this->here(k);
    const Part& part = this->part_of(k);
    if (level_ != Level::acceleration) {
      const Rows N = joint.velocity_slope(part, side, state_.u[i], state_.u[j], false);
      return {h_ * N.v, h_ * N.w * T};
    }
    auto change = [&](int b) { return Twist{state_.u[b].v - start_.u[b].v, state_.u[b].w - start_.u[b].w}; };
    const Rows first = joint.velocity_slope(part, side, change(i), change(j), false);  // d(G h a)/dq
    const Rows second = joint.velocity_slope(part, side, state_.u[i], state_.u[j], true);
    const double feedback = 2 * gains_.alpha + h_ * gains_.beta * gains_.beta;
    return {h_ * (first.v + second.v + feedback * G.v), h_ * (first.w + second.w + feedback * G.w)};
  }

  // Completes the rows of mimics, rotors and slip. Not inlined: systems without them would pay for it.
  [[gnu::noinline, gnu::cold]] void complete_others(const std::vector<double>& z, std::vector<double>& r) const {
    if (!plan_.mimics.empty()) unite(z, r);
    for (int k : plan_.rotors) {
      r[3 * nodes_.lam(k)] = rotor_gain(k) - this->part_of(k).compliance * z[3 * nodes_.lam(k)];
      if (stabilised()) r[3 * nodes_.mu(k)] = z[3 * nodes_.mu(k)];
    }
    for (int k : plan_.slips)
      if (stabilised()) store(load3(&z[3 * nodes_.mu(k)]), &r[3 * nodes_.mu(k)]);
  }
  // Combines the rows of followers and leaders. Angles differ by whole turns, which beta must not feel.
  void unite(const std::vector<double>& z, std::vector<double>& r) const {
    const double restoring = level_ == Level::acceleration ? h_ * gains_.beta * gains_.beta : 0;
    for (const PlacedMimic& mimic : plan_.mimics) {
      const auto coordinate = [&](int k) { return this->here(k).position(this->part_of(k))[0]; };
      r[3 * nodes_.lam(mimic.follower)] +=
          restoring * (gap(plan_, mimic, joints_, start_.angles) - coordinate(mimic.follower) +
                       mimic.ratio * coordinate(mimic.leader));
    }
    this->unite_rows(&z[3 * nodes_.lam(0)], &r[3 * nodes_.lam(0)], level_ == Level::position);
    if (stabilised()) this->unite_rows(&z[3 * nodes_.mu(0)], &r[3 * nodes_.mu(0)], true);
  }

  // A matrix with the bodies eliminated leaves out of K, the derivative of reactions and forces by positions, what
  // couples bodies or rotations with translations. Whether subtract_left_out() has all of it.
  bool knows_left_out() const { return knows_left_out_; }
  // balance -= h K T xi, with what is left out of K.
  void subtract_left_out(const std::vector<Twist>& xi, const std::vector<Mat3>& tangents, std::vector<Twist>& balance) {
    for (int b = 0; b < system_.n(); ++b) turned_[b] = {xi[b].v, times(tangents[b], xi[b].w)};
    for (int k : coupled_) {
      const int parent = this->body_of(k, kParent), child = this->body_of(k, kChild);
      const Vec3 impulse = h_ * load3(&this->z_[3 * nodes_.lam(k)]);
      for (Side side : kSides) {
        Twist& own = balance[this->body_of(k, side)];
        const Twist change =
            this->here(k).coupled_reaction(this->part_of(k), side, impulse, turned_[parent], turned_[child]);
        own.v -= change.v, own.w -= change.w;
      }
    }
    for (size_t k = 0; k < system_.forces.size(); ++k) {
      const Force& force = system_.forces[k];
      const ForceState here(force, state_.frames, state_.u, start_.angles[k]);
      for (Side row : kSides)
        for (Side column : kSides) {
          const Stiffness K = here.by_position(row, column);
          const Twist& turn = turned_[column == kChild ? force.child : force.parent];
          Twist& own = balance[row == kChild ? force.child : force.parent];
          own.v += h_ * h_ * (K.vv * turn.v + K.vw * turn.w), own.w += h_ * h_ * (K.wv * turn.v + K.ww * turn.w);
        }
    }
  }

  // The change of a rotor's rate in the step: s (u - u_n) + h (ds/dt) u if the method takes accelerations at the new
  // state, else the difference of the rates at the two states.
  bool gains_by_derivative() const { return level_ == Level::acceleration || alpha_; }
  double rotor_gain(int k) const {
    const int i = this->body_of(k, kParent), j = this->body_of(k, kChild);
    const Part& part = this->part_of(k);
    const double rate = this->here(k).velocity(part, state_.u[i], state_.u[j])[0];
    if (!gains_by_derivative()) return rate - this->before(k).velocity(part, start_.u[i], start_.u[j])[0];
    const Twist parent = from(i), child = from(j);
    return rate - this->here(k).velocity(part, parent, child)[0] +
           force_time() * this->here(k).gamma(part, state_.u[i], state_.u[j])[0];
  }
  // The velocity from which u changes: u_n, or that of generalized-alpha; zero for the ground.
  Twist from(int b) const { return alpha_ ? (b == system_.n() ? Twist{} : alpha_->from(b)) : start_.u[b]; }
  // Derivatives of rotor_gain() with respect to u and xi; with accelerations, second derivatives of s are left out.
  std::pair<Rows, Rows> rotor_slopes(int k, Side side, const Mat3& T) const {
    const Twist &parent = state_.u[this->body_of(k, kParent)], &child = state_.u[this->body_of(k, kChild)];
    const JointState& joint = this->here(k);
    const Part& part = this->part_of(k);
    Rows by_u = joint.jacobian(part, side), by_xi;
    const Rows N = joint.velocity_slope(part, side, parent, child, gains_by_derivative());
    if (gains_by_derivative())
      by_u.v += force_time() * N.v, by_u.w += force_time() * N.w;
    else
      by_xi = {h_ * N.v, h_ * N.w * T};
    return {by_u, by_xi};
  }

  const Gains gains_;
  std::optional<GeneralizedAlpha> alpha_;
  const double force_share_, velocity_share_;  // theta / h and rho; 1 for implicit Euler

 private:
  std::vector<int> coupled_;  // parts with something left out
  bool knows_left_out_ = true;
  std::vector<Twist> turned_;  // T xi
};

}  // namespace lieeuler
