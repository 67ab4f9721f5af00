// Constraint rows of one joint at one configuration: Phi, G, gamma, and the second derivatives for Newton's matrix,
// (2.1) to (2.6) of docs/theory.md.
//
// All vectors below are in world axes. A carried vector z (see Carrier) changes with the quasi-velocities of body b as
// D z[u] = sign_b v_b + w_b^world x arm_b, and D_d D_u z = R_b (d x (w x local arm)): each constraint and its
// derivatives follow from these two by the product rule. Rows are evaluated in parts of up to three.
#pragma once

#include <numbers>
#include <utility>

#include "model/axis_rows.hpp"
#include "model/contact.hpp"

namespace lieeuler {

class JointState {
 public:
  // `frames` must outlive this object and must not move.
  void update(const Joint& joint, const Configuration& frames) {
    frame_[kParent] = &frames[joint.parent], frame_[kChild] = &frames[joint.child];
    anchor_[kParent] = &joint.parent_anchor, anchor_[kChild] = &joint.child_anchor;
    time_ = frames;
    for (Side side : kSides) arm_[side] = times(frame_[side]->R, *anchor_[side]);
    d_ = (frame_[kChild]->x - frame_[kParent]->x) + (arm_[kChild] - arm_[kParent]);
  }

  // The rows of one part are those of `axes`, which must outlive this object.
  void take(AxisRows& axes) { axes.update(frame_), axes_ = &axes; }

  const Mat3& attitude(Side side) const { return frame_[side]->R; }
  const Vec3& anchor(Side side) const { return *anchor_[side]; }

  Vec3 position(const Part& part) const {
    if (part.spherical) return d_;
    if (part.turn) return {angle_gap(part), 0, 0};
    if (part.contact) return contact(part).gap(d_);
    Vec3 phi = Vec3::Zero();
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      phi[r] = dot.scale * a(dot).value.dot(b(dot).value) - dot.constant;
    }
    if (part.drive) phi[0] -= (*part.drive)(time_);
    return phi;
  }

  // Sizes of the terms whose difference is a row of Phi: its rounding error is relative to them.
  Vec3 terms(const Part& part) const {
    double ends = 0;
    for (Side side : kSides) ends = std::max(ends, frame_[side]->x.norm() + arm_[side].norm());
    Vec3 sizes = Vec3::Constant(part.spherical ? ends : 0.0);
    if (part.drive) sizes[0] += std::abs((*part.drive)(time_));
    if (part.turn) return sizes + Vec3::Constant(std::numbers::pi);
    if (part.contact) return Vec3::Constant(ends + part.contact->radius);
    for (size_t r = 0; r < part.dots.size(); ++r) {
      const DotRow& dot = part.dots[r];
      const double first = dot.a == Carrier::difference ? ends : a(dot).value.norm();
      const double second = dot.b == Carrier::difference ? ends : b(dot).value.norm();
      sizes[r] += std::abs(dot.scale) * first * second + std::abs(dot.constant);
    }
    return sizes;
  }

  // dPhi/dt at u = 0: the velocity rows are G u plus this.
  Vec3 drift(const Part& part) const {
    return part.drive ? Vec3(-part.drive->derivative(time_, 1), 0, 0) : Vec3::Zero();
  }

  // G u
  Vec3 velocity(const Part& part, const Twist& parent, const Twist& child) const {
    if (part.spherical) return point_rate(kChild, child) - point_rate(kParent, parent);
    return dot_velocity(part, parent, child);
  }

  // impulse -= G^T lam
  void subtract_reaction(const Part& part, const Vec3& lam, Twist& parent, Twist& child) const {
    if (part.spherical) {
      child.v -= lam, parent.v += lam;
      child.w -= anchor_[kChild]->cross(transposed_times(frame_[kChild]->R, lam));
      parent.w += anchor_[kParent]->cross(transposed_times(frame_[kParent]->R, lam));
      return;
    }
    subtract_dot_reaction(part, lam, parent, child);
  }

