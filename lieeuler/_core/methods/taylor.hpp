// Taylor series integration of the index-1 system, after Jorba and Zou, doi:10.1080/10586458.2005.10128904; the step is
// (12.2) of docs/theory.md.
#pragma once

#include "methods/motion_series.hpp"
#include "methods/turning.hpp"
#include "run/watch.hpp"
#include "solve/free_bodies.hpp"
#include "solve/projection.hpp"
#include "solve/small_schur.hpp"
#include "solve/step_control.hpp"

namespace lieeuler {

class TaylorStepper {
 public:
  explicit TaylorStepper(const Plan& plan, bool conserves = false)
      : system_(plan.system), tree_(plan.hinges), points_(plan, plan.small), projection_(plan), conserves_(conserves) {
    if (plan.small) small_.emplace(plan);
    if (TurningSeries::suits(plan))
      turning_.emplace(plan, points_), here_.emplace(*turning_);
    else
      series_.emplace(plan, points_);
  }
  TaylorStepper(const TaylorStepper&) = delete;  // members refer to each other

  // The order of least cost. With products alone it would be -ln(rtol) / 2 + 1; the other costs of an order and a step
  // make a higher order better. Measured on one and two bodies.
  static int order_for(double rtol) {
    return std::clamp(static_cast<int>(std::lround(5 - 0.57 * std::log(rtol))), 4, kMostOrder);
  }
  static void renew() {}

  Status start(const State& initial, double t, double t_end, double rtol) {
    state_ = initial;
    offset_ = initial.frames.time - t;
    time_ = previous_time_ = t, end_ = t_end, rtol_ = rtol;
    smallest_ = smallest_step(t, t_end);
    order_ = order_for(rtol_);
    accelerated_ = false;
    update_angles(system_, state_.frames, state_.u, state_.angles);
    if (turning_) return Status::success;
    projected_ = true;
    if (const Status status = projection_.start(state_); status != Status::success) return status;
    free_.start(state_);
    return factor();
  }

  // Computes the series about a state, with velocities up to `order`.
  Status expand_at(const State& state, int order) {
    if (const Status status = start(state, 0, 1, 1e-8); status != Status::success) return status;
    order_ = order;
    return expand();
  }
  const MotionSeries& series() const { return *series_; }

  // A step that would end at or next to a singular position, where it cannot be settled, is shortened.
  Status step(Counters& counters, Watch&) {
    constexpr int kMostAttempts = 4;
    constexpr double kShorter = 0.7;
    if (const Status status = expand(); status != Status::success) return status;
    double h = step_size();
    if (!std::isfinite(h)) return Status::non_finite;
    if (h < std::min(smallest_, end_ - time_))
      return projection_.smallest_pivot() < kNearlySingular ? Status::singular_matrix : Status::step_too_small;
    const double next = system_.next_break(offset_ + time_, offset_ + end_);
    if (next < offset_ + end_) h = std::min(h, next - offset_ - time_);
    previous_time_ = time_;
    for (int attempt = 1;; ++attempt) {
      time_ = previous_time_ + h < end_ ? previous_time_ + h : end_;
      if (time_ == previous_time_) return Status::step_too_small;
      evaluate(time_, state_);
      const Status status = settle(counters);
      if (status == Status::success) break;
      if (attempt == kMostAttempts) return status;
      ++counters.rejected_steps;
      h *= kShorter;
    }
    ++counters.steps;
    counters.force_evaluations += order_;
    counters.factorizations += !turning_;
    return Status::success;
  }
  double time() const { return time_; }
  double previous_time() const { return previous_time_; }

  // Solves for (a, lam) on the first call after a step; about axes for a alone: the caller computes the multipliers of
  // the whole system.
  const State& state() {
    if (accelerated_) return state_;
    accelerated_ = true;
    if (turning_) {
      tree_.settle(state_);
      projection_.move_to(state_);
      here_->accelerate(tree_, state_);
    } else if (projected_) {
      projection_.accelerate_here(state_);
    } else {
      projection_.accelerate(state_);
    }
    return state_;
  }
  const Constraints& joints() const { return projection_.joints(); }
  int redundant_rows() const { return projection_.redundant_rows(); }
  Status dense(double t, State& out, Counters&, Watch&) const {
    evaluate(t, out);
    if (turning_) tree_.settle(out);
    return Status::success;
  }

