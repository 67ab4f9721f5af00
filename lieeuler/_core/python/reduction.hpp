// The way back from a smaller problem to the one it stands for (lieeuler/reduced.py).
#pragma once

#include <Eigen/Geometry>

#include "python/arrays.hpp"

namespace lieeuler {

// States of n bodies at T samples: x, v, w, a and alpha (5, T, n, 3), R (T, n, 3, 3).
struct Motion {
  size_t n, T;
  double *vectors, *R;

  Eigen::Map<Vec3> vector(size_t which, size_t sample, size_t b) const {
    return Eigen::Map<Vec3>(vectors + 3 * ((which * T + sample) * n + b));
  }
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> attitude(size_t sample, size_t b) const {
    return Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R + 9 * (sample * n + b));
  }
  const double* row(size_t which, size_t sample) const { return vectors + 3 * (which * T + sample) * n; }
};

// R, w and alpha of a body from those in a frame that has turned by -t spin against it.
inline void turn_with(const Vec3& spin, double t, Mat3& R, Vec3& w, Vec3& alpha) {
  const Mat3 turn = Eigen::AngleAxisd(spin.norm() * t, spin.normalized()).toRotationMatrix();
  alpha = turn.transpose() * (alpha - spin.cross(w));
  R = R * turn, w = turn.transpose() * w + spin;
}

// x = T^T (X + R' c + h e_3), R = T^T R' P exp(t hat(s)) of a body that a body with X and R' carries, t after the
// start.
struct Reduction {
  struct Body {
    int carrier;
    Vec3 centre;
    double height;
    Mat3 turn;
    Vec3 spin;
  };
  Mat3 world;
  std::vector<Body> bodies;
  std::vector<double> angles;  // of torsional springs at the start, less those of the smaller problem

  void restore(const double* t, size_t count, const Motion& from, const Motion& to) const {
    const Mat3 back = world.transpose();
    for (size_t k = 0; k < count; ++k)
      for (size_t b = 0; b < bodies.size(); ++b) {
        const auto& [carrier, centre, height, turn, spin] = bodies[b];
        Mat3 R = from.attitude(k, carrier);
        Vec3 x = from.vector(0, k, carrier), v = from.vector(1, k, carrier), w = from.vector(2, k, carrier);
        Vec3 a = from.vector(3, k, carrier), alpha = from.vector(4, k, carrier);
        if (!centre.isZero(0)) {
          const Vec3 swing = w.cross(centre);
          x += R * centre, v += R * swing, a += R * (alpha.cross(centre) + w.cross(swing));
        }
        x[2] += height;
        R = Mat3(back * R) * turn, w = Vec3(turn.transpose() * w), alpha = Vec3(turn.transpose() * alpha);
        if (!spin.isZero(0)) turn_with(spin, t[k] - t[0], R, w, alpha);
        to.vector(0, k, b) = back * x, to.vector(1, k, b) = back * v, to.vector(2, k, b) = w;
        to.vector(3, k, b) = back * a, to.vector(4, k, b) = alpha;
        to.attitude(k, b) = R;
      }
  }
};

}  // namespace lieeuler
