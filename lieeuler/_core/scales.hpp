// The sizes of a system in motion.
#pragma once

#include "kinematics.hpp"

namespace lieeuler {

// Sizes that make errors of translations and rotations, and of their rates, comparable: m, 1/s.
struct Scales {
  double length = 1, rate = 1;

  static Scales of(const System& system, const State& state, double least_rate = 1) {
    Scales scales{system.length, least_rate};
    for (int b = 0; b < system.n(); ++b)
      scales.length = std::max(scales.length, state.frames[b].x.cwiseAbs().maxCoeff());
    for (int b = 0; b < system.n(); ++b) scales.rate = std::max(scales.rate, scales.rate_of(state.u[b]));
    return scales;
  }
  // The larger rate of a body's two, comparable to `rate`.
  double rate_of(const Twist& u) const { return std::max(u.v.cwiseAbs().maxCoeff() / length, u.w.cwiseAbs().maxCoeff()); }

  // The largest of position / length, angle, and their rates, over twelve numbers a body: x, theta, v, w.
  double norm(const std::vector<double>& y) const {
    double most = 0, sum = 0;
    for (size_t at = 0; at < y.size(); at += 12) {
      const double x = load3(&y[at]).norm() / length, theta = load3(&y[at + 3]).norm();
      const double v = load3(&y[at + 6]).norm() / (length * rate), w = load3(&y[at + 9]).norm() / rate;
      most = std::max({most, x, theta, v, w});
      sum += x + theta + v + w;
    }
    return std::isfinite(sum) ? most : sum;  // max() would hide a NaN
  }
};

}  // namespace lieeuler
