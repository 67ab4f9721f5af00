// Applied forces: gravity, springs, dampers, constant loads; their potential and their derivatives.
#pragma once

#include <numbers>

#include "joints.hpp"

namespace lieeuler {

// Derivatives of the force on one side of a pair with respect to q and u of another side.
struct Linearised {
  Stiffness q[2][2], u[2][2];
};

// One force at one configuration. `last_angle`: of a torsional spring at the last accepted step, to unwrap against.
class ForceState {
 public:
  ForceState(const Force& force, const std::vector<Frame>& frames, const std::vector<Twist>& u, double last_angle)
      : force_(force), parent_(frames[force.parent]), child_(frames[force.child]),
        u_{&u[force.parent], &u[force.child]} {
    switch (force.kind) {
      case Force::Kind::linear_spring: stretch(frames); break;
      case Force::Kind::torsional_spring: twist(last_angle); break;
      case Force::Kind::load: break;
    }
  }

  // Length of a linear spring, unwrapped angle of a torsional one.
  double extent() const { return extent_; }

  double potential() const {
    const double stretch = extent_ - force_.rest;
    return 0.5 * force_.stiffness * stretch * stretch;  // a load has stiffness zero: it is not counted as energy
  }

  // Adds force (world) and torque (body axes) on both sides.
  void add_to(Twist& parent, Twist& child) const {
    if (force_.kind == Force::Kind::load) {
      const Vec3 F = world_force();
      child.v += F;
      child.w += force_.child_point.cross(child_.R.transpose() * F) + body_torque();
      return;
    }
    const double size = tension();
    parent.v -= size * gradient_[kParent].v, parent.w -= size * gradient_[kParent].w;
    child.v -= size * gradient_[kChild].v, child.w -= size * gradient_[kChild].w;
  }

  Linearised linearised() const {
    Linearised out;
    if (force_.kind == Force::Kind::load) {
      linearise_load(out.q[kChild][kChild]);
      return out;
    }
    // f = -F g with F = k (extent - rest) + c rate, g = d extent/dq, rate = g u.
    const double size = tension();
    for (Side row : kSides)
      for (Side column : kSides) {
        const Twist& g = gradient_[row];
        const Twist slope{force_.stiffness * gradient_[column].v + force_.damping * rate_slope_[column].v,
                          force_.stiffness * gradient_[column].w + force_.damping * rate_slope_[column].w};
        subtract_outer(out.q[row][column], g, slope);
        subtract(out.q[row][column], size, curvature_[row][column]);
        subtract_outer(out.u[row][column], g,
                       {force_.damping * gradient_[column].v, force_.damping * gradient_[column].w});
      }
    return out;
  }

 private:
  double tension() const { return force_.stiffness * (extent_ - force_.rest) + force_.damping * rate_; }
  Vec3 world_force() const { return force_.in_world ? force_.force : Vec3(child_.R * force_.force); }
  Vec3 body_torque() const { return force_.in_world ? Vec3(child_.R.transpose() * force_.torque) : force_.torque; }

  void linearise_load(Stiffness& K) const {
    if (!force_.in_world) {
      K.vw = -child_.R * hat(force_.force);
      return;
    }
    K.ww = hat(force_.child_point) * hat(child_.R.transpose() * force_.force) + hat(child_.R.transpose() * force_.torque);
  }

  // Length of a linear spring: from half its square, a distance row. A spring of zero length exerts no force.
  void stretch(const std::vector<Frame>& frames) {
    static const Part half_square{false, {{Carrier::difference, Carrier::difference, Vec3::Zero(), Vec3::Zero(), 0, 0.5}}, 0};
    const Joint ends{force_.parent, force_.child, force_.parent_point, force_.child_point, {}};
    JointState line;
    line.update(ends, frames);
    extent_ = std::sqrt(2 * line.position(half_square)[0]);
    if (extent_ == 0) {
      extent_ = force_.rest;  // no tension
      return;
    }
    const double inverse = 1 / extent_;
    rate_ = inverse * line.velocity(half_square, *u_[kParent], *u_[kChild])[0];
    for (Side side : kSides) {
      const Rows G = line.jacobian(half_square, side);
      const Rows N = line.velocity_slope(half_square, side, *u_[kParent], *u_[kChild], false);
      gradient_[side] = {inverse * G.v.row(0).transpose(), inverse * G.w.row(0).transpose()};
      rate_slope_[side] = {inverse * (N.v.row(0).transpose() - rate_ * gradient_[side].v),
                           inverse * (N.w.row(0).transpose() - rate_ * gradient_[side].w)};
    }
    for (Side row : kSides)
      for (Side column : kSides) {
        Stiffness& K = curvature_[row][column];
        K = line.geometric_stiffness(half_square, row, column, Vec3(inverse, 0, 0));
        subtract_outer(K, {inverse * gradient_[row].v, inverse * gradient_[row].w}, gradient_[column]);
      }
  }

