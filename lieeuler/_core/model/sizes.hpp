// The sizes of a system, from its bodies, joints and forces. They scale with the units: no absolute length or time
// enters.
#pragma once

#include "model/system.hpp"

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

}  // namespace lieeuler
