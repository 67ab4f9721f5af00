// Methods with their steps or their tolerance, ready to run.
#pragma once

#include "methods/rkmk.hpp"
#include "methods/turning.hpp"
#include "python/arrays.hpp"
#include "run/ensemble.hpp"
#include "run/loop.hpp"

namespace lieeuler {

// Keeps a stepper that has renew(), which makes it start like a new one, from one run to the next of the same system:
// making it costs as much as several steps. Runs at the same time make their own.
template <class Stepper>
class Shelf {
 public:
  template <class Use, class... Arguments>
  Outcome lend(const Plan& plan, const Use& use, const Arguments&... arguments) {
    std::unique_ptr<Stepper> stepper = take(plan);
    if (!stepper) stepper = std::make_unique<Stepper>(plan, arguments...);
    const Outcome outcome = use(*stepper);
    if constexpr (requires { stepper->renew(); }) {
      if (outcome.status != Status::success || plan.system.n() > kMostBodies) return outcome;
      stepper->renew();
      const std::lock_guard lock(guard_);
      serial_ = plan.serial, kept_ = std::move(stepper);
    }
    return outcome;
  }

 private:
  static constexpr int kMostBodies = 64;  // larger systems would hold megabytes

  std::unique_ptr<Stepper> take(const Plan& plan) {
    const std::lock_guard lock(guard_);
    return serial_ == plan.serial ? std::move(kept_) : nullptr;
  }

  std::mutex guard_;
  std::uint64_t serial_ = 0;  // of the plan of kept_
  std::unique_ptr<Stepper> kept_;
};

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
  const auto shelf = std::make_shared<Shelf<FixedMuntheKaas<BodyChart>>>();
  const auto of_joints = std::make_shared<Shelf<FixedMuntheKaas<JointChart>>>();
  Run run{[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            const auto use = [&](auto& stepper) {
              return lieeuler::run(stepper, plan, initial, steps, counts, monitored, record, interrupted);
            };
            return shelf->lend(plan, use, tableau);
          },
          steps.size() + 1, monitored, duration_of(steps, counts)};
  run.by_joints = [=](const std::vector<JointNode>& nodes, const Plan& plan, const State& initial, const Record& record,
                      const Interrupted& interrupted) {
    const auto use = [&](auto& stepper) {
      return lieeuler::run(stepper, plan, initial, steps, counts, monitored, record, interrupted);
    };
    return of_joints->lend(plan, use, tableau, nodes);
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
  const auto shelf = std::make_shared<Shelf<Stepper>>();
  return {[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            const auto use = [&](Stepper& stepper) {
              return run_adaptive(stepper, plan, initial, t_eval, rtol, monitored, record, interrupted);
            };
            return shelf->lend(plan, use, arguments...);
          },
          t_eval.size(), monitored, t_eval.back()};
}

inline Run adaptive_runge_kutta(const Tableau& tableau, const std::vector<double>& t_eval, double rtol, bool monitored,
                                bool conserves) {
  const auto shelf = std::make_shared<Shelf<AdaptiveMuntheKaas<JointChart>>>();
  Run run = adaptive<AdaptiveMuntheKaas<BodyChart>>(t_eval, rtol, monitored, tableau, conserves);
  run.by_joints = [=](const std::vector<JointNode>& nodes, const Plan& plan, const State& initial, const Record& record,
                      const Interrupted& interrupted) {
    const auto use = [&](auto& stepper) {
      return run_adaptive(stepper, plan, initial, t_eval, rtol, monitored, record, interrupted);
    };
    return shelf->lend(plan, use, tableau, nodes);
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
