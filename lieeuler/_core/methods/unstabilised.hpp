// Lagrangian methods that hold one level of the constraints, reconstructed from doi:10.1177/1687814019842406 and
// doi:10.1177/1687814018764154, (4.1) and (4.5) of docs/theory.md, with xi = u:
//
//   position      Phi(q) = 0, of slips as velocity                                     DAE3L_LE
//   velocity      G u = 0                                                              DAE2L_LE
//   acceleration  G a + gamma + 2 alpha G u + beta^2 Phi = 0,   a = (u - u_n) / h      INDEX1_LE, BAUMGARTE_LE
//
// Unknowns: u of each body, Lam of each joint. Newton's matrix is (7.1) of docs/theory.md.
#pragma once

#include "methods/euler_lagrange.hpp"

namespace lieeuler {

// Rows of position, or of velocity.
class UnstabilisedEquations : public LagrangeEquations {
 public:
  UnstabilisedEquations(const Plan& plan, CoordinateMap map, Level level, bool index1_output)
      : LagrangeEquations(plan, map, level, index1_output,
                          {.solves_velocities = level != Level::position,
                           .second_order = true,
                           .eliminates = eliminates(plan, level)}) {}

  Status residual(std::vector<double>& r) override {
    if (!configure()) return Status::map_domain;
    put_balance(r);
    for (int k = 0; k < nodes.parts(); ++k) store(rows(k), &r[3 * nodes.lam(k)]);
    if (has_others) put_others(r);
    return Status::success;
  }
  bool exact_matrix() const override { return !incomplete(); }

 protected:
  // The rows that belong to Lam; positions are divided by h.
  virtual Vec3 rows(int k) const {
    return by_position(k) ? Vec3(here(k).position(plan.part(k)) / h) : velocity_rows(k, state);
  }
  void put_rows(int k, Side side, const Rows& G) override {
    if (by_position(k)) return part_blocks[2 * k + side].put_rows(G.v, G.w * tangents[plan.body(k, side)]);
    put_rates(k, side, G, rate_slope(k, side));
  }
  // The rows of mimics and rotors.
  [[gnu::noinline, gnu::cold]] virtual void put_others(std::vector<double>& r) const {
    unite_rows(&z[3 * nodes.lam(0)], &r[3 * nodes.lam(0)], level == Level::position);
    put_rotors(r);
  }

 private:
  bool by_position(int k) const { return level == Level::position && !plan.part(k).slips; }
  // With independent rows the matrix is not exact; Newton's iteration corrects the coupling of bodies that it lacks.
  static bool eliminates(const Plan& plan, Level level) {
    if (level == Level::acceleration) return false;
    if (plan.independent) return level == Level::position && sweeps_converge(plan) && !plan.system.damped();
    return is_spherical_tree(plan);
  }
  bool fill_core() override {
    if (level == Level::position) return LagrangeEquations::fill_core();
    struct VelocityRows {
      const UnstabilisedEquations& at;
      Mat3 rotations(const Delassus::Place& place, const Mat3& G) const {
        return G + at.rate_slope(place.part, place.side).w;
      }
      Rows rows(const Delassus::Place& place, const Rows& G) const { return {G.v, rotations(place, G.w)}; }
    };
    return LagrangeEquations::fill_core(VelocityRows{*this});
  }
};

// Rows of acceleration, with Baumgarte's feedback.
class AccelerationEquations : public UnstabilisedEquations {
 public:
  AccelerationEquations(const Plan& plan, CoordinateMap map, bool index1_output, Gains gains)
      : UnstabilisedEquations(plan, map, Level::acceleration, index1_output), gains_(gains) {}

  bool exact_matrix() const override { return false; }

 protected:
  Vec3 rows(int k) const override {
    const Vec3 rate = velocity_rows(k, state), before = velocity_rows(k, start);
    return (rate - before) + h * (joints.gamma(plan.parts[k], state.u) + 2 * gains_.alpha * rate +
                                  gains_.beta * gains_.beta * here(k).position(plan.part(k)));
  }
  // Third derivatives of Phi are left out: they are O(h^2), and the iteration still solves the exact equations.
  void put_rows(int k, Side side, const Rows& G) override {
    const double feedback = 2 * gains_.alpha + h * gains_.beta * gains_.beta;
    const SideBlocks& blocks = part_blocks[2 * k + side];
    if (plan.part(k).spherical) {  // only the body's own turn changes its side
      const int b = plan.body(k, side);
      const Mat3 N = here(k).anchor_rate_slope(side, state.u[b].w - start.u[b].w) +
                     here(k).anchor_second_slope(side, state.u[b].w);
      return blocks.put_rows(G.v + h * (feedback * G.v), G.w + h * (N + feedback * G.w));
    }
    const int i = plan.body(k, kParent), j = plan.body(k, kChild);
    const Rows first = here(k).velocity_slope(plan.part(k), side, state.u[i] - start.u[i], state.u[j] - start.u[j],
                                              false);  // d(G h a)/dq
    const Rows second = velocity_slope(k, side, state.u, true);
    blocks.put_rows(G.v + h * (first.v + second.v + feedback * G.v), G.w + h * (first.w + second.w + feedback * G.w));
  }
  double rotor_gain(int k) const override { return accelerated_gain(k); }
  std::pair<Rows, Rows> rotor_slopes(int k, Side side) const override { return accelerated_slopes(k, side); }
  // Angles differ by whole turns, which beta must not feel.
  void put_others(std::vector<double>& r) const override {
    const auto coordinate = [&](int k) { return here(k).position(plan.part(k))[0]; };
    for (const PlacedMimic& mimic : plan.mimics)
      r[3 * nodes.lam(mimic.follower)] += h * gains_.beta * gains_.beta *
                                          (gap(plan, mimic, joints, start.angles) - coordinate(mimic.follower) +
                                           mimic.ratio * coordinate(mimic.leader));
    UnstabilisedEquations::put_others(r);
  }

 private:
  const Gains gains_;
};

}  // namespace lieeuler
