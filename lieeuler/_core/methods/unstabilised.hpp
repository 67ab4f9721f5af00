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
    for (int k = 0; k < nodes.parts(); ++k)
      store(by_position(k) ? Vec3(here(k).position(plan.part(k)) / h) : velocity_rows(k, state), &r[3 * nodes.lam(k)]);
    if (has_others) put_others(r, level == Level::position);
    return Status::success;
  }
  bool exact_matrix() const override { return !incomplete(); }

 private:
  bool by_position(int k) const { return level == Level::position && !plan.part(k).slips; }
  void put_rows(int k, Side side, const Rows& G) override {
    if (by_position(k)) return part_blocks[2 * k + side].put_rows(G.v, G.w * tangents[plan.body(k, side)]);
    put_rates(k, side, G, rate_slope(k, side));
  }
  // With independent rows the matrix is not exact; Newton's iteration corrects the coupling of bodies that it lacks.
  static bool eliminates(const Plan& plan, Level level) {
    if (plan.independent) return level == Level::position && sweeps_converge(plan) && !plan.system.damped();
    return is_spherical_tree(plan);
  }
  bool fill_core() override {
    if (level == Level::position) return LagrangeEquations::fill_core();
    struct VelocityRows {
      const UnstabilisedEquations& at;
      Mat3 rotations(const Delassus::Place& place, const Mat3& G) const {
        const Mat3 N = at.joints[place.joint].anchor_rate_slope(place.side, at.state.u[place.body].w);
        return G + at.h * N * at.tangents[place.body];
      }
      Rows rows(const Delassus::Place& place, const Rows& G) const { return {G.v, rotations(place, G.w)}; }
    };
    return LagrangeEquations::fill_core(VelocityRows{*this});
  }
};

// Rows of acceleration, with Baumgarte's feedback.
class AccelerationEquations : public LagrangeEquations {
 public:
  AccelerationEquations(const Plan& plan, CoordinateMap map, bool index1_output, Gains gains)
      : LagrangeEquations(plan, map, Level::acceleration, index1_output,
                          {.solves_velocities = true, .second_order = true}),
        gains_(gains) {}

  Status residual(std::vector<double>& r) override {
    if (!configure()) return Status::map_domain;
    put_balance(r);
    const double twice_alpha = 2 * gains_.alpha, square = gains_.beta * gains_.beta;
    const auto position = [&](int k) { return here(k).position(plan.part(k)); };
    for (int k = 0; k < nodes.parts(); ++k) {
      const Vec3 rate = velocity_rows(k, state), change = rate - velocity_rows(k, start);
      store(Vec3(change + h * (joints.gamma(plan.parts[k], state.u) + twice_alpha * rate + square * position(k))),
            &r[3 * nodes.lam(k)]);
    }
    if (!has_others) return Status::success;
    for (const PlacedMimic& mimic : plan.mimics)  // angles differ by whole turns, which beta must not feel
      r[3 * nodes.lam(mimic.follower)] += h * gains_.beta * gains_.beta *
                                          (gap(plan, mimic, joints, start.angles) - position(mimic.follower)[0] +
                                           mimic.ratio * position(mimic.leader)[0]);
    put_others(r, false);
    return Status::success;
  }
  bool exact_matrix() const override { return false; }

 private:
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
  bool accelerates() const override { return true; }

  const Gains gains_;
};

}  // namespace lieeuler
