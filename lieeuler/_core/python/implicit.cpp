// The methods that factor one matrix a step, and their extrapolation.
#include <nanobind/stl/vector.h>

#include "methods/extrapolation.hpp"
#include "python/methods.hpp"
#include "run/implicit.hpp"

namespace lieeuler {

static Run implicit(CoordinateMap map, const Method& method, const std::vector<double>& steps,
                    const std::vector<std::int64_t>& counts, bool monitored) {
  require_steps(steps, counts);
  return {[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            return run_method(plan, map, method, initial, steps, counts, monitored, record, interrupted);
          },
          steps.size() + 1, monitored, duration_of(steps, counts)};
}

static Run seulex(const std::vector<double>& t_eval, double rtol, bool monitored) {
  return adaptive<AdaptiveExtrapolation>(t_eval, rtol, monitored);
}

void bind_implicit(nb::module_& module) {
  module.def("implicit", &implicit);
  module.def("seulex", &seulex);
}

}  // namespace lieeuler