  // impulse -= (G - Gn)^T lam, with Gn that of `before`. Of a spherical part only the rotations change G.
  void subtract_reaction_change(const Part& part, const JointState& before, const Vec3& lam, Twist& parent,
                                Twist& child) const {
    if (!part.spherical) {
      subtract_reaction(part, lam, parent, child);
      return before.subtract_reaction(part, -lam, parent, child);
    }
    for (Side side : kSides) {
      const Vec3 torque = anchor_[side]->cross(transposed_times(frame_[side]->R - before.frame_[side]->R, lam));
      if (side == kChild)
        child.w -= torque;
      else
        parent.w += torque;
    }
  }

  // Rows of G for one side.
  Rows jacobian(const Part& part, Side side) const {
    Rows G;
    const Mat3& R = frame_[side]->R;
    if (part.spherical) {
      G.v.diagonal().setConstant(side == kChild ? 1 : -1);
      G.w = anchor_jacobian(side);
      return G;
    }
    if (const AxisRows* axes = axes_of(part)) {
      G.w = axes->jacobian(side);
      return G;
    }
    if (part.turn) {
      G.w.row(0) = side == kChild ? part.turn->child_axis : -part.turn->parent_axis;
      return G;
    }
    if (part.contact) {
      if (side == kChild) G = contact(part).jacobian();
      return G;  // here as everywhere, so that it is built in place
    }
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const Carried A = a(dot), B = b(dot);
      G.v.row(r) = dot.scale * (A.sign[side] * B.value + B.sign[side] * A.value).transpose();
      G.w.row(r) = dot.scale * (A.arm[side].cross(B.value) + B.arm[side].cross(A.value)).transpose() * R;
    }
    return G;
  }

  // gamma = (d/dt G) u; for a driven row plus the second derivative of its function of time
  Vec3 gamma(const Part& part, const Twist& parent, const Twist& child) const {
    if (part.spherical) return point_second(kChild, child.w) - point_second(kParent, parent.w);
    Vec3 out = Vec3::Zero();
    if (part.drive) out[0] = -part.drive->derivative(time_, 2);
    if (part.turn) return out;
    if (part.contact) return contact(part).gamma(child);
    const Rates u(*this, parent, child);
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const Carried A = a(dot), B = b(dot);
      out[r] += dot.scale * (u.second(A).dot(B.value) + 2 * u.first(A).dot(u.first(B)) + A.value.dot(u.second(B)));
    }
    return out;
  }

  // With B(u, d) = D_d (G u): the rows of B(u, .), that is d(G u)/dq, restricted to one side; with both_orders the
  // rows of B(., u) are added, which gives d(gamma)/du.
  Rows velocity_slope(const Part& part, Side side, const Twist& parent, const Twist& child, bool both_orders) const {
    const Mat3& R = frame_[side]->R;
    const Vec3& w = side == kChild ? child.w : parent.w;
    Rows N;
    if (part.spherical) {
      N.w = both_orders ? anchor_second_slope(side, w) : anchor_rate_slope(side, w);
      return N;
    }
    if (part.turn) return N;
    if (part.contact) {
      if (side == kChild) N = contact(part).velocity_slope(child, both_orders);
      return N;
    }
    if (const AxisRows* axes = axes_of(part); axes && !both_orders) {
      N.w = axes->velocity_slope(side, w, side == kChild ? parent.w : child.w);
      return N;
    }
    const Rates u(*this, parent, child);
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const Carried A = a(dot), B = b(dot);
      const Vec3 dA = u.first(A), dB = u.first(B);
      const double factor = dot.scale * (both_orders ? 2 : 1);
      N.v.row(r) = factor * (A.sign[side] * dB + B.sign[side] * dA).transpose();
      Eigen::RowVector3d turn = factor * (A.arm[side].cross(dB) + B.arm[side].cross(dA)).transpose() * R;
      for (const auto& [z, other] : {std::pair{&A, &B}, std::pair{&B, &A}}) {
        const Vec3 s = R.transpose() * z->arm[side], l = R.transpose() * other->value;
        turn += dot.scale * l.transpose() * arm_slope(s, w, both_orders);
      }
      N.w.row(r) = turn;
    }
    return N;
  }

  // The only block of d(G^T lam)/dq a spherical part has on one side, rotations against rotations:
  // +- hat(s) hat(R^T lam), written out. Inlined: calls cost 1 % of a step of DAE3L_LE.
  [[gnu::always_inline]] Mat3 anchor_stiffness(Side side, const Vec3& lam) const {
    const Vec3& s = *anchor_[side];
    const Vec3 l = transposed_times(frame_[side]->R, side == kChild ? lam : Vec3(-lam));
    Mat3 K = l * s.transpose();
    K.diagonal().array() -= s.dot(l);
    return K;
  }
  // G of a spherical part against rotations, R hat(-+ s), and its slope d(G u)/dq, +- R hat(s x w).
  Mat3 anchor_jacobian(Side side) const {
    return turned(side, side == kChild ? Vec3(-*anchor_[side]) : *anchor_[side]);
  }
  Mat3 anchor_rate_slope(Side side, const Vec3& w) const {
    const Vec3& s = *anchor_[side];
    return turned(side, side == kChild ? s.cross(w) : w.cross(s));
  }

  // That slope with both orders (velocity_slope).
  Mat3 anchor_second_slope(Side side, const Vec3& w) const {
    const Mat3 slope = frame_[side]->R * arm_slope(*anchor_[side], w, true);
    return side == kChild ? slope : Mat3(-slope);
  }

  // anchor_rate_slope times a direction d.
  Vec3 anchor_rate_change(Side side, const Vec3& w, const Vec3& d) const {
    const Vec3& s = *anchor_[side];
    return times(frame_[side]->R, (side == kChild ? s.cross(w) : w.cross(s)).cross(d));
  }

  // The block of d(G^T lam)/dq of one side's rotations alone.
  Mat3 own_stiffness(const Part& part, Side side, const Vec3& lam) const {
    if (part.spherical) return anchor_stiffness(side, lam);
    Mat3 K = Mat3::Zero();
    if (part.turn) return K;  // the torques are constant in both bodies
    if (part.contact) return side == kChild ? contact(part).stiffness(lam).ww : K;
    if (const AxisRows* axes = axes_of(part)) return axes->own_stiffness(side, lam);
    const Mat3& R = frame_[side]->R;
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const Carried A = a(dot), B = b(dot);
      const Vec3 arm_a = transposed_times(R, A.arm[side]), arm_b = transposed_times(R, B.arm[side]);
      const Vec3 first = transposed_times(R, A.value), second = transposed_times(R, B.value);
      const double l = dot.scale * lam[r];
      K += l * ((second - arm_b) * arm_a.transpose() + (first - arm_a) * arm_b.transpose());
      K.diagonal().array() += l * (2 * arm_a.dot(arm_b) - arm_a.dot(second) - arm_b.dot(first));
    }
    return K;
  }

  // The change of G^T lam on one side by small motions of both bodies, except that of the torque by the own rotation,
  // which own_stiffness gives.
  Twist coupled_reaction(const Part& part, Side side, const Vec3& lam, const Twist& parent, const Twist& child) const {
    Twist change;
    if (part.turn) return change;
    if (const AxisRows* axes = axes_of(part)) {
      change.w = axes->coupled_torque(side, lam, side == kChild ? parent.w : child.w);
      return change;
    }
    const Rates all(*this, parent, child);
    Rates others = all;
    others.w[side].setZero();
    for (int r = 0; r < part.rows(); ++r) {
      const double l = part.dots[r].scale * lam[r];
      const Carried A = a(part.dots[r]), B = b(part.dots[r]);
      change.v += l * (A.sign[side] * all.first(B) + B.sign[side] * all.first(A));
      change.w += l * (A.arm[side].cross(others.first(B)) + B.arm[side].cross(others.first(A)));
    }
    change.w = transposed_times(frame_[side]->R, change.w);
    return change;
  }

  // d(G^T lam)/dq, the block of one side's rows and another side's columns.
  Stiffness geometric_stiffness(const Part& part, Side row, Side column, const Vec3& lam) const {
    Stiffness K;
    const Mat3 &Rr = frame_[row]->R, &Rc = frame_[column]->R;
    if (part.spherical) {
      if (row == column) K.ww = anchor_stiffness(row, lam);
      return K;
    }
    if (part.turn) return K;  // the torques are constant in both bodies
    if (part.contact) {
      if (row == kChild && column == kChild) K = contact(part).stiffness(lam);
      return K;
    }
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const double l = dot.scale * lam[r];
      const Carried A = a(dot), B = b(dot);
      const Mat3 Ar = -hat(A.arm[row]) * Rr, Br = -hat(B.arm[row]) * Rr;
      const Mat3 Ac = -hat(A.arm[column]) * Rc, Bc = -hat(B.arm[column]) * Rc;
      const double ar = A.sign[row], br = B.sign[row], ac = A.sign[column], bc = B.sign[column];
      K.vv += l * (ar * bc + br * ac) * Mat3::Identity();
      K.vw += l * (ar * Bc + br * Ac);
      K.wv += l * (Ar.transpose() * bc + Br.transpose() * ac);
      if (row != column) K.ww += l * (Ar.transpose() * Bc + Br.transpose() * Ac);
    }
    if (row == column) K.ww = own_stiffness(part, row, lam);
    return K;
  }

 private:
  // Not inlined: velocity() of a spherical part would save and restore the registers that this needs.
  [[gnu::noinline]] Vec3 dot_velocity(const Part& part, const Twist& parent, const Twist& child) const {
    if (const AxisRows* axes = axes_of(part)) return axes->velocity(parent.w, child.w);
    if (part.turn) return {part.turn->child_axis.dot(child.w) - part.turn->parent_axis.dot(parent.w), 0, 0};
    if (part.contact) return contact(part).velocity(child);
    const Rates u(*this, parent, child);
    Vec3 rate = Vec3::Zero();
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const Carried A = a(dot), B = b(dot);
      rate[r] = dot.scale * (u.first(A).dot(B.value) + A.value.dot(u.first(B)));
    }
    return rate;
  }
  [[gnu::noinline]] void subtract_dot_reaction(const Part& part, const Vec3& lam, Twist& parent, Twist& child) const {
    if (const AxisRows* axes = axes_of(part)) return axes->subtract_reaction(lam, parent.w, child.w);
    if (part.turn) {
      child.w -= lam[0] * part.turn->child_axis, parent.w += lam[0] * part.turn->parent_axis;
      return;
    }
    if (part.contact) return contact(part).subtract_reaction(lam, child);
    Vec3 force[2] = {Vec3::Zero(), Vec3::Zero()}, torque[2] = {Vec3::Zero(), Vec3::Zero()};
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const double l = dot.scale * lam[r];
      const Carried A = a(dot), B = b(dot);
      for (Side side : kSides) {
        force[side] += l * (A.sign[side] * B.value + B.sign[side] * A.value);
        torque[side] += l * (A.arm[side].cross(B.value) + B.arm[side].cross(A.value));
      }
    }
    parent.v -= force[kParent], parent.w -= transposed_times(frame_[kParent]->R, torque[kParent]);
    child.v -= force[kChild], child.w -= transposed_times(frame_[kChild]->R, torque[kChild]);
  }
  const AxisRows* axes_of(const Part& part) const { return axes_ && axes_->part == &part ? axes_ : nullptr; }
  // R hat(s), by columns.
  Mat3 turned(Side side, const Vec3& s) const {
    const Mat3& R = frame_[side]->R;
    Mat3 m;
    m.col(0) = s.z() * R.col(1) - s.y() * R.col(2);
    m.col(1) = s.x() * R.col(2) - s.z() * R.col(0);
    m.col(2) = s.y() * R.col(0) - s.x() * R.col(1);
    return m;
  }

  struct Carried {
    Vec3 value = Vec3::Zero();
    double sign[2] = {0, 0};
    Vec3 arm[2] = {Vec3::Zero(), Vec3::Zero()};
  };
  Carried a(const DotRow& dot) const { return carried(dot.a, dot.a_local); }
  Carried b(const DotRow& dot) const { return carried(dot.b, dot.b_local); }
  Carried carried(Carrier carrier, const Vec3& local) const {
    Carried z;
    if (carrier == Carrier::difference) {
      z.value = d_;
      z.sign[kParent] = -1, z.sign[kChild] = 1;
      z.arm[kParent] = -arm_[kParent], z.arm[kChild] = arm_[kChild];
    } else {
      const Side side = carrier == Carrier::child_axis ? kChild : kParent;
      z.value = z.arm[side] = frame_[side]->R * local;
    }
    return z;
  }

  // First and second time derivatives of a carried vector, the second without accelerations.
  struct Rates {
    Vec3 v[2], w[2];  // world
    Rates(const JointState& joint, const Twist& parent, const Twist& child)
        : v{parent.v, child.v}, w{times(joint.frame_[kParent]->R, parent.w), times(joint.frame_[kChild]->R, child.w)} {}
    Vec3 first(const Carried& z) const {
      return z.sign[kParent] * v[kParent] + w[kParent].cross(z.arm[kParent]) + z.sign[kChild] * v[kChild] +
             w[kChild].cross(z.arm[kChild]);
    }
    Vec3 second(const Carried& z) const {
      return w[kParent].cross(w[kParent].cross(z.arm[kParent])) + w[kChild].cross(w[kChild].cross(z.arm[kChild]));
    }
  };
  // Velocity of an anchor, and the part of its acceleration that comes from the velocity.
  Vec3 point_rate(Side side, const Twist& u) const { return u.v + times(frame_[side]->R, u.w.cross(*anchor_[side])); }
  Vec3 point_second(Side side, const Vec3& w) const { return times(frame_[side]->R, w.cross(w.cross(*anchor_[side]))); }
  // d x (w x s) as a matrix on d; with both orders w x (d x s) is added.
  static Mat3 arm_slope(const Vec3& s, const Vec3& w, bool both_orders) {
    Mat3 slope = hat(s.cross(w));
    if (both_orders) slope -= hat_product(w, s);
    return slope;
  }

  // Cold: inlined, the rows of contacts would take registers from those of all other joints.
  [[gnu::noinline, gnu::cold]] ContactState contact(const Part& part) const {
    return {part, frame_[kChild]->R, arm_[kChild]};
  }

  // The angle minus the prescribed one, in [-pi, pi].
  double angle_gap(const Part& part) const {
    const Turn& turn = *part.turn;
    const Vec3 pointer = transposed_times(frame_[kParent]->R, frame_[kChild]->R * turn.pointer);
    const double angle = std::atan2(turn.second_normal.dot(pointer), turn.normal.dot(pointer));
    return std::remainder(angle - (part.drive ? (*part.drive)(time_) : 0), 2 * std::numbers::pi);
  }

  const Frame* frame_[2];
  const AxisRows* axes_ = nullptr;
  Moment time_;
  const Vec3* anchor_[2];
  Vec3 arm_[2], d_;
};

