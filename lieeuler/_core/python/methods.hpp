// What makes steppers ready to run.
#pragma once

#include "python/arrays.hpp"
#include "python/run.hpp"
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

// A run by steppers from a shelf, made of the plan, `given` and, of a tree's joints, its nodes. go(stepper, plan,
// initial, record, interrupted) is the run itself.
template <class Stepper, class Go, class... Arguments>
auto lent(const Go& go, const Arguments&... given) {
  return [=, shelf = std::make_shared<Shelf<Stepper>>()](const Plan& plan, const State& initial, const Record& record,
                                                         const Interrupted& interrupted, const auto&... nodes) {
    return shelf->lend(
        plan, [&](Stepper& by) { return go(by, plan, initial, record, interrupted); }, given..., nodes...);
  };
}

// What adaptive steppers do; t_eval starts at zero.
inline auto choose_steps(const std::vector<double>& t_eval, double rtol, bool monitored) {
  require(t_eval.size() > 1 && std::isfinite(t_eval.front()) && std::isfinite(t_eval.back()) && rtol > 0 && rtol < 1 &&
              std::adjacent_find(
                  t_eval.begin(), t_eval.end(), [](double a, double b) { return !(a < b); }) == t_eval.end(),
          "output times must increase, and the tolerance lie between 0 and 1");
  return [=](auto& by, const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
    return run_adaptive(by, plan, initial, t_eval, rtol, monitored, record, interrupted);
  };
}
template <class Stepper, class... Arguments>
inline Run adaptive(const std::vector<double>& t_eval, double rtol, bool monitored, const Arguments&... given) {
  return {lent<Stepper>(choose_steps(t_eval, rtol, monitored), given...), t_eval.size(), monitored, t_eval.back()};
}

}  // namespace lieeuler
