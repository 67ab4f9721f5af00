// Projection of a state onto Phi = 0 and G u = 0, by the least change in the metric of the masses, (10.2) of
// docs/theory.md:
//
//   q <- q * d,  M d + G^T mu = 0,  G d = -Phi      repeated with one matrix (simplified Newton)
//   u <- M^-1 (M u - G^T nu),       G u = 0         at the new q
//
// then (a, lam) of the index-1 system there. The saddle-point solver treats redundant rows by their null space.
#pragma once

#include "solve/saddle_solver.hpp"
#include "solve/status.hpp"

namespace lieeuler {

class Projection {
 public:
  explicit Projection(const Plan& plan) : plan_(plan), saddle_(plan, plan.independent) {}
  Projection(const Projection&) = delete;

  // Counts the redundant rows at the start of a run and factors the matrix there.
  Status start(const State& state) {
    joints_.update(state.frames);
    rank_confirmed_ = false;
    if (!saddle_.find_redundancy(joints_)) return Status::singular_matrix;
    return factor();
  }
  // Fails if the rank is higher here than at the start, which then was a singular position. Leaves the matrix factored.
  // What it has confirmed it asks no more.
  Status confirm_rank() {
    const int expected = redundant_rows();
    int found;
    if (expected == 0 || rank_confirmed_) return Status::success;
    if (!saddle_.count_redundancy(joints_, found) || found < expected) return Status::singular_matrix;
    rank_confirmed_ = true;
    return factor();
  }

  // Evaluates the joints at `state`, to which they refer until the next call.
  void move_to(const State& state) { joints_.update(state.frames); }
  Status factor(bool on_constraints = true) {
    return saddle_.factor(joints_, on_constraints) ? Status::success : Status::singular_matrix;
  }

  // Projects from a matrix of its own. length: the size of the system, m. accelerates: whether to solve for (a, lam),
  // which accelerate_here() does else.
  Status project(State& state, double length, Counters& counters, bool accelerates = true) {
    move_to(state);
    ++counters.factorizations;
    if (const Status status = factor(false); status != Status::success) return status;
    return settle(state, length, counters, accelerates);
  }

  // Projects with the matrix factored last, at a nearby configuration, and factors it at the result.
  Status settle(State& state, double length, Counters& counters, bool accelerates = true) {
    if (const Status status = close(state, length); status != Status::success) return status;
    update_angles(system_, state.frames, state.u, state.angles);
    ++counters.factorizations;
    if (const Status status = factor(); status != Status::success) return status;
    saddle_.project(joints_, state.u);
    if (!accelerates) return Status::success;
    ++counters.force_evaluations;
    accelerate_here(state);
    return Status::success;
  }
  // Solves for (a, lam) at the state projected last.
  void accelerate_here(State& state) { saddle_.accelerate(joints_, state); }

  // Factors the matrix and solves for (a, lam) of the index-1 system; `state` need only be near the constraints.
  Status accelerate(State& state) {
    move_to(state);
    if (const Status status = factor(false); status != Status::success) return status;
    saddle_.accelerate(joints_, state);
    return Status::success;
  }

  // Gives `state` the least-norm multipliers of all rows, if some rows were left out of the solve.
  void make_least_norm(State& state) {
    move_to(state);
    saddle_.make_least_norm(joints_, state.lam);
  }

  const Constraints& joints() const { return joints_; }
  SaddleSolver& saddle() { return saddle_; }
  int redundant_rows() const { return saddle_.redundant(); }
  // That of the joints that close loops; it goes to zero at a singular position.
  double smallest_pivot() { return saddle_.smallest_pivot(); }

 private:
  static constexpr double kNoisyTerms = 8;  // rounding errors in a row of Phi: x, R s, differences and products
  static constexpr int kMostIterations = 12;

  // Corrects positions and attitudes until Phi = 0 and attitudes are orthogonal, to rounding.
  Status close(State& state, double length) {
    double last = 1;  // sizes are parts of the length and radians: a first correction of 1e-8 leaves 1e-16
    for (int k = 0; k < kMostIterations; ++k) {
      move_to(state);
      saddle_.displace(joints_, state.angles, change_);
      double size = 0, sum = 0;
      for (int b = 0; b < system_.n(); ++b) {
        size = std::max(size, Scales{length}.rate_of(change_[b]));
        sum += change_[b].v.sum() + change_[b].w.sum();
      }
      if (!std::isfinite(sum)) return Status::non_finite;  // max() above would hide a NaN
      if (k > 0 && size > kNoise && size > 0.5 * last) {
        if (!closed(state)) return Status::newton_failed;
        break;  // near a singular position the correction is the magnified rounding error of Phi
      }
      apply(state);
      if (size <= kFloor || (k > 0 && (size * size <= kFloor * last || size <= kNoise))) break;
      if (k + 1 == kMostIterations) return Status::newton_failed;
      last = size;
    }
    move_to(state);
    return Status::success;
  }
  // Whether Phi is the rounding error of its positions and axes.
  bool closed(const State& state) const {
    for (const PlacedMimic& mimic : plan_.mimics)
      if (std::abs(gap(plan_, mimic, joints_, state.angles)) > kNoisyTerms * kEps * std::numbers::pi) return false;
    for (size_t j = 0; j < system_.joints.size(); ++j) {
      const JointState& here = joints_[static_cast<int>(j)];
      for (const Part& part : system_.joints[j].constraints())
        if ((here.position(part).cwiseAbs() - kNoisyTerms * kEps * here.terms(part)).maxCoeff() > 0) return false;
    }
    return true;
  }
  // Applies the correction to first order. It changes R^T R - I by its square, which the next polish removes.
  void apply(State& state) {
    for (int b = 0; b < system_.n(); ++b) {
      Frame& frame = state.frames[b];
      frame.x += change_[b].v;
      frame.R = polished(frame.R + frame.R * hat(change_[b].w));
    }
  }

  const Plan& plan_;
  const System& system_ = plan_.system;
  Constraints joints_{system_};
  SaddleSolver saddle_;
  std::vector<Twist> change_ = std::vector<Twist>(system_.n() + 1);
  bool rank_confirmed_ = false;
};

}  // namespace lieeuler