// All joints at one configuration.
class Constraints {
 public:
  explicit Constraints(const System& system) : system_(&system), states_(system.joints.size()) {
    for (int j = 0; j < static_cast<int>(states_.size()); ++j)
      for (const Part& part : system.joints[j].parts)
        if (AxisRows::suits(part)) axes_.emplace_back(part, j);
  }
  Constraints(Constraints&&) = default;  // states_ point into axes_
  Constraints& operator=(Constraints&&) = default;

  void update(const Configuration& frames) {
    for (size_t j = 0; j < states_.size(); ++j) states_[j].update(system_->joints[j], frames);
    for (AxisRows& axes : axes_) states_[axes.joint].take(axes);
  }
  const JointState& operator[](int joint) const { return states_[joint]; }
  const JointState& operator[](const PlacedPart& placed) const { return states_[placed.joint]; }

  // Those of JointState, for the velocities, multipliers and impulses of a part's bodies.
  Vec3 velocity(const PlacedPart& placed, const std::vector<Twist>& u) const {
    return states_[placed.joint].velocity(*placed.part, u[placed.bodies[kParent]], u[placed.bodies[kChild]]);
  }
  Vec3 gamma(const PlacedPart& placed, const std::vector<Twist>& u) const {
    return states_[placed.joint].gamma(*placed.part, u[placed.bodies[kParent]], u[placed.bodies[kChild]]);
  }
  void subtract_reaction(const PlacedPart& placed, const Vec3& lam, std::vector<Twist>& impulse) const {
    states_[placed.joint].subtract_reaction(*placed.part, lam, impulse[placed.bodies[kParent]],
                                            impulse[placed.bodies[kChild]]);
  }

 private:
  const System* system_;
  std::vector<JointState> states_;
  std::vector<AxisRows> axes_;
};

}  // namespace lieeuler
