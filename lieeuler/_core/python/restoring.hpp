// The way back from a plane (lieeuler/planar.py).
#pragma once

#include "python/arrays.hpp"

namespace lieeuler {

// Turns vectors of a motion in a plane, in place: x, v and a (T, n, 3) to world axes, w and alpha (T, n, 3) and
// attitudes R (T, n, 3, 3) to those of the bodies; x gets its height along the third axis first. turn (3, 3): from
// world axes to the plane's; frames (n, 3, 3): from the axes of bodies to those in the plane.
inline void leave_plane(const Array& turn, const Array& frames, const Array& heights, const Output& x, const Output& R,
                        const Output& v, const Output& w, const Output& a, const Output& alpha) {
  const size_t n = heights.size(), count = x.size() / 3;
  require(turn.size() == 9 && n > 0 && frames.size() == 9 * n && count % n == 0 && R.size() == 9 * count,
          "one height and one frame a body, and attitudes of all states");
  for (const Output* each : {&v, &w, &a, &alpha}) require(each->size() == 3 * count, "all vectors of all states");
  const Mat3 back = mat3(turn.data()).transpose();
  const auto apply = [](const Mat3& by, const Output& all, size_t at) {
    Eigen::Map<Vec3> one(all.data() + 3 * at);
    one = Vec3(by * one);
  };
  for (size_t k = 0; k < count; ++k) {
    const Mat3 frame = mat3(frames.data() + 9 * (k % n)), own = frame.transpose();
    x.data()[3 * k + 2] += heights.data()[k % n];
    for (const Output* each : {&x, &v, &a}) apply(back, *each, k);
    for (const Output* each : {&w, &alpha}) apply(own, *each, k);
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> attitude(R.data() + 9 * k);
    attitude = Mat3(back * mat3(R.data() + 9 * k) * frame);
  }
}

}  // namespace lieeuler