  // Angle of the child about the parent's axis, and its derivatives where the axes coincide, as the joint keeps them.
  void twist(double last_angle) {
    const Mat3 relative = parent_.R.transpose() * child_.R;
    const Vec3 pointer = relative * force_.pointer;
    const double wrapped = std::atan2(force_.second_normal.dot(pointer), force_.normal.dot(pointer));
    extent_ = last_angle + std::remainder(wrapped - last_angle, 2 * std::numbers::pi);
    const Vec3 seen = relative.transpose() * force_.axis;  // the axis in the child
    gradient_[kParent].w = -force_.axis, gradient_[kChild].w = seen;
    rate_ = seen.dot(u_[kChild]->w) - force_.axis.dot(u_[kParent]->w);
    const Mat3 by_child = hat(seen), by_parent = -relative.transpose() * hat(force_.axis);  // derivatives of `seen`
    curvature_[kChild][kChild].ww = by_child, curvature_[kChild][kParent].ww = by_parent;
    rate_slope_[kChild].w = by_child.transpose() * u_[kChild]->w;
    rate_slope_[kParent].w = by_parent.transpose() * u_[kChild]->w;
  }

  static void subtract_outer(Stiffness& K, const Twist& a, const Twist& b) {
    K.vv -= a.v * b.v.transpose(), K.vw -= a.v * b.w.transpose();
    K.wv -= a.w * b.v.transpose(), K.ww -= a.w * b.w.transpose();
  }
  static void subtract(Stiffness& K, double factor, const Stiffness& other) {
    K.vv -= factor * other.vv, K.vw -= factor * other.vw, K.wv -= factor * other.wv, K.ww -= factor * other.ww;
  }

  const Force& force_;
  const Frame &parent_, &child_;
  const Twist* u_[2];
  double extent_ = 0, rate_ = 0;
  Twist gradient_[2], rate_slope_[2];  // d extent/dq, d rate/dq
  Stiffness curvature_[2][2];          // d gradient/dq
};

// Force and torque on every body without -w x J w: what the Hamiltonian methods use.
inline void applied_forces(const System& system, const std::vector<Frame>& frames, const std::vector<Twist>& u,
                           const std::vector<double>& last_angles, std::vector<Twist>& f) {
  for (int b = 0; b < system.n(); ++b) f[b] = {system.bodies[b].mass * system.gravity, Vec3::Zero()};
  f[system.n()] = Twist{};
  for (size_t k = 0; k < system.forces.size(); ++k) {
    const Force& force = system.forces[k];
    ForceState(force, frames, u, last_angles[k]).add_to(f[force.parent], f[force.child]);
  }
}

// The right-hand side f(q, u) of the Lagrangian equations.
inline void generalized_forces(const System& system, const std::vector<Frame>& frames, const std::vector<Twist>& u,
                               const std::vector<double>& last_angles, std::vector<Twist>& f) {
  applied_forces(system, frames, u, last_angles, f);
  for (int b = 0; b < system.n(); ++b) f[b].w -= u[b].w.cross(times(system.bodies[b].inertia, u[b].w) + system.bodies[b].spin);
}

// Angles of the torsional springs (zero for other forces), unwrapped against the last ones.
inline void update_angles(const System& system, const std::vector<Frame>& frames, const std::vector<Twist>& u,
                          std::vector<double>& angles) {
  for (size_t k = 0; k < system.forces.size(); ++k)
    if (system.forces[k].kind == Force::Kind::torsional_spring)
      angles[k] = ForceState(system.forces[k], frames, u, angles[k]).extent();
}

}  // namespace lieeuler
