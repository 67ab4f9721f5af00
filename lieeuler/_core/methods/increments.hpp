// The motion since a start, summed separately from the state, so that rounding errors are relative to the motion: x,
// R^T R' - I and u.
#pragma once

#include "model/kinematics.hpp"

namespace lieeuler {

struct Increment {
  Vec3 x = Vec3::Zero();
  Mat3 turn = Mat3::Zero();
  Twist u;
};

class Increments {
 public:
  explicit Increments(const System& system) : origin_(system) {}

  void keep() { sums_.resize(origin_.u.size() - 1); }
  bool kept() const { return !sums_.empty(); }
  const std::vector<Increment>& sums() const { return sums_; }
  const Twist& u(int b) const { return sums_[b].u; }

  void begin(const State& state) {
    std::fill(sums_.begin(), sums_.end(), Increment{});
    origin_ = state;
  }
  // Turns velocities relative to the start into velocities.
  void add_origin(int b, Twist& u) const { u.v += origin_.u[b].v, u.w += origin_.u[b].w; }
  // Adds a step of a body by x and I + turn; u are its velocities relative to the start. Returns its new frame.
  Frame add(int b, const Vec3& x, const Mat3& turn, const Twist& u) {
    Increment& sum = sums_[b];
    sum.x += x;
    sum.turn += turn + sum.turn * turn;
    sum.u = u;
    return {origin_.frames[b].x + sum.x, origin_.frames[b].R + origin_.frames[b].R * sum.turn};
  }

 private:
  std::vector<Increment> sums_;
  State origin_;
};

}  // namespace lieeuler
