// Step size control from error estimates in the norm (10.3) of docs/theory.md.
#pragma once

#include <algorithm>
#include <cmath>

namespace lieeuler {

// Proportional-integral control (Gustafsson 1991, doi:10.1145/210232.210242) for estimates proportional to h^order.
class StepControl {
 public:
  StepControl() = default;
  StepControl(int order, double first) : order_(order), h_(first) {}

  double step() const { return h_; }

  // `error`: estimate over tolerance. Returns whether the step is accepted.
  bool accept(double error) {
    error = std::max(error, 1e-10);
    if (!(error <= 1)) {
      refuse(std::max(0.2, kSafety * std::pow(error, -1.0 / order_)));
      return false;
    }
    const double factor = kSafety * std::pow(error, -kProportional / order_) * std::pow(last_, kIntegral / order_);
    h_ *= std::clamp(factor, 0.2, refused_ ? 1.0 : 6.0);  // no growth right after a rejection
    last_ = std::max(error, 1e-4);
    refused_ = false;
    return true;
  }
  void refuse(double factor) {
    h_ *= std::isfinite(factor) ? factor : 0.1;
    refused_ = true;
  }

 private:
  static constexpr double kSafety = 0.9, kProportional = 0.7, kIntegral = 0.4;
  int order_ = 1;
  double h_ = 0, last_ = 1e-4;
  bool refused_ = false;
};

// A run ends if its steps fall below this: it would need too many of them, or t + h would round to t.
inline double smallest_step(double t, double t_end) { return std::max(1e-12 * (t_end - t), 1e-15 * t_end); }

}  // namespace lieeuler
