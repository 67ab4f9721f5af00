// The sizes of a system in motion.
#pragma once

#include "model/kinematics.hpp"

namespace lieeuler {

// Sizes that make errors of translations and rotations, and of their rates, comparable: m, 1/s. They scale with the
// units of length and time, and no unit of mass enters.
struct Scales {
  double length = 1, rate = 1;

  // Rates below the one that weight and loads give, or below `slowest`, count as these: what is at rest for a moment
  // need not be followed to the last digit of its speed.
  static Scales of(const System& system, const State& state, double slowest) {
    Scales scales = of_motion(system, state);
    scales.rate = std::max({scales.rate, scales.falling(system), slowest});
    return scales;
  }
  // As it moves now.
  static Scales of_motion(const System& system, const State& state) {
    Scales scales{system.length, 0};
    for (int b = 0; b < system.n(); ++b)
      scales.length = std::max(scales.length, state.frames[b].x.cwiseAbs().maxCoeff());
    for (int b = 0; b < system.n(); ++b) scales.rate = std::max(scales.rate, scales.rate_of(state.u[b]));
    return scales;
  }
  // 1/s, where nothing moves yet: that of a fall over `length`, or far below what the springs do.
  double natural(const System& system) const { return std::max(falling(system), kSlow * system.frequency); }

  // The larger rate of a body's two, comparable to `rate`.
  double rate_of(const Twist& u) const {
    return std::max(u.v.cwiseAbs().maxCoeff() / length, u.w.cwiseAbs().maxCoeff());
  }

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

 private:
  static constexpr double kFall = 0.3;   // of sqrt(g / length): 1 rad/s for a length of a metre on the ground
  static constexpr double kSlow = 1e-3;  // of a spring's frequency

  double falling(const System& system) const {
    const double fall = std::max(system.gravity.norm(), system.acceleration) / length;
    return kFall * std::sqrt(std::max(fall, system.angular_acceleration));
  }
};

}  // namespace lieeuler
