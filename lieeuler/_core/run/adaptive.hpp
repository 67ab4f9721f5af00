// Runs of steppers that choose their steps: stepping, sampling between steps, monitoring every step, final status.
#pragma once

#include <optional>

#include "run/loop.hpp"
#include "solve/projection.hpp"

namespace lieeuler {

// Integrates from t_eval.front() and samples at t_eval; the steps do not depend on the samples. The stepper supplies
//
//   Status start(const State& initial, double t, double t_end, double rtol)
//   Status step(Counters&, Watch&)        one accepted step, the last one exactly to t_end; returns at once if the
//                                         watch ends the run
//   double time(), previous_time()        ends of that step
//   const State& state()                  at time(), on the constraints, with (a, lam) of the index-1 system; called
//                                         only when needed, so that a stepper may compute (a, lam) here
//   const Constraints& joints()           at state()
//   int redundant_rows()
//   Status dense(double t, State& out, Counters&, Watch&)
//                                         frames, u and the angles for unwrapping at t, within the last step
template <class Stepper>
Outcome run_adaptive(Stepper& stepper, const Plan& plan, const State& initial, const std::vector<double>& t_eval,
                     double rtol, bool monitored, const Record& record, const Interrupted& interrupted) {
  const FlushDenormals flush;
  const System& system = plan.system;
  Outcome outcome;
  Monitor monitor(plan, monitored);
  std::optional<Projection> projection;  // of samples between steps
  State sample(system);
  LeastNorm least_norm(plan);
  double reached = t_eval.front();
  const auto end = [&](Status status) { return ended(outcome, status, reached, monitor, stepper); };
  if (const Status status = stepper.start(initial, t_eval.front(), t_eval.back(), rtol); status != Status::success)
    return end(status);
  if (!is_finite(stepper.state())) return end(Status::non_finite);
  monitor.start(stepper.state(), stepper.joints());
  record(outcome.samples++, least_norm.of(stepper.state(), stepper.redundant_rows()));
  Watch watch(interrupted, system);
  for (size_t next = 1; next < t_eval.size();) {
    if (watch.ends()) return end(Status::interrupted);
    if (const Status status = stepper.step(outcome.counters, watch); status != Status::success) return end(status);
    reached = stepper.time();
    if (monitored) monitor.watch(stepper.state(), stepper.joints());
    for (; next < t_eval.size() && t_eval[next] <= reached; ++next) {
      if (watch.ends()) return end(Status::interrupted);  // a step may hold any number of samples
      if (t_eval[next] == reached) {
        if (!is_finite(stepper.state())) return end(Status::non_finite);
        record(outcome.samples++, least_norm.of(stepper.state(), stepper.redundant_rows()));
        continue;
      }
      Status status = Status::success;
      if (!projection) {
        projection.emplace(plan);
        status = projection->start(initial);
      }
      if (status == Status::success) status = stepper.dense(t_eval[next], sample, outcome.counters, watch);
      if (status == Status::success)
        status = projection->project(sample, Scales::of_motion(system, sample).length, outcome.counters);
      if (status == Status::success && !is_finite(sample)) status = Status::non_finite;
      if (status != Status::success) return end(status);
      record(outcome.samples++, least_norm.of(sample, stepper.redundant_rows()));
    }
  }
  return end(Status::success);
}

}  // namespace lieeuler
