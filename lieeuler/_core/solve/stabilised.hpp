// The linear systems of the stabilised Lagrangian methods on trees, in two parts instead of one of twice the size.
//
// Newton's system (7.2) of docs/theory.md for (du, dLam, dxi, dmu), with A = M - theta df/du, K the stiffness onto xi,
// N the slope of the velocity rows, and the theta and rho of generalized-alpha (h and 1 of implicit Euler), is
//
//   A du + h K dxi + G^T dLam = r_u        M (dxi - rho du) + Gn^T dmu = r_xi
//   G du + h N dxi            = r_lam      G T dxi                     = r_mu
//
// The equation on the upper right gives du. The others, with c = rho dLam + dmu, are coupled only by
// E = A M^-1 Gn^T - G^T = O(h):
//
//   [A + rho h K, G^T; G T, 0] (dxi, c) = (rho r_u + A M^-1 r_xi - E dmu, r_mu)
//   G M^-1 Gn^T dmu                     = rho r_lam + G M^-1 r_xi - (G + rho h N) dxi
//
// (G + rho h N) dxi differs from r_mu by O(h) dxi, which changes little from one step to the next. So dmu is well known
// beforehand, and a sweep over the two systems reduces the error by O(h^2).
//
// With bodies eliminated beforehand A + rho h K lacks the blocks of K that couple bodies, and those of springs. They
// are O(h^2) beside A, and what they add is subtracted in the same sweeps: K dxi beside E dmu. If they are too large
// for that, they are left to Newton's iteration, and the matrix is not exact.
//
// S at q_n, which differs by O(h), replaces S = G M^-1 Gn^T as long as each pass over the residual rows reduces them
// well.
#pragma once

#include "model/system.hpp"
#include "solve/delassus.hpp"

namespace lieeuler {

class StabilisedSolve {
 public:
  // `delassus` must hold the factored S of q_n when the iteration of a step begins. The shares are theta / h and rho.
  StabilisedSolve(const Plan& plan, Delassus& delassus, double force_share, double velocity_share)
      : plan_(plan),
        system_(plan.system),
        delassus_(delassus),
        force_share_(force_share),
        rho_(velocity_share),
        slopes_(2 * plan.count()),
        rows_(3 * plan.count(), 0.0),
        target_(rows_),
        correction_(rows_),
        mu_(rows_),
        core_rhs_(6 * system_.n() + rows_.size(), 0.0),
        total_(core_rhs_),
        velocity_(system_.n() + 1),
        response_(velocity_),
        balance_(velocity_),
        moved_(velocity_),
        pull_(velocity_),
        shift_(velocity_),
        guessed_(plan.count()),
        excess_(plan.count(), Vec3::Zero()) {}

  // Whether the sweeps converge by construction: without loops unless dependent rows are dropped, and without forces of
  // whose sizes nothing is known.
  static bool suits(const Plan& plan) {
    return plan.system.own.empty() && plan.plain() && plan.slips.empty() && (plan.forest || plan.independent);
  }

  // Sets the rows at the guess with u and T there, and the multipliers' columns at q_n.
  void linearise(const Constraints& joints, const Constraints& before, const std::vector<Twist>& u,
                 const std::vector<Mat3>& tangents, double h) {
    if (h != h_) forget();
    joints_ = &joints, before_ = &before, u_ = &u, tangents_ = &tangents, h_ = h;
    fresh_ = false;
  }
  // Whether the last solve had all blocks.
  bool exact() const { return exact_; }
  // Drops the guess that one step leaves for the next.
  void forget() { std::fill(excess_.begin(), excess_.end(), Vec3::Zero()); }
  // rho h N T for one side of a part that is not spherical.
  Rows& slope(int part, Side side) { return slopes_[2 * part + side]; }

