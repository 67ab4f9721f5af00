// Applied forces: gravity, springs, dampers, loads; their potential and their derivatives.
#pragma once

#include <numbers>

#include "model/joints.hpp"
#include "model/own_force.hpp"

namespace lieeuler {

// One force at one configuration; its derivatives are computed on request.
class ForceState {
 public:
  // `last_angle`: that of a torsional spring at the last accepted step, for unwrapping.
  ForceState(const Force& force, const Configuration& frames, const std::vector<Twist>& u, double last_angle)
      : force_(force), frame_{&frames[force.parent], &frames[force.child]}, u_{&u[force.parent], &u[force.child]} {
    if (force.drive) drive_ = (*force.drive)(frames);
    if (force.kind == Force::Kind::linear_spring) stretch();
    if (force.kind == Force::Kind::torsional_spring) twist(last_angle);
    if (force.kind == Force::Kind::slide_force) push();
  }

  // Length of a linear spring, unwrapped angle of a torsional one, slide of a slide force.
  double extent() const { return extent_; }

  double potential() const {
    const double stretch = extent_ - force_.rest;
    return 0.5 * force_.stiffness * stretch * stretch;  // zero for a load, which has no stiffness
  }

  // Adds force (world) and torque (body axes) on both sides.
  void add_to(Twist& parent, Twist& child) const {
    if (force_.kind == Force::Kind::load) {
      Vec3 F = world_force();
      Vec3 torque = force_.child_point.cross(transposed_times(attitude(kChild), F)) + body_torque();
      if (force_.drive) F *= drive_, torque *= drive_;
      child.v += F;
      child.w += torque;
      return;
    }
    const double size = tension();
    parent -= size * gradient_[kParent], child -= size * gradient_[kChild];
  }

  // Derivatives of the force on one side with respect to q and u of another. The force is f = -F g with
  // F = k (extent - rest) + c rate, g = d extent/dq, rate = g u.
  Stiffness by_position(Side row, Side column) const {
    if (force_.kind == Force::Kind::linear_spring) return line_stiffness(row, column);
    if (force_.kind == Force::Kind::torsional_spring) return {.ww = twist_stiffness(row, column)};
    if (force_.kind == Force::Kind::slide_force) return slide_stiffness(row, column);
    if (row != kChild || column != kChild) return {};
    Stiffness K = load_stiffness();
    if (force_.drive) K.vw *= drive_, K.ww *= drive_;
    return K;
  }
  Stiffness by_velocity(Side row, Side column) const {
    if (force_.kind == Force::Kind::linear_spring || force_.kind == Force::Kind::slide_force)
      return between_points(row, column, (force_.damping * line_) * line_.transpose());
    return {.ww = -force_.damping * gradient_[row].w * gradient_[column].w.transpose()};
  }

 private:
  const Mat3& attitude(Side side) const { return frame_[side]->R; }
  const Vec3& point(Side side) const { return side == kChild ? force_.child_point : force_.parent_point; }
  static double sign(Side side) { return side == kChild ? 1 : -1; }
  double tension() const { return force_.stiffness * (extent_ - force_.rest) + force_.damping * rate_ - drive(); }
  // For springs: the force that acts against the tension.
  double drive() const { return force_.drive ? drive_ : 0; }
  Vec3 world_force() const { return force_.in_world ? force_.force : Vec3(attitude(kChild) * force_.force); }
  Vec3 body_torque() const {
    return force_.in_world ? Vec3(transposed_times(attitude(kChild), force_.torque)) : force_.torque;
  }

  Stiffness load_stiffness() const {
    const Mat3& R = attitude(kChild);
    if (!force_.in_world) return {.vw = -R * hat(force_.force)};
    return {.ww = hat(force_.child_point) * hat(transposed_times(R, force_.force)) +
                  hat(transposed_times(R, force_.torque))};
  }

