// What solves the index-1 system: Runge-Kutta and Taylor methods, levels and multipliers of given states, and runs of
// all methods.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "methods/rkmk.hpp"
#include "methods/taylor.hpp"
#include "python/levels.hpp"
#include "python/methods.hpp"
#include "python/probes.hpp"
#include "python/running.hpp"

namespace lieeuler {

static Run runge_kutta(const Tableau& tableau, const std::vector<double>& steps,
                       const std::vector<std::int64_t>& counts, bool monitored) {
  require_steps(steps, counts);
  const auto go = [=](auto& by, const Plan& plan, const State& initial, const Record& record,
                      const Interrupted& interrupted) {
    return run(by, plan, initial, steps, counts, monitored, record, interrupted);
  };
  Run run{lent<FixedMuntheKaas<BodyChart>>(go, tableau), steps.size() + 1, monitored, duration_of(steps, counts)};
  run.by_joints = lent<FixedMuntheKaas<JointChart>>(go, tableau);
  return run;
}

static Run adaptive_runge_kutta(const Tableau& tableau, const std::vector<double>& t_eval, double rtol, bool monitored,
                                bool conserves) {
  Run run = adaptive<AdaptiveMuntheKaas<BodyChart>>(t_eval, rtol, monitored, tableau, conserves);
  run.by_joints = lent<AdaptiveMuntheKaas<JointChart>>(choose_steps(t_eval, rtol, monitored), tableau);
  return run;
}

static Run taylor(const std::vector<double>& t_eval, double rtol, bool monitored, bool conserves) {
  return adaptive<TaylorStepper>(t_eval, rtol, monitored, conserves);
}

// Taylor coefficients of x, R and w about a state, order by order, from a stepper's expansion.
static Parts taylor_coefficients(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
                                 int order) {
  require(order >= 0 && order <= kMostOrder, "no series has this order");
  TaylorStepper stepper(plan);
  const Status status = stepper.expand_at(make_state(plan.system, x, R, v, w), order);
  const size_t n = plan.system.n(), count = order + 1;
  std::vector<double> xs(3 * n * count), Rs(9 * n * count), ws(3 * n * count);
  for (size_t at = 0; at < n * count; ++at) {
    const auto [position, attitude, rate] =
        stepper.series().coefficient(static_cast<int>(at % n), static_cast<int>(at / n));
    put(xs, 3 * at, position), put(ws, 3 * at, rate), put(Rs, 9 * at, attitude);
  }
  Parts result;
  result["status"] = name_of(status);
  result["x"] = make_array(std::move(xs), {count, n, 3});
  result["R"] = make_array(std::move(Rs), {count, n, 3, 3});
  result["w"] = make_array(std::move(ws), {count, n, 3});
  return result;
}

void bind_index1(nb::module_& module) {
  module.def("runge_kutta", &runge_kutta);
  module.def("adaptive_runge_kutta", &adaptive_runge_kutta);
  module.def("taylor", &taylor);
  module.def("integrate", &integrate, nb::arg(), nb::arg(), nb::arg(), nb::arg().none(), nb::arg(), nb::arg(),
             nb::arg());
  module.def("integrate_ensemble", &integrate_ensemble);
  module.def("taylor_coefficients", &taylor_coefficients);
  module.def("project", &project);
  module.def("constraints", &constraints);
  module.def("constraint_levels", &levels_of_states);
  module.def("open_levels", &open_levels_of);
  module.def("index1", &index1);
  module.def("forces", &forces);
  module.def("map_values", &map_values);
}

}  // namespace lieeuler
