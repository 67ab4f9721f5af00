// Builds a System from what Python gives.
#pragma once

#include <optional>
#include <tuple>

#include "model/system.hpp"
#include "python/arrays.hpp"

namespace lieeuler {

// The parent's index in the kernel, where the ground comes after the bodies.
inline int parent_of(const System& system, int parent, int child) {
  const int n = system.n();
  require(0 <= child && child < n && -1 <= parent && parent < n && parent != child, "there are no such two bodies");
  return parent < 0 ? n : parent;
}

// Dot rows are given flat: two carriers and two axes each.
inline void add_joint(System& system, int parent, int child, const Vec3& parent_anchor, const Vec3& child_anchor,
                      bool spherical, const std::vector<Carrier>& carriers, const std::vector<Vec3>& axes,
                      const std::vector<double>& constants, const std::vector<double>& scales) {
  const size_t dots = constants.size();
  require(axes.size() == 2 * dots && carriers.size() == 2 * dots && scales.size() == dots,
          "dot rows need two carriers, two axes, a constant and a scale each");
  Joint joint{parent_of(system, parent, child), child, parent_anchor, child_anchor, {}};
  int row = system.rows();
  auto add_part = [&](bool point) {
    joint.parts.push_back({point, {}, row});
    if (point) row += 3;
  };
  if (spherical) add_part(true);
  for (size_t k = 0; k < dots; ++k, ++row) {
    if (k % 3 == 0) add_part(false);
    joint.parts.back().dots.push_back(
        {carriers[2 * k], carriers[2 * k + 1], axes[2 * k], axes[2 * k + 1], constants[k], scales[k]});
  }
  system.joints.push_back(joint);
  measure(system, joint);
}

// A joint's angle about its axis, or its slide along it: whether it turns, the axis in the parent and in the child, two
// normals of the parent, and the first of them as the child sees it at zero.
using Coordinate = std::tuple<bool, Vec3, Vec3, Vec3, Vec3, Vec3>;

// The same as a row of its own.
inline Part coordinate_part(const Coordinate& coordinate, int row) {
  const auto& [turns, parent_axis, child_axis, normal, second_normal, pointer] = coordinate;
  const DotRow slide{Carrier::parent_axis, Carrier::difference, parent_axis};
  const DotRow unused{Carrier::parent_axis, Carrier::child_axis, parent_axis, child_axis};
  Part part{false, {turns ? unused : slide}, row};
  if (turns) part.turn = Turn{parent_axis, child_axis, normal, second_normal, pointer};
  return part;
}

// Adds a row to the last joint: its angle about the axis, or its slide along it, is a function of time.
inline void drive_joint(System& system, const Coordinate& coordinate, const TimeFunction& drive) {
  require(!system.joints.empty() && !system.joints.back().driven, "there is no joint to drive");
  Joint& joint = system.joints.back();
  Part part = coordinate_part(coordinate, system.rows());
  part.drive = drive;
  joint.parts.push_back(part), joint.driven = true;
}

// Adds rows to the last joint: height and slip of a contact with a plane of the ground.
inline void add_contact(System& system, Contact::Kind kind, const Vec3& normal, const Vec3& axis, double radius,
                        const std::vector<Vec3>& across) {
  require(!system.joints.empty() && system.joints.back().parent == system.n(),
          "a contact needs the ground as its parent");
  require(!across.empty() && across.size() <= 3, "a contact needs directions of slip");
  Joint& joint = system.joints.back();
  for (const std::vector<Vec3>& directions : {std::vector<Vec3>{normal}, across}) {
    Part part{false, {}, system.rows()};
    for (const Vec3& direction : directions)
      part.dots.push_back({Carrier::parent_axis, Carrier::difference, direction});
    part.contact = Contact{kind, normal, axis, radius};
    part.slips = !joint.parts.empty();
    joint.parts.push_back(part);
  }
  measure(system, joint);
}

// Makes the angle or slide of the last joint follow that of another joint, which add_leader() names.
inline void follow(System& system, const Coordinate& coordinate, double ratio, double offset) {
  require(!system.joints.empty() && !system.joints.back().follows, "there is no joint to follow another");
  Joint& joint = system.joints.back();
  Part part = coordinate_part(coordinate, system.rows());
  part.mimic = static_cast<int>(system.mimics.size());
  system.mimics.push_back({ratio, offset, std::get<0>(coordinate)});
  joint.parts.push_back(part), ++joint.others, joint.follows = true;
}

// Names the angle or slide that the mimic follows; call it after all joints and forces are added.
inline void add_leader(System& system, int mimic, int joint, const Coordinate& coordinate) {
  require(0 <= mimic && mimic < static_cast<int>(system.mimics.size()) && 0 <= joint &&
              joint < static_cast<int>(system.joints.size()),
          "a leader needs a joint and a follower");
  Part part = coordinate_part(coordinate, system.rows() + system.others());
  part.mimic = mimic;
  Joint& leader = system.joints[joint];
  leader.parts.push_back(part), ++leader.others;
  if (!part.turn) return;
  Force watched{Force::Kind::torsional_spring, leader.parent, leader.child};
  watched.axis = part.turn->parent_axis, watched.pointer = part.turn->pointer;
  watched.normal = part.turn->normal, watched.second_normal = part.turn->second_normal;
  system.mimics[mimic].angle = static_cast<int>(system.forces.size());
  system.forces.push_back(watched);
}

// Adds a rotor on a joint's angle or slide; call it after all joints are added.
inline void add_rotor(System& system, int joint, double inertia, const Coordinate& coordinate) {
  require(0 <= joint && joint < static_cast<int>(system.joints.size()) && inertia > 0,
          "a rotor needs a joint and mass");
  Part part = coordinate_part(coordinate, system.rows() + system.others());
  part.compliance = 1 / inertia;
  system.joints[joint].parts.push_back(part), ++system.joints[joint].others;
}

inline void add_force(System& system, const Force& force) {
  system.forces.push_back(force);
  measure(system, force);
}

inline void add_linear_spring(System& system, int parent, int child, const Vec3& parent_point, const Vec3& child_point,
                              double stiffness, double free_length, double damping) {
  Force force{Force::Kind::linear_spring, parent_of(system, parent, child), child};
  force.parent_point = parent_point, force.child_point = child_point;
  force.stiffness = stiffness, force.rest = free_length, force.damping = damping;
  add_force(system, force);
}

// axis, normal, second_normal: right-handed, in the parent; pointer: the normal in the child at angle zero.
inline void add_torsional_spring(System& system, int parent, int child, const Vec3& axis, const Vec3& normal,
                                 const Vec3& second_normal, const Vec3& pointer, double stiffness, double rest_angle,
                                 double damping, const std::optional<TimeFunction>& torque) {
  Force force{Force::Kind::torsional_spring, parent_of(system, parent, child), child};
  force.axis = axis, force.normal = normal, force.second_normal = second_normal, force.pointer = pointer;
  force.stiffness = stiffness, force.rest = rest_angle, force.damping = damping, force.drive = torque;
  add_force(system, force);
}

inline void add_slide_force(System& system, int parent, int child, const Vec3& parent_anchor, const Vec3& child_anchor,
                            const Vec3& axis, const TimeFunction& size, double stiffness, double rest, double damping) {
  Force force{Force::Kind::slide_force, parent_of(system, parent, child), child};
  force.parent_point = parent_anchor, force.child_point = child_anchor, force.axis = axis, force.drive = size;
  force.stiffness = stiffness, force.rest = rest, force.damping = damping;
  add_force(system, force);
}

inline void add_load(System& system, int child, const Vec3& point, const Vec3& value, const Vec3& torque, bool in_world,
                     const std::optional<TimeFunction>& factor) {
  Force force{Force::Kind::load, parent_of(system, -1, child), child};
  force.child_point = point, force.force = value, force.torque = torque, force.in_world = in_world;
  force.drive = factor;
  add_force(system, force);
}

// A function of the user's own by its address; it may couple all bodies, and depend on their velocities.
inline void add_own_force(System& system, std::uintptr_t address, std::uintptr_t user) {
  require(address != 0, "a force needs the address of its function");
  system.own.push_back({reinterpret_cast<OwnForce::Function>(address), reinterpret_cast<void*>(user)});
  if (system.own.size() > 1) return;
  for (int parent = 0; parent <= system.n(); ++parent)
    for (int child = 0; child < (parent == system.n() ? system.n() : parent); ++child) {
      Force pair{Force::Kind::own, parent, child};
      pair.damping = 1;
      system.forces.push_back(pair);
    }
}

}  // namespace lieeuler