  // Solves for the corrections: r becomes (du, dLam, dxi, dmu), laid out as in `nodes`. core(x) solves with the first
  // matrix; damping(u, balance) adds the dampers' part of (A - M) u to the balance; left_out(dxi, balance) subtracts
  // from the balance what rho h K dxi lacks there, if `incomplete`. `tolerance` is the rounding error of dxi, with
  // translations over `length`. False if the sweeps do not converge. The rows of position and velocity are satisfied in
  // any case: the first system contains the former, and dmu is solved last.
  template <class Core, class Damping, class LeftOut>
  bool solve(std::vector<double>& r, const Nodes& nodes, const Core& core, const Damping& damping,
             const LeftOut& left_out, bool incomplete, double length, double tolerance) {
    double coupling = kCaution * start(r, nodes, damping, length);
    double last = std::numeric_limits<double>::infinity(), pull = 0;
    double stiffness = last;
    exact_ = true;
    for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
      core(core_rhs_.data());
      for (size_t i = 0; i < total_.size(); ++i) total_[i] = sweep == 0 ? core_rhs_[i] : total_[i] + core_rhs_[i];
      if (!follow(tolerance * length)) return false;
      const double change = largest(correction_);
      const bool settled = coupling * change <= kRounding * tolerance;
      if (settled && !incomplete) return finish(r, nodes);
      if (incomplete) {
        const double motion = note_motion(length);
        if (settled && stiffness * motion <= kRounding * tolerance) return finish(r, nodes);
        std::fill(pull_.begin(), pull_.end(), Twist{});
        left_out(moved_, pull_);
        pull = size_of(pull_, length);
        stiffness = kCaution * pull / motion;
        if (!(pull < kSlow * motion)) incomplete = exact_ = pull == 0;
      }
      std::fill(core_rhs_.begin(), core_rhs_.end(), 0.0);
      const double left = couple(damping, length);
      coupling = std::max(coupling, kCaution * left / change);
      if (incomplete) add(pull_);
      if (left <= kRounding * tolerance && (!incomplete || pull <= kRounding * tolerance)) return finish(r, nodes);
      if (left > kRounding * tolerance && !(left < kSlow * last)) {
        if (!incomplete) return left <= kNoise * tolerance && finish(r, nodes);
        incomplete = exact_ = false;
      }
      last = left;
    }
    return false;
  }

 private:
  static constexpr int kMostSweeps = 12;
  static constexpr double kSlow = 0.3;
  static constexpr double kNoise = 1e3;   // times the tolerance; below it, changes that no longer shrink are rounding
  static constexpr double kCaution = 10;  // safety factor on the size of E, measured along one direction
  static constexpr double kStale = 0.01;  // a pass that reduces the rows less than this renews S
  static constexpr double kRounding = 4;  // times the tolerance: rounding error of the products of a sweep

