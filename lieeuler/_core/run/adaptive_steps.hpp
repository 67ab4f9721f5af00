// Runs an adaptive method from step to step: attempts the step it proposes and retries a shorter one when it fails, up
// to a singular position.
#pragma once

#include "run/watch.hpp"
#include "solve/projection.hpp"
#include "solve/step_control.hpp"

namespace lieeuler {

// The stepper of `run_adaptive` for a Method that supplies, beside state(), joints(), redundant_rows():
//
//   Status start(const State& initial, double rtol, double slowest, Counters&)
//       proposes the first step; changes slower than the rate `slowest`, 1/s, need not be resolved to their last digits
//
//   double proposed()
//       the next step, s
//
//   Status attempt(double h, bool& stands, Counters&, Watch&)
//       tries a step from state(); `stands` says whether its error is small enough
//
//   void refuse(double h, Status)
//       rejects the attempted step and proposes a shorter one
//
//   Status accept(double h)
//       makes the end of the attempted step the new state()
//
//   Status dense(double fraction, State& out, Counters&, Watch&)
//       the state within the accepted step
//
//   double smallest_pivot()
//       that of Projection
//
//   double rate()
//       that of Scales, 1/s
template <class Method>
class AdaptiveSteps {
 public:
  template <class... Arguments>
  explicit AdaptiveSteps(const Arguments&... arguments) : method_(arguments...) {}

  Status start(const State& initial, double t, double t_end, double rtol) {
    time_ = previous_ = t, end_ = t_end, offset_ = initial.frames.time - t;
    smallest_ = smallest_step(t, t_end), taken_ = 0;
    return method_.start(initial, rtol, 1 / (t_end - t), at_start_);
  }

  void renew()
    requires requires(Method m) { m.renew(); }
  {
    method_.renew();
  }

  Status step(Counters& counters, Watch& watch) {
    std::exchange(at_start_, Counters{}).add_to(counters);
    for (;;) {
      const double end = method_.next_break(offset_ + end_) - offset_;
      const bool last = time_ + 1.01 * method_.proposed() >= end;  // avoids a tiny step at the end
      const double h = last ? end - time_ : method_.proposed();
      if (!last && h < std::min(smallest_, kGrowing * taken_))
        return too_small();  // at the start steps may grow from less
      bool stands = false;
      const Status status = method_.attempt(h, stands, counters, watch);
      if (status == Status::success && stands) {
        ++counters.steps;
        previous_ = time_, taken_ = h;
        time_ = last ? end : time_ + h;
        return method_.accept(h);
      }
      if (status == Status::interrupted || watch.ends()) return Status::interrupted;
      ++counters.rejected_steps;
      method_.refuse(h, status);
      if (nearly_singular() && creeps()) return Status::singular_matrix;
      if (method_.proposed() < smallest_)
        return status == Status::singular_matrix ? Status::singular_matrix : too_small();
    }
  }

  Status dense(double t, State& out, Counters& counters, Watch& watch) {
    return method_.dense((t - previous_) / (time_ - previous_), out, counters, watch);
  }
  double time() const { return time_; }
  double previous_time() const { return previous_; }
  const State& state() { return method_.state(); }
  const Constraints& joints() const { return method_.joints(); }
  int redundant_rows() const { return method_.redundant_rows(); }

 private:
  static constexpr double kCreeping = 1e-3;
  static constexpr double kGrowing = 1.5;

  bool nearly_singular() { return method_.smallest_pivot() < kNearlySingular; }
  Status too_small() { return nearly_singular() ? Status::singular_matrix : Status::step_too_small; }

  // Whether steps are a small part of the distance to a singular position, which goes as the root of the pivot. Such a
  // run takes ever more steps and never passes the position, because its error estimates are rounding over a pivot.
  bool creeps() { return method_.proposed() * method_.rate() < kCreeping * std::sqrt(method_.smallest_pivot()); }

  Method method_;
  Counters at_start_;  // work before the first step
  double time_ = 0, previous_ = 0, end_ = 0, smallest_ = 0, taken_ = 0;
  double offset_ = 0;  // the problem's time minus the run's
};

}  // namespace lieeuler