  // From the parent's point to the child's, world; and the velocity of that vector.
  Vec3 separation() {
    Vec3 arm[2];
    for (Side side : kSides) {
      swing_[side] = u_[side]->w.cross(point(side));
      arm[side] = times(attitude(side), point(side));
    }
    speed_ = (u_[kChild]->v - u_[kParent]->v) +
             (times(attitude(kChild), swing_[kChild]) - times(attitude(kParent), swing_[kParent]));
    return (frame_[kChild]->x - frame_[kParent]->x) + (arm[kChild] - arm[kParent]);
  }
  // Along the line between the two points. A spring of zero length exerts no force.
  void stretch() {
    line_ = separation();
    extent_ = line_.norm();
    if (extent_ == 0) {
      extent_ = force_.rest;  // no tension
      return;
    }
    inverse_ = 1 / extent_;
    line_ *= inverse_;
    rate_ = line_.dot(speed_);
    pull();
  }
  // The gradients along the line.
  void pull() {
    for (Side side : kSides) {
      seen_[side] = transposed_times(attitude(side), line_);
      gradient_[side] = {sign(side) * line_, sign(side) * point(side).cross(seen_[side])};
    }
  }
  // K is minus the derivative of the force at one point with respect to the displacement of the other. Returns it for
  // the quasi-velocities of the bodies: a point moves with its body by v + R (w x s), with a minus for the parent's.
  Stiffness between_points(Side row, Side column, const Mat3& K) const {
    const double both = -sign(row) * sign(column);
    const Mat3 turned = K * (attitude(column) * hat(point(column)));
    const Mat3 lever = hat(point(row)) * attitude(row).transpose();
    return {both * K, -both * turned, both * lever * K, -both * lever * turned};
  }
  Stiffness line_stiffness(Side row, Side column) const {
    const double k = force_.stiffness, c = force_.damping, F = tension();
    const Mat3 across = inverse_ * (Mat3::Identity() - line_ * line_.transpose());  // how the line turns
    Stiffness K = between_points(row, column, line_ * (k * line_ + c * across * speed_).transpose() + F * across);
    if (c != 0) {
      const Eigen::RowVector3d turn = c * sign(column) * swing_[column].cross(seen_[column]).transpose();
      K.vw -= gradient_[row].v * turn, K.ww -= gradient_[row].w * turn;
    }
    if (row == column) K.ww -= sign(row) * F * hat(point(row)) * hat(seen_[row]);
    return K;
  }

  // Angle of the child about the parent's axis, and its derivatives where the axes coincide, as the joint keeps them.
  void twist(double last_angle) {
    const Mat3 relative = attitude(kParent).transpose() * attitude(kChild);
    const Vec3 pointer = relative * force_.pointer;
    const double wrapped = std::atan2(force_.second_normal.dot(pointer), force_.normal.dot(pointer));
    extent_ = last_angle + std::remainder(wrapped - last_angle, 2 * std::numbers::pi);
    gradient_[kParent].w = -force_.axis;
    gradient_[kChild].w = transposed_times(relative, force_.axis);  // the axis in the child
    rate_ = gradient_[kChild].w.dot(u_[kChild]->w) + gradient_[kParent].w.dot(u_[kParent]->w);
  }
  Mat3 twist_stiffness(Side row, Side column) const {
    // Slope of the axis in the child, the only part that depends on the attitudes.
    const Mat3 slope = column == kChild ? hat(gradient_[kChild].w)
                                        : Mat3(-attitude(kChild).transpose() * attitude(kParent) * hat(force_.axis));
    const Vec3 rate_slope = slope.transpose() * u_[kChild]->w;
    Mat3 K = -gradient_[row].w * (force_.stiffness * gradient_[column].w + force_.damping * rate_slope).transpose();
    if (row == kChild) K -= tension() * slope;
    return K;
  }

