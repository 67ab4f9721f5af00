// Keeps energy and angular momentum of bodies on which nothing acts, in twice the digits: equation (13.2) of
// docs/theory.md, by the least change of w and then the least turn.
#pragma once

#include "linalg/compensated.hpp"
#include "model/system.hpp"

namespace lieeuler {

class FreeBodies {
 public:
  explicit FreeBodies(const System& system, bool wanted) : system_(system) {
    if (!wanted) return;
    std::vector<char> held(system.n() + 1, 0);
    for (const Joint& joint : system.joints) held[joint.parent] = held[joint.child] = 1;
    for (const Force& force : system.forces) held[force.parent] = held[force.child] = 1;
    for (int b = 0; b < system.n(); ++b)
      if (!held[b] && system.bodies[b].spin.isZero(0)) bodies_.push_back({b});
  }

  void start(const State& state) {
    for (Kept& kept : bodies_) {
      const Vec3& w = state.u[kept.body].w;
      kept.start = invariants(system_.bodies[kept.body].inertia, w);
      kept.momentum = state.frames[kept.body].R * angular_momentum(system_.bodies[kept.body], w);
    }
  }

  // One correction; it leaves the square of the step's error and the rounding of w.
  void restore(State& state) const {
    for (const Kept& kept : bodies_) {
      const Body& body = system_.bodies[kept.body];
      Vec3& w = state.u[kept.body].w;
      const Invariants here = invariants(body.inertia, w);
      const Vec3 slope = times(body.inertia, w), other = 2 * times(body.inertia, slope);  // of energy and square
      const double size = slope.norm(), other_size = other.norm();
      if (!(size > 0)) continue;  // at rest
      const Vec3 a = slope / size, b = other / other_size, normal = a.cross(b);
      const double residual = here.energy.less(kept.start.energy) / size;
      const double rest = here.square.less(kept.start.square) / other_size - a.dot(b) * residual;
      w -= residual * a;
      // About a principal axis both slopes have the same direction, and the first correction is the only one.
      if (normal.squaredNorm() > kParallel) w -= rest / normal.squaredNorm() * normal.cross(a);
      Frame& frame = state.frames[kept.body];
      const Vec3 L = frame.R * angular_momentum(body, w);
      frame.R = polished(frame.R + hat(L.cross(kept.momentum) / L.squaredNorm()) * frame.R);
    }
  }

 private:
  static constexpr double kParallel = 1e-20;  // squared sine of the angle between the slopes

  // A value and its rounding error.
  struct Twice {
    double value, rest;
    double less(const Twice& other) const { return (value - other.value) + (rest - other.rest); }
  };
  struct Invariants {
    Twice energy, square;  // w . J w / 2 and |J w|^2
  };
  struct Kept {
    int body;
    Invariants start = {};
    Vec3 momentum = Vec3::Zero();
  };

  static Twice product(const Vec3& a, const Vec3& b) {
    const double value = a.dot(b);
    return {value, dot_accurately(a, b, -value)};
  }
  static Invariants invariants(const Mat3& J, const Vec3& w) {
    Vec3 L, rest;
    for (int i = 0; i < 3; ++i) {
      const Twice entry = product(J.row(i).transpose(), w);
      L[i] = entry.value, rest[i] = entry.rest;
    }
    Twice energy = product(w, L), square = product(L, L);
    energy.rest += w.dot(rest), square.rest += 2 * L.dot(rest);
    return {{0.5 * energy.value, 0.5 * energy.rest}, square};
  }

  const System& system_;
  std::vector<Kept> bodies_;
};

}  // namespace lieeuler
