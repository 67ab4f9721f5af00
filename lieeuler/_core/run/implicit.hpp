// Runs of methods that factor one matrix a step.
#pragma once

#include "methods/euler_hamilton.hpp"
#include "methods/euler_lagrange.hpp"
#include "run/loop.hpp"

namespace lieeuler {

template <class Map>
Outcome run_method(const Plan& plan, const Method& method, const State& initial, const std::vector<double>& steps,
                   const std::vector<std::int64_t>& counts, bool monitored, const Record& record,
                   const Interrupted& interrupted) {
  const auto start = [&](auto&& stepper) {
    if (!method.polish) stepper.keep_rounding();
    return run(stepper, plan, initial, steps, counts, monitored, record, interrupted);
  };
  if (!method.composition.empty()) return start(CompositionStepper<Map>(plan, method.composition));
  if (method.formulation == Formulation::hamilton)
    return start(HamiltonStepper<Map>(plan, method.level, method.index1_output));
  if (method.spectral_radius)
    return start(LagrangeStepper<Map>(plan, GeneralizedAlpha(*method.spectral_radius), method.correction));
  return start(LagrangeStepper<Map>(plan, method.level, method.index1_output, method.gains, method.correction));
}

}  // namespace lieeuler