  // Along the parent's axis, at anchors that both lie on it.
  void push() {
    line_ = times(attitude(kParent), force_.axis);
    if (force_.stiffness != 0 || force_.damping != 0) {
      extent_ = line_.dot(separation());
      rate_ = line_.dot(speed_);
    }
    pull();
  }
  // The line of the force turns with the parent, and spring and damper change with the slide and its rate.
  Stiffness slide_stiffness(Side row, Side column) const {
    const double size = -tension();
    Stiffness K;
    if (column == kParent) {
      const Mat3 turn = -size * attitude(kParent) * hat(force_.axis);
      K.vw = sign(row) * turn;
      if (row == kChild) K.ww = hat(point(kChild)) * attitude(kChild).transpose() * turn;
    } else if (row == kChild) {
      K.ww = size * hat(point(kChild)) * hat(seen_[kChild]);
    }
    if (force_.stiffness == 0 && force_.damping == 0) return K;
    Vec3 turning = swing_[column].cross(seen_[column]) * sign(column);  // how the rate changes as a body turns
    if (column == kParent) turning += force_.axis.cross(transposed_times(attitude(kParent), speed_));
    const Twist by{force_.stiffness * gradient_[column].v,
                   Vec3(force_.stiffness * gradient_[column].w + force_.damping * turning)};
    K.vv -= gradient_[row].v * by.v.transpose(), K.vw -= gradient_[row].v * by.w.transpose();
    K.wv -= gradient_[row].w * by.v.transpose(), K.ww -= gradient_[row].w * by.w.transpose();
    return K;
  }

  const Force& force_;
  const Frame* frame_[2];
  const Twist* u_[2];
  double drive_ = 0;
  double extent_ = 0, rate_ = 0;
  Twist gradient_[2];  // d extent/dq
  // Of a linear spring: direction from parent to child, velocity of the child's point seen from the parent's (world);
  // of a slide force: the axis, and that velocity;
  // w x s and the direction in body axes; 1 / length.
  Vec3 line_ = Vec3::Zero(), speed_ = Vec3::Zero(), swing_[2], seen_[2] = {Vec3::Zero(), Vec3::Zero()};
  double inverse_ = 0;
};

// Adds springs, dampers and loads to f; the last entry, that of the ground, is set to zero first.
inline void add_forces(const System& system, const Configuration& frames, const std::vector<Twist>& u,
                       const std::vector<double>& last_angles, std::vector<Twist>& f) {
  f[system.n()] = Twist{};
  for (size_t k = 0; k < system.forces.size(); ++k) {
    const Force& force = system.forces[k];
    ForceState(force, frames, u, last_angles[k]).add_to(f[force.parent], f[force.child]);
  }
  if (!system.own.empty()) add_own_forces(system, frames, u, f);
}

// Force and torque on every body without -w x J w: what the Hamiltonian methods use.
inline void applied_forces(const System& system, const Configuration& frames, const std::vector<Twist>& u,
                           const std::vector<double>& last_angles, std::vector<Twist>& f) {
  for (int b = 0; b < system.n(); ++b) f[b] = {system.bodies[b].mass * system.gravity, Vec3::Zero()};
  add_forces(system, frames, u, last_angles, f);
}

// The largest angle by which a body may turn in a step, rad: `elsewhere`, or a quarter turn if angles are unwrapped
// from step to step, so that two bodies turn by less than half a turn relative to each other.
inline double most_turn(const System& system, double elsewhere) {
  const bool unwraps = std::any_of(system.forces.begin(), system.forces.end(),
                                   [](const Force& force) { return force.kind == Force::Kind::torsional_spring; });
  return unwraps ? 0.5 * std::numbers::pi : elsewhere;
}

// The right-hand side f(q, u) of the Lagrangian equations.
inline void generalized_forces(const System& system, const Configuration& frames, const std::vector<Twist>& u,
                               const std::vector<double>& last_angles, std::vector<Twist>& f) {
  for (int b = 0; b < system.n(); ++b) {
    const Body& body = system.bodies[b];
    f[b] = {body.mass * system.gravity, gyroscopic_torque(body, u[b].w)};
  }
  add_forces(system, frames, u, last_angles, f);
}

// Angles of the torsional springs (zero for other forces), unwrapped from the last ones.
inline void update_angles(const System& system, const Configuration& frames, const std::vector<Twist>& u,
                          std::vector<double>& angles) {
  for (size_t k = 0; k < system.forces.size(); ++k)
    if (system.forces[k].kind == Force::Kind::torsional_spring)
      angles[k] = ForceState(system.forces[k], frames, u, angles[k]).extent();
}

}  // namespace lieeuler
