// The explicit Runge-Kutta-Munthe-Kaas methods, ready to run.
#include "python/methods.hpp"

namespace lieeuler {

Run runge_kutta(const Tableau& tableau, const std::vector<double>& steps, const std::vector<std::int64_t>& counts,
                bool monitored) {
  require_steps(steps, counts);
  const auto go = [=](auto& by, const Plan& plan, const State& initial, const Record& record,
                      const Interrupted& interrupted) {
    return run(by, plan, initial, steps, counts, monitored, record, interrupted);
  };
  Run run{lent<FixedMuntheKaas<BodyChart>>(go, tableau), steps.size() + 1, monitored, duration_of(steps, counts)};
  run.by_joints = lent<FixedMuntheKaas<JointChart>>(go, tableau);
  return run;
}

Run adaptive_runge_kutta(const Tableau& tableau, const std::vector<double>& t_eval, double rtol, bool monitored,
                         bool conserves) {
  Run run = adaptive<AdaptiveMuntheKaas<BodyChart>>(t_eval, rtol, monitored, tableau, conserves);
  run.by_joints = lent<AdaptiveMuntheKaas<JointChart>>(choose_steps(t_eval, rtol, monitored), tableau);
  return run;
}

}  // namespace lieeuler
