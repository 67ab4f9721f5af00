// Rows of a body that touches a plane of the ground at one point, (18.1) of docs/theory.md, all in world axes. A turn
// of the body by eta changes c by A eta (there C) and t by B eta.
#pragma once

#include "model/system.hpp"

namespace lieeuler {

class ContactState {
 public:
  // arm: R s, from the centre of mass to the blade's point or to the centre of the disk or sphere.
  ContactState(const Part& part, const Mat3& R, const Vec3& arm)
      : part_(part), contact_(*part.contact), R_(R), axis_(R * contact_.axis), c_(arm), A_(-hat(arm)) {
    const Vec3& n = contact_.normal;
    const double radius = contact_.radius;
    if (contact_.kind == Contact::Kind::sphere) c_ -= radius * n;
    if (contact_.kind != Contact::Kind::disk) return;
    const double u = n.dot(axis_);
    const Vec3 up = n - u * axis_;
    height_ = std::sqrt(1 - u * u);
    c_ -= radius / height_ * up;
    const Mat3 by_axis = (axis_ * n.transpose() + u * Mat3::Identity()) / height_ -
                         u / (height_ * height_ * height_) * up * n.transpose();
    A_ -= radius * by_axis * hat(axis_);
  }

  // Phi, with d from the plane's point to the blade's point or the centre.
  Vec3 gap(const Vec3& d) const { return {part_.slips ? 0 : contact_.normal.dot(d) - contact_.radius * height_, 0, 0}; }
  Vec3 velocity(const Twist& u) const {
    const Vec3 speed = u.v + (R_ * u.w).cross(c_);
    return by_row([&](const Vec3& t) { return t.dot(speed); });
  }
  Vec3 gamma(const Twist& u) const {
    const Vec3 w = R_ * u.w, speed = u.v + w.cross(c_), bend = w.cross(A_ * w), turned = B() * w;
    return by_row([&](const Vec3& t) { return turned.dot(speed) + t.dot(bend); });
  }
  Rows jacobian() const {
    Rows G;
    for (int r = 0; r < part_.rows(); ++r) {
      const Vec3 t = direction(r);
      G.v.row(r) = t.transpose(), G.w.row(r) = c_.cross(t).transpose() * R_;
    }
    return G;
  }
  void subtract_reaction(const Vec3& lam, Twist& impulse) const {
    const Vec3 force = pull(lam);
    impulse.v -= force, impulse.w -= transposed_times(R_, c_.cross(force));
  }
  // As JointState::velocity_slope.
  Rows velocity_slope(const Twist& u, bool both_orders) const {
    const Vec3 w = R_ * u.w, speed = u.v + w.cross(c_), bent = A_ * w, turned = B() * w;
    Rows N;
    for (int r = 0; r < part_.rows(); ++r) {
      const Vec3 t = direction(r);
      Eigen::RowVector3d turn = speed.transpose() * B() + t.cross(w).transpose() * A_;
      if (both_orders) {
        N.v.row(r) = turned.transpose();
        turn += (c_.cross(turned) + bent.cross(t)).transpose();
      } else {
        turn -= c_.cross(t).transpose() * hat(w);
      }
      N.w.row(r) = turn * R_;
    }
    return N;
  }
  // d(G^T lam)/dq
  Stiffness stiffness(const Vec3& lam) const {
    const Vec3 force = pull(lam);
    const Mat3 by_turn = lam[0] * B();  // the slip of a blade has one row; B of all other rows is zero
    Stiffness K;
    K.vw = by_turn * R_;
    K.ww = R_.transpose() * (hat(c_.cross(force)) - hat(force) * A_ + hat(c_) * by_turn) * R_;
    return K;
  }

 private:
  bool across_blade() const { return contact_.kind == Contact::Kind::edge && part_.slips; }
  Vec3 direction(int row) const {
    return across_blade() ? Vec3(contact_.normal.cross(axis_)) : part_.dots[row].a_local;
  }
  Mat3 B() const { return across_blade() ? Mat3(-hat(contact_.normal) * hat(axis_)) : Mat3(Mat3::Zero()); }
  Vec3 pull(const Vec3& lam) const {
    Vec3 force = Vec3::Zero();
    for (int r = 0; r < part_.rows(); ++r) force += lam[r] * direction(r);
    return force;
  }
  template <class Value>
  Vec3 by_row(const Value& value) const {
    Vec3 rows = Vec3::Zero();
    for (int r = 0; r < part_.rows(); ++r) rows[r] = value(direction(r));
    return rows;
  }

  const Part& part_;
  const Contact& contact_;
  const Mat3& R_;
  Vec3 axis_, c_;
  Mat3 A_;
  double height_ = 1;  // of the centre above the plane, in radii
};

}  // namespace lieeuler