  // A M^-1 y - y for one body, theta times the slope of the gyroscopic torque: rotations only. `rate` is M^-1 y.
  Vec3 gyroscopic(int b, const Vec3& y, const Vec3& rate) const {
    const Vec3& w = (*u_)[b].w;
    return force_share_ * h_ * (w.cross(y) - angular_momentum(system_.bodies[b], w).cross(rate));
  }
  static double largest(const std::vector<double>& values) {
    double size = 0;
    for (double value : values) size = std::max(size, std::abs(value));
    return size;
  }
  // Sets the first right-hand sides, with dmu for the (G + rho h N) dxi - r_mu of the last solve. Returns the size of
  // E, measured as M^-1 E dmu over dmu.
  template <class Damping>
  double start(const std::vector<double>& r, const Nodes& nodes, const Damping& damping, double length) {
    for (int b = 0; b < system_.n(); ++b) {
      const Twist own = load(&r[3 * nodes.v(b)]), drift = load(&r[3 * nodes.xi_v(b)]);
      shift_[b] = velocity(system_.bodies[b], drift);
      store(Twist{rho_ * own.v + drift.v, rho_ * own.w + drift.w + gyroscopic(b, drift.w, shift_[b].w)},
            &core_rhs_[6 * b]);
    }
    for (int k = 0; k < plan_.count(); ++k) {
      const Vec3 position = load3(&r[3 * nodes.mu(k)]), rate = load3(&r[3 * nodes.lam(k)]);
      store(position, &core_rhs_[6 * system_.n() + 3 * k]);
      guessed_[k] = position + excess_[k];
      store(Vec3(guessed_[k] - rho_ * rate - row_rate(k, shift_)), &rows_[3 * k]);
      excess_[k] = -position;
    }
    delassus_.zero_dropped(rows_.data());
    std::fill(balance_.begin(), balance_.end(), Twist{});
    if (damping(shift_, balance_)) add(balance_);
    std::fill(mu_.begin(), mu_.end(), 0.0);
    clear_correction();
    pass();
    accept_correction();
    const double multipliers = largest(correction_), coupled = couple(damping, length);
    return multipliers > 0 ? coupled / multipliers : std::numeric_limits<double>::infinity();
  }
  // Changes dmu for the latest change of dxi, in core_rhs_, beyond what was guessed for it, until the residual of the
  // rows is at most `wanted`, or rounding. False if S is singular.
  bool follow(double wanted) {
    for (int b = 0; b < system_.n(); ++b) velocity_[b] = load(&core_rhs_[6 * b]);
    velocity_[system_.n()] = Twist{};
    for (int k = 0; k < plan_.count(); ++k) {
      const Vec3 rate = row_rate(k, velocity_) + slope_rate(k);
      store(Vec3(load3(&rows_[3 * k]) + rate - guessed_[k]), &rows_[3 * k]);
      excess_[k] += rate;
      guessed_[k].setZero();
    }
    delassus_.zero_dropped(rows_.data());
    clear_correction();
    double last = largest(rows_);
    for (;;) {
      pass();
      const double left = largest(rows_);
      if (left <= wanted || fresh_) break;
      const bool stale = !(left <= kStale * last);  // a NaN too
      if (stale && left <= kRounding * wanted) break;
      if (stale && !renew()) return false;
      last = left;
    }
    accept_correction();
    return true;
  }
  // rho h N T dxi of one part, with dxi in velocity_.
  Vec3 slope_rate(int k) const {
    Vec3 rate = Vec3::Zero();
    for (Side side : kSides) {
      const int b = plan_.body(k, side);
      if (b == system_.n()) continue;
      if (plan_.part(k).spherical)
        rate += rho_ * h_ * state_of(k).anchor_rate_change(side, (*u_)[b].w, times((*tangents_)[b], velocity_[b].w));
      else
        rate += slopes_[2 * k + side].v * velocity_[b].v + slopes_[2 * k + side].w * velocity_[b].w;
    }
    return rate;
  }

