// Methods with their steps or their tolerance, ready to run.
#pragma once

#include "methods/rkmk.hpp"
#include "methods/turning.hpp"
#include "python/arrays.hpp"
#include "run/ensemble.hpp"
#include "run/loop.hpp"

namespace lieeuler {

inline void require_steps(const std::vector<double>& steps, const std::vector<std::int64_t>& counts) {
  require(!steps.empty() && steps.size() == counts.size(), "every interval has a step and a count");
  for (size_t k = 0; k < steps.size(); ++k)
    require(std::isfinite(steps[k]) && steps[k] > 0 && counts[k] > 0, "every interval needs steps that advance");
}

inline double duration_of(const std::vector<double>& steps, const std::vector<std::int64_t>& counts) {
  double duration = 0;
  for (size_t k = 0; k < steps.size(); ++k) duration += steps[k] * static_cast<double>(counts[k]);
  return duration;
}

inline Run implicit(CoordinateMap map, const Method& method, const std::vector<double>& steps,
                    const std::vector<std::int64_t>& counts, bool monitored) {
  require_steps(steps, counts);
  return {[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            return run_method(map, plan, method, initial, steps, counts, monitored, record, interrupted);
          },
          steps.size() + 1, monitored, duration_of(steps, counts)};
}

inline Run runge_kutta(const Tableau& tableau, const std::vector<double>& steps,
                       const std::vector<std::int64_t>& counts, bool monitored) {
  require_steps(steps, counts);
  Run run{[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            FixedMuntheKaas<BodyChart> stepper(plan, tableau);
            return lieeuler::run(stepper, plan, initial, steps, counts, monitored, record, interrupted);
          },
          steps.size() + 1, monitored, duration_of(steps, counts)};
  run.by_joints = [=](const std::vector<JointNode>& nodes, const Plan& plan, const State& initial, const Record& record,
                      const Interrupted& interrupted) {
    FixedMuntheKaas<JointChart> stepper(plan, tableau, nodes);
    return lieeuler::run(stepper, plan, initial, steps, counts, monitored, record, interrupted);
  };
  if (!monitored && tableau.stages.size() + 2 <= kMostSlopes) run.in_lanes = ExplicitRun{tableau, steps, counts};
  return run;
}

// t_eval starts at zero.
template <class Stepper, class... Arguments>
inline Run adaptive(const std::vector<double>& t_eval, double rtol, bool monitored, const Arguments&... arguments) {
  require(t_eval.size() > 1 && std::isfinite(t_eval.front()) && std::isfinite(t_eval.back()) && rtol > 0 && rtol < 1 &&
              std::adjacent_find(
                  t_eval.begin(), t_eval.end(), [](double a, double b) { return !(a < b); }) == t_eval.end(),
          "output times must increase, and the tolerance lie between 0 and 1");
  return {[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            Stepper stepper(plan, arguments...);
            return run_adaptive(stepper, plan, initial, t_eval, rtol, monitored, record, interrupted);
          },
          t_eval.size(), monitored, t_eval.back()};
}

inline Run adaptive_runge_kutta(const Tableau& tableau, const std::vector<double>& t_eval, double rtol, bool monitored,
                                bool conserves) {
  Run run = adaptive<AdaptiveMuntheKaas<BodyChart>>(t_eval, rtol, monitored, tableau, conserves);
  run.by_joints = [=](const std::vector<JointNode>& nodes, const Plan& plan, const State& initial, const Record& record,
                      const Interrupted& interrupted) {
    AdaptiveMuntheKaas<JointChart> stepper(plan, tableau, nodes);
    return run_adaptive(stepper, plan, initial, t_eval, rtol, monitored, record, interrupted);
  };
  return run;
}

inline Run taylor(const std::vector<double>& t_eval, double rtol, bool monitored, bool conserves) {
  Run run = adaptive<TaylorStepper>(t_eval, rtol, monitored, conserves);
  run.run = [whole = run.run, turning = adaptive<TurningStepper>(t_eval, rtol, monitored).run](
                const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
    return (TurningSeries::suits(plan) ? turning : whole)(plan, initial, record, interrupted);
  };
  if (!monitored && !conserves) run.in_lanes = TaylorRun{t_eval, rtol};
  return run;
}

}  // namespace lieeuler
