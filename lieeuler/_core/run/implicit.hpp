// Runs of methods that factor one matrix a step.
#pragma once

#include "methods/euler_hamilton.hpp"
#include "methods/euler_lagrange.hpp"
#include "run/loop.hpp"

namespace lieeuler {

enum class Formulation { lagrange, hamilton };

// A method that factors one matrix a step.
struct Method {
  Formulation formulation;
  Level level;
  bool index1_output;  // (a, lam) from the index-1 system at the new state
  Gains gains = {};
  std::vector<double> composition = {};        // weights of a composition of RATTLE; empty: the method itself
  std::optional<double> spectral_radius = {};  // of generalized-alpha, in place of implicit Euler
  bool polish = true;  // make attitudes rotations again after every step; only Euler methods allow false
  Correction correction = Correction::mass;
};

using RunMethod = Outcome(const Plan&, const Method&, const State& initial, const std::vector<double>& steps,
                          const std::vector<std::int64_t>& counts, bool monitored, const Record&, const Interrupted&);

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

// Each is compiled by itself, in run/implicit_*.cpp.
extern template RunMethod run_method<ExpMap>;
extern template RunMethod run_method<CayleyMap>;
extern template RunMethod run_method<CcskMap>;

}  // namespace lieeuler
