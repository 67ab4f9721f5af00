// The sizes of a system, from its bodies, joints and forces, and in motion. They scale with the units: no absolute
// length or time enters.
#pragma once

#include "model/forces.hpp"

namespace lieeuler {

inline void enlarge(double& size, double other) { size = std::max(size, other); }

inline double largest_mobility(const Mat3& inertia_inverse) { return inertia_inverse.diagonal().maxCoeff(); }

// A body: its polar radius of gyration, so that a body without joints has a length too.
inline void measure(System& system, const Body& body) {
  enlarge(system.length, std::sqrt(0.5 * body.inertia.trace() / body.mass));
}

// A joint: how far its anchors lie from the centres of mass, and how far apart it keeps them.
inline void measure(System& system, const Joint& joint) {
  for (const Vec3& anchor : {joint.parent_anchor, joint.child_anchor}) enlarge(system.length, anchor.norm());
  for (const Part& part : joint.parts) {
    if (part.contact) enlarge(system.length, part.contact->radius);
    for (const DotRow& dot : part.dots) {
      const int differences = (dot.a == Carrier::difference) + (dot.b == Carrier::difference);
      const double product = dot.scale == 0 ? 0 : std::abs(dot.constant / dot.scale);
      if (differences == 1) enlarge(system.length, product);
      if (differences == 2) enlarge(system.length, std::sqrt(product));
    }
  }
}

// A force: where it acts, and the rates and accelerations that it gives its bodies.
inline void measure(System& system, const Force& force) {
  enlarge(system.length, force.parent_point.norm()), enlarge(system.length, force.child_point.norm());
  if (force.kind == Force::Kind::linear_spring) enlarge(system.length, std::abs(force.rest));
  double translation = 0, rotation = 0;  // accelerations by a unit force and a unit torque
  for (int b : {force.parent, force.child}) {
    if (b == system.n()) continue;
    const Vec3& point = b == force.parent ? force.parent_point : force.child_point;
    const double turns = largest_mobility(system.bodies[b].inertia_inverse);
    rotation += turns;
    translation += 1 / system.bodies[b].mass + turns * point.squaredNorm();
  }
  const double drive = force.drive ? force.drive->size() : 1;
  if (force.kind == Force::Kind::load) {
    enlarge(system.acceleration, translation * drive * force.force.norm());
    enlarge(system.angular_acceleration, rotation * drive * force.torque.norm());
    return;
  }
  if (force.kind == Force::Kind::slide_force) return enlarge(system.acceleration, translation * drive);
  if (force.drive) enlarge(system.angular_acceleration, rotation * drive);
  const double mobility = force.kind == Force::Kind::linear_spring ? translation : rotation;
  enlarge(system.frequency, std::max(std::sqrt(force.stiffness * mobility), force.damping * mobility));
}

// A length (m) and a rate (1/s) that make errors of translations, rotations and their rates comparable. They scale with
// the units of length and time and do not depend on the unit of mass.
struct Scales {
  double length = 1, rate = 1;

  // The rate is at least the one that weight and loads produce, and at least `slowest`: a system at rest for a moment
  // need not be followed to the last digit of its speed.
  static Scales of(const System& system, const State& state, double slowest) {
    Scales scales = of_motion(system, state);
    scales.rate = std::max({scales.rate, scales.falling(system), slowest});
    return scales;
  }
  // From the present motion alone.
  static Scales of_motion(const System& system, const State& state) {
    Scales scales{system.length, 0};
    for (int b = 0; b < system.n(); ++b)
      scales.length = std::max(scales.length, state.frames[b].x.cwiseAbs().maxCoeff());
    for (int b = 0; b < system.n(); ++b) scales.rate = std::max(scales.rate, scales.rate_of(state.u[b]));
    return scales;
  }
  // The rate of a system that does not move yet, 1/s: that of a fall over `length`, or a small part of the springs'
  // frequency.
  double natural(const System& system) const { return std::max(falling(system), kSlow * system.frequency); }

  // The larger of a body's two rates, 1/s.
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
  static constexpr double kFall = 0.3;   // part of sqrt(g / length); gives 1 rad/s for one metre on the Earth
  static constexpr double kSlow = 1e-3;  // part of a spring's frequency

  double falling(const System& system) const {
    const double fall = std::max(system.gravity.norm(), system.acceleration) / length;
    return kFall * std::sqrt(std::max(fall, system.angular_acceleration));
  }
};

}  // namespace lieeuler
