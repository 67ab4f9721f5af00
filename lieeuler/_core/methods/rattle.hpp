// RATTLE on the group, (9.1) of docs/theory.md: the step of methods/euler_hamilton.hpp with h/2 before f_app (and in
// Lam), and p <- p + h/2 f_app(q, xi) before the projection. It is symmetric and of second order. For the rows of slip
// it takes (A(q_n) + A(q)) xi = 0, and A M^-1 p = 0 after the projection. And its compositions.
#pragma once

#include "linalg/compensated.hpp"
#include "methods/euler_hamilton.hpp"

namespace lieeuler {

class RattleEquations : public HamiltonEquations {
 public:
  RattleEquations(const Plan& plan, CoordinateMap map) : HamiltonEquations(plan, map, Level::stabilised, true, 0.5) {}

  Status begin() override {
    carried_.assign(system.n(), {});
    return HamiltonEquations::begin();
  }
  Status finish() override {
    const Status status = HamiltonEquations::finish();
    owes_output = index1_output;
    return status;
  }

 protected:
  // In the mean of the two configurations of the step, by the velocity that leads from one to the other, which is
  // symmetric in them.
  Vec3 slip_rows(int k) const override {
    return 0.5 * (start_joints.velocity(plan.parts[k], xi) + joints.velocity(plan.parts[k], xi));
  }
  Rows slip_slope(int k, Side side, const Rows& G) const override {
    const Rows N = velocity_slope(k, side, xi, false), G_n = before(k).jacobian(plan.part(k), side);
    return {0.5 * (G.v + G_n.v + h * N.v), 0.5 * (G.w + G_n.w + h * N.w * tangents[plan.body(k, side)])};
  }
  // A composition has up to fifteen steps, so frames and momenta are added with compensated sums. Computes the change
  // of the momentum before the projection, and the momentum to be projected.
  void complete() override {
    std::fill(change_.begin(), change_.end(), Twist{});
    for (int k = 0; k < nodes.parts(); ++k)
      start_joints.subtract_reaction(plan.parts[k], load3(&z[3 * nodes.lam(k)]), change_);
    for (int b = 0; b < system.n(); ++b) {
      const Mat3 turn = maps[b].turn();
      state.frames[b] = start.frames[b];
      carried_[b].frame.move(state.frames[b], h * xi[b].v, turn);
      Vec3& lost = carried_[b].momentum.w;
      lost += transposed_times(turn, lost);
      change_[b].v += impulse_time() * force[b].v;
      change_[b].w += impulse_time() * force[b].w + transposed_times(turn, impulse_[b].w);
    }
    applied_forces(system, state.frames, xi, start.angles, force);
    for (int b = 0; b < system.n(); ++b) {
      change_[b] += impulse_time() * force[b];
      impulse_[b] = momentum_[b] + change_[b];
      state.u[b] = velocity_of(system.bodies[b], impulse_[b]);
    }
    evaluate_joints();
  }
  void project() override {
    saddle.project(joints, impulse_, state.u, mu_.data(), change_, rates_);
    for (int b = 0; b < system.n(); ++b) add_compensated(momentum_[b], change_[b], carried_[b].momentum);
  }

 private:
  // The rounding errors of a body's position, attitude and momentum.
  struct Carried {
    CompensatedFrame frame;
    Twist momentum;
  };
  std::vector<Carried> carried_;
  std::vector<Twist> change_ = xi;
};

// Symmetric compositions of RATTLE, (9.2) of docs/theory.md: successive steps of weights[0] h, weights[1] h, ...
class CompositionStepper : public NewtonStepper {
 public:
  CompositionStepper(const Plan& plan, CoordinateMap map, std::vector<double> weights)
      : NewtonStepper(std::make_unique<RattleEquations>(plan, map)),
        weights_(std::move(weights)),
        predictors_(weights_.size()) {}

  Status start(const State& state, double h) {
    whole_step_ = h;
    const Status status = NewtonStepper::start(state, h);
    // Each stage is guessed from the same stage of earlier steps: from one stage to the next nothing is smooth.
    for (Predictor& predictor : predictors_) predictor.reset(unknowns());
    return status;
  }

  Status step(Counters& counters) {
    at.state.frames.begin_step(whole_step_);
    for (size_t i = 0; i < weights_.size(); ++i) {
      at.index1_output = i + 1 == weights_.size();  // (a, lam) only at the end of the step
      const Status status = advance(weights_[i] * whole_step_, predictors_[i], counters);
      if (status != Status::success) return status;
    }
    ++counters.steps;
    return Status::success;
  }
  Status cross() { return at_jump() ? start(State(state()), whole_step_) : Status::success; }

 private:
  std::vector<double> weights_;
  std::vector<Predictor> predictors_;
  double whole_step_ = 0;
};

}  // namespace lieeuler