 private:
  // Taylor coefficients about the current state.
  Status expand() {
    if (turning_) {
      turning_->start(state_);
      for (int k = 0; k < order_; ++k) turning_->extend(k);
      return Status::success;
    }
    series_->start(state_);
    if (!(small_ ? series_->extend(order_, *small_) : series_->extend(order_, projection_.saddle())))
      return Status::non_finite;
    measure_scales();
    return Status::success;
  }
  // Leaves the positions to state() and dense() if bodies turn about axes.
  void evaluate(double t, State& out) const {
    out.frames.time = offset_ + t;
    if (turning_) return turning_->evaluate(t - previous_time_, order_, out);
    series_->evaluate(t - previous_time_, order_, tree_, out);
    for (int b = 0; b < system_.n(); ++b) out.frames[b].R = orthogonalised(out.frames[b].R);
    if (tree_.complete) tree_.settle(out);
  }
  // Projects onto both constraint levels and factors the matrix of the next expansion.
  Status settle(Counters& counters) {
    accelerated_ = false;
    if (turning_) return Status::success;
    projected_ = !tree_.complete;
    accelerated_ = projected_ && conserves_;  // before energy and momentum are restored
    if (projected_) {
      const double length = Scales::of_motion(system_, state_).length;
      const Status status = projection_.project(state_, length, counters, accelerated_);
      if (status != Status::success) return status;
    } else {
      update_angles(system_, state_.frames, state_.u, state_.angles);
    }
    if (const Status status = projection_.confirm_rank(); status != Status::success) return status;
    free_.restore(state_);
    return factor();
  }
  Status factor() {
    if (projected_ && !small_) return Status::success;
    if (tree_.complete) projection_.move_to(state_);
    if (!small_) return projection_.factor();
    return small_->factor(projection_.joints()) ? Status::success : Status::singular_matrix;
  }

  // For a system at rest the rate is the one at which it starts to move.
  void measure_scales() {
    scales_ = Scales::of_motion(system_, state_);
    double square = 0;
    for (int b = 0; b < system_.n(); ++b)
      square =
          std::max(square, scales_.rate_of({2 * vector(series_->bodies().x[b][2]), vector(series_->bodies().w[b][1])}));
    scales_.rate = std::max(scales_.rate, std::sqrt(square));
  }

  // The step, up to the end, for which the last two terms of w, v and dR/dt are at most rtol times their size; not
  // finite where the series is not. dR/dt decides if w is constant; about axes the rates alone decide.
  double step_size() const {
    double largest[2] = {0, 0}, sum = 0, rate = scales_.rate;
    if (turning_) {
      rate = std::max(turning_->largest(0), std::sqrt(turning_->largest(1)));
      for (int i = 0; i < 2; ++i) largest[i] = turning_->largest(order_ - 1 + i);
      sum = rate + largest[0] + largest[1];
    }
    for (int b = 0; !turning_ && b < system_.n(); ++b)
      for (int i = 0; i < 2; ++i) {
        const int k = order_ - 1 + i;
        const Vec3 w = vector(series_->bodies().w[b][k]);
        const Vec3 v = (k + 1) / scales_.length * vector(series_->bodies().x[b][k + 1]);
        const Mat3 turn = (k + 1) * upper(series_->bodies().R[b][k + 1]);
        largest[i] =
            std::max({largest[i], w.cwiseAbs().maxCoeff(), v.cwiseAbs().maxCoeff(), turn.cwiseAbs().maxCoeff()});
        sum += w.sum() + v.sum() + turn.sum();
      }
    if (!std::isfinite(sum)) return sum;
    const double size = rtol_ * rate;
    const Pair steps = root(Pair{size / largest[0], size / largest[1]}, Pair{1.0 / (order_ - 1), 1.0 / order_});
    double h = end_ - time_;
    for (int i = 0; i < 2; ++i)
      if (largest[i] > 0) h = std::min(h, steps[i]);
    return h;
  }

  const System& system_;
  const HingeTree& tree_;
  const ReferencePoints points_;
  State state_{system_};
  double offset_ = 0;  // the problem's time minus the run's
  double time_ = 0, previous_time_ = 0, end_ = 0, smallest_ = 0, rtol_ = 1e-8;
  int order_ = 16;
  bool accelerated_ = false;  // state_ has its accelerations

  Projection projection_;
  const bool conserves_;
  FreeBodies free_{system_, conserves_};
  std::optional<SmallSchur> small_;  // solves for the series; else the projection's matrix does
  std::optional<MotionSeries> series_;
  std::optional<TurningSeries> turning_, here_;  // in its place: about the start of the step, and at its end
  Scales scales_;
  bool projected_ = false;  // its matrix is factored at the state
};

}  // namespace lieeuler