  // Solves - S dmu = rows_ and adds dmu to the correction; rows_ becomes the residual.
  void pass() {
    target_ = rows_;
    delassus_.solve_rows(rows_.data(), flat(response_));
    for (size_t i = 0; i < rows_.size(); ++i) correction_[i] += rows_[i];
    for (int b = 0; b < system_.n(); ++b) velocity_[b] += response_[b];
    for (int k = 0; k < plan_.count(); ++k) store(Vec3(load3(&target_[3 * k]) - row_rate(k, response_)), &rows_[3 * k]);
    delassus_.zero_dropped(rows_.data());
  }
  bool renew() {
    delassus_.assemble(*joints_, *before_);
    fresh_ = true;
    return delassus_.lu().factor();
  }
  void clear_correction() {
    std::fill(correction_.begin(), correction_.end(), 0.0);
    std::fill(velocity_.begin(), velocity_.end(), Twist{});
  }
  // Adds correction_, a change of dmu, and velocity_, its - M^-1 Gn^T dmu.
  void accept_correction() {
    for (size_t i = 0; i < mu_.size(); ++i) mu_[i] += correction_[i];
    for (int b = 0; b < system_.n(); ++b) shift_[b] += velocity_[b];
  }
  // Adds - E times the latest change of dmu to the right-hand side; returns its size as a velocity.
  template <class Damping>
  double couple(const Damping& damping, double length) {
    std::fill(balance_.begin(), balance_.end(), Twist{});
    for (int k = 0; k < plan_.count(); ++k) {
      const Joint& joint = plan_.joint(k);
      state_of(k).subtract_reaction_change(plan_.part(k), (*before_)[plan_.parts[k]], load3(&correction_[3 * k]),
                                           balance_[joint.parent], balance_[joint.child]);
    }
    for (int b = 0; b < system_.n(); ++b) {
      const Twist change = balance_[b];
      const Vec3& rate = velocity_[b].w;
      balance_[b] = {-change.v, gyroscopic(b, times(system_.bodies[b].inertia, rate), rate) - change.w};
    }
    damping(velocity_, balance_);
    add(balance_);
    return size_of(balance_, length);
  }
  // Adds to the right-hand side.
  void add(const std::vector<Twist>& balance) {
    for (int b = 0; b < system_.n(); ++b)
      for (int i = 0; i < 3; ++i) core_rhs_[6 * b + i] += balance[b].v[i], core_rhs_[6 * b + 3 + i] += balance[b].w[i];
  }
  // The largest velocity that impulses give to bodies.
  double size_of(const std::vector<Twist>& impulses, double length) const {
    double size = 0;
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = system_.bodies[b];
      const Twist& p = impulses[b];
      size = std::max({size, p.v.cwiseAbs().maxCoeff() / (body.mass * length),
                       times(body.inertia_inverse, p.w).cwiseAbs().maxCoeff()});
    }
    return size;
  }
  // Keeps the latest change of dxi, in core_rhs_; returns its size.
  double note_motion(double length) {
    double size = 0;
    for (int b = 0; b < system_.n(); ++b) {
      moved_[b] = load(&core_rhs_[6 * b]);
      size = std::max(size, Scales{length}.rate_of(moved_[b]));
    }
    return size;
  }
  // du = (dxi - shift) / rho, dLam = (c - dmu) / rho.
  bool finish(std::vector<double>& r, const Nodes& nodes) {
    for (int k = 0; k < plan_.count(); ++k) {
      const Vec3 mu = load3(&mu_[3 * k]);
      store(mu, &r[3 * nodes.mu(k)]);
      store(Vec3((load3(&total_[6 * system_.n() + 3 * k]) - mu) / rho_), &r[3 * nodes.lam(k)]);
    }
    for (int b = 0; b < system_.n(); ++b) {
      const Twist xi = load(&total_[6 * b]);
      store(xi, &r[3 * nodes.xi_v(b)]);
      store((xi - shift_[b]) / rho_, &r[3 * nodes.v(b)]);
    }
    return true;
  }

  const JointState& state_of(int k) const { return (*joints_)[plan_.parts[k]]; }
  // The rows of one part applied to velocities.
  Vec3 row_rate(int k, const std::vector<Twist>& u) const { return joints_->velocity(plan_.parts[k], u); }

  const Plan& plan_;
  const System& system_;
  Delassus& delassus_;
  const Constraints *joints_ = nullptr, *before_ = nullptr;
  const std::vector<Twist>* u_ = nullptr;
  const std::vector<Mat3>* tangents_ = nullptr;
  const double force_share_, rho_;
  double h_ = 0;
  bool fresh_ = false;  // S is that of this iteration
  bool exact_ = true;
  std::vector<Rows> slopes_;
  std::vector<double> rows_, target_;  // residual of - S dmu, now and before the last pass
  std::vector<double> correction_, mu_, core_rhs_, total_;
  std::vector<Twist> velocity_, response_, balance_;
  std::vector<Twist> moved_, pull_;  // change of dxi, and what rho h K dxi lacks for it
  std::vector<Twist> shift_;         // dxi - rho du = M^-1 (r_xi - Gn^T dmu)
  std::vector<Vec3> guessed_;        // guess of (G + rho h N) dxi, until the first sweep has computed it
  std::vector<Vec3> excess_;         // (G + rho h N) dxi - r_mu
};

}  // namespace lieeuler
