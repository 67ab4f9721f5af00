// Runs of methods that factor one matrix a step.
#pragma once

#include "methods/generalized_alpha.hpp"
#include "methods/rattle.hpp"
#include "methods/unstabilised.hpp"
#include "run/loop.hpp"

namespace lieeuler {

// The equations of a method that is no composition.
inline std::unique_ptr<StepEquations> equations_of(const Plan& plan, CoordinateMap map, const Method& method) {
  if (method.formulation == Formulation::hamilton)
    return std::make_unique<HamiltonEquations>(plan, map, method.level, method.index1_output);
  if (method.spectral_radius)
    return std::make_unique<AlphaEquations>(plan, map, AlphaCoefficients(*method.spectral_radius), method.correction);
  if (method.level == Level::stabilised)
    return std::make_unique<StabilisedEquations>(plan, map, method.index1_output, method.correction);
  if (method.level == Level::acceleration)
    return std::make_unique<AccelerationEquations>(plan, map, method.index1_output, method.gains);
  return std::make_unique<UnstabilisedEquations>(plan, map, method.level, method.index1_output);
}

inline Outcome run_method(const Plan& plan, CoordinateMap map, const Method& method, const State& initial,
                          const std::vector<double>& steps, const std::vector<std::int64_t>& counts, bool monitored,
                          const Record& record, const Interrupted& interrupted) {
  const auto start = [&](auto&& stepper) {
    if (!method.polish) stepper.keep_rounding();
    return run(stepper, plan, initial, steps, counts, monitored, record, interrupted);
  };
  if (!method.composition.empty()) return start(CompositionStepper(plan, map, method.composition));
  return start(NewtonStepper(equations_of(plan, map, method)));
}

}  // namespace lieeuler
