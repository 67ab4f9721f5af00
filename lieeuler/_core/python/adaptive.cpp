// Taylor series and extrapolation, ready to run.
#include "methods/extrapolation.hpp"
#include "methods/taylor.hpp"
#include "python/methods.hpp"
#include "python/probes.hpp"

namespace lieeuler {

Run seulex(const std::vector<double>& t_eval, double rtol, bool monitored) {
  return adaptive<AdaptiveExtrapolation>(t_eval, rtol, monitored);
}

Run taylor(const std::vector<double>& t_eval, double rtol, bool monitored, bool conserves) {
  return adaptive<TaylorStepper>(t_eval, rtol, monitored, conserves);
}

Parts taylor_coefficients(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w, int order) {
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

}  // namespace lieeuler
