// Forces of the user's own, functions of time and state: their values, and their derivatives by differences.
#pragma once

#include <Eigen/Geometry>

#include "model/system.hpp"

namespace lieeuler {

// Adds the user's forces to those on the bodies.
[[gnu::noinline, gnu::cold]] inline void add_own_forces(const System& system, const Configuration& frames,
                                                        const std::vector<Twist>& u, std::vector<Twist>& f) {
  thread_local std::vector<double> given, found;
  const size_t n = system.n();
  given.resize(18 * n), found.resize(6 * n);
  double *x = given.data(), *R = x + 3 * n, *v = R + 9 * n, *w = v + 3 * n;
  for (size_t b = 0; b < n; ++b) {
    store(frames[b].x, x + 3 * b), store(u[b].v, v + 3 * b), store(u[b].w, w + 3 * b);
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R + 9 * b) = frames[b].R;
  }
  for (const OwnForce& own : system.own) {
    std::fill(found.begin(), found.end(), 0.0);
    own.function(frames.time, static_cast<int>(n), x, R, v, w, found.data(), own.user);
    for (size_t b = 0; b < n; ++b) f[b] += load(&found[6 * b]);
  }
}

// Derivatives of the user's forces at one configuration by central differences: those of the force (v, world) and the
// torque (w, body) on one body with respect to a displacement of another, x and R exp(theta), or to its velocities.
class OwnSlopes {
 public:
  void find(const System& system, const Configuration& frames, const std::vector<Twist>& u, bool by_positions) {
    Configuration at = frames;
    std::vector<Twist> moving = u;
    const Scales scales = Scales::of_motion(system, frames, u);
    const double rate = scales.rate > 0 ? scales.rate : std::max(scales.natural(system), 1e-3);
    const int columns = 6 * system.n();
    force_.resize(u.size()), by_position_.setZero(columns, columns), by_velocity_.setZero(columns, columns);
    const auto difference = [&](auto&& move, double size, Eigen::MatrixXd& slopes, int column) {
      for (const double sign : {1.0, -1.0}) {
        move(sign * size);
        std::fill(force_.begin(), force_.end(), Twist{});
        add_own_forces(system, at, moving, force_);
        slopes.col(column) += sign / (2 * size) * Eigen::Map<Eigen::VectorXd>(flat(force_), columns);
      }
      move(0.0);
    };
    for (int b = 0; b < system.n(); ++b)
      for (int k = 0; k < 3; ++k) {
        const Vec3 axis = Vec3::Unit(k);
        const int v = 6 * b + k, w = v + 3;
        const double length = kShare * scales.length, speed = kShare * rate;
        difference([&](double d) { moving[b].v = u[b].v + d * axis; }, speed * scales.length, by_velocity_, v);
        difference([&](double d) { moving[b].w = u[b].w + d * axis; }, speed, by_velocity_, w);
        if (!by_positions) continue;
        difference([&](double d) { at[b].x = frames[b].x + d * axis; }, length, by_position_, v);
        difference([&](double d) { at[b].R = frames[b].R * Eigen::AngleAxisd(d, axis); }, kShare, by_position_, w);
      }
  }

  Stiffness by_position(int row, int column) const { return block(by_position_, row, column); }
  Stiffness by_velocity(int row, int column) const { return block(by_velocity_, row, column); }

 private:
  static constexpr double kShare = 1e-6;  // of the system's length, of a radian, and of their rates

  static Stiffness block(const Eigen::MatrixXd& all, int row, int column) {
    const int i = 6 * row, j = 6 * column;
    return {all.block<3, 3>(i, j), all.block<3, 3>(i, j + 3), all.block<3, 3>(i + 3, j), all.block<3, 3>(i + 3, j + 3)};
  }

  Eigen::MatrixXd by_position_, by_velocity_;
  std::vector<Twist> force_;
};

}  // namespace lieeuler
