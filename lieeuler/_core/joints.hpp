// Constraint rows of one joint at one configuration: Phi, G, gamma and the second derivatives Newton's matrix needs.
//
// All vectors below are in world axes. A carried vector z (see Carrier) changes with the quasi-velocities of body b as
// D z[u] = sign_b v_b + w_b^world x arm_b, and D_d D_u z = R_b (d x (w x local arm)): each constraint and its
// derivatives follow from these two by the product rule.
#pragma once

#include "system.hpp"

namespace lieeuler {

enum Side { kParent = 0, kChild = 1 };

using Rows = Eigen::Matrix<double, kMaxRows, 6, Eigen::RowMajor>;  // the first rows() rows are used

struct CarriedVector {
  Vec3 value = Vec3::Zero();
  double sign[2] = {0, 0};
  Vec3 arm[2] = {Vec3::Zero(), Vec3::Zero()};
};

class JointState {
 public:
  JointState(const Joint& joint, const Frame& parent, const Frame& child)
      : joint_(joint), frame_{&parent, &child} {
    arm_[kParent] = parent.R * joint.parent_anchor;
    arm_[kChild] = child.R * joint.child_anchor;
    d_ = (child.x - parent.x) + (arm_[kChild] - arm_[kParent]);
  }

  const Vec3& arm(Side side) const { return arm_[side]; }

  void position(double* phi) const {
    if (joint_.spherical) {
      Eigen::Map<Vec3>{phi} = d_;
      phi += 3;
    }
    for (const DotRow& row : joint_.dots)
      *phi++ = row.scale * carried(row.a, row.a_local).value.dot(carried(row.b, row.b_local).value) - row.constant;
  }

  // Rows of G for one side: columns v (3), w (3).
  void jacobian(Side side, Rows& G) const {
    const Mat3& R = frame_[side]->R;
    int r = 0;
    if (joint_.spherical) {
      const double sign = side == kChild ? 1 : -1;
      G.block<3, 3>(0, 0) = sign * Mat3::Identity();
      G.block<3, 3>(0, 3) = -sign * R * hat(anchor(side));
      r = 3;
    }
    for (const DotRow& row : joint_.dots) {
      const CarriedVector A = carried(row.a, row.a_local), B = carried(row.b, row.b_local);
      G.block<1, 3>(r, 0) = row.scale * (A.sign[side] * B.value + B.sign[side] * A.value).transpose();
      G.block<1, 3>(r, 3) =
          row.scale * (A.arm[side].cross(B.value) + B.arm[side].cross(A.value)).transpose() * R;
      ++r;
    }
  }

  // gamma = (d/dt G) u
  void gamma(const Twist& parent, const Twist& child, double* out) const {
    const Twist* u[2] = {&parent, &child};
    if (joint_.spherical) {
      Eigen::Map<Vec3>{out} = second(anchor(kChild), kChild, child.w, child.w) -
                              second(anchor(kParent), kParent, parent.w, parent.w);
      out += 3;
    }
    for (const DotRow& row : joint_.dots) {
      const CarriedVector A = carried(row.a, row.a_local), B = carried(row.b, row.b_local);
      *out++ = row.scale * (second(row.a, row.a_local, u).dot(B.value) + 2 * rate(A, u).dot(rate(B, u)) +
                            A.value.dot(second(row.b, row.b_local, u)));
    }
  }

  // d(G u)/dq and d(gamma)/du in the directions of one side: rows of (d G u).
  void velocity_slope(Side side, const Twist& parent, const Twist& child, Rows& N) const {
    second_slope(side, parent, child, N, /*both_orders=*/false);
  }
  void gamma_velocity_slope(Side side, const Twist& parent, const Twist& child, Rows& N) const {
    second_slope(side, parent, child, N, /*both_orders=*/true);
  }

  // d(G^T lam)/dq: adds the 6 x 6 block (row side, column side).
  void geometric_stiffness(Side row_side, Side column_side, const double* lam, Mat6& K) const {
    const Mat3 &Rr = frame_[row_side]->R, &Rc = frame_[column_side]->R;
    if (joint_.spherical) {
      if (row_side == column_side) {
        const double sign = row_side == kChild ? 1 : -1;
        const Vec3 l = Rr.transpose() * (sign * Eigen::Map<const Vec3>(lam));
        K.block<3, 3>(3, 3) += hat(anchor(row_side)) * hat(l);
      }
      lam += 3;
    }
    for (const DotRow& row : joint_.dots) {
      const double l = row.scale * *lam++;
      const CarriedVector A = carried(row.a, row.a_local), B = carried(row.b, row.b_local);
      const Mat3 Ar = -hat(A.arm[row_side]) * Rr, Br = -hat(B.arm[row_side]) * Rr;
      const Mat3 Ac = -hat(A.arm[column_side]) * Rc, Bc = -hat(B.arm[column_side]) * Rc;
      const double ar = A.sign[row_side], br = B.sign[row_side], ac = A.sign[column_side], bc = B.sign[column_side];
      K.block<3, 3>(0, 0) += l * (ar * bc + br * ac) * Mat3::Identity();
      K.block<3, 3>(0, 3) += l * (ar * Bc + br * Ac);
      K.block<3, 3>(3, 0) += l * (Ar.transpose() * bc + Br.transpose() * ac);
      K.block<3, 3>(3, 3) += l * (Ar.transpose() * Bc + Br.transpose() * Ac);
      if (row_side == column_side) {
        K.block<3, 3>(3, 3) += l * hat(Rr.transpose() * A.arm[row_side]) * hat(Rr.transpose() * B.value);
        K.block<3, 3>(3, 3) += l * hat(Rr.transpose() * B.arm[row_side]) * hat(Rr.transpose() * A.value);
      }
    }
  }

 private:
  const Vec3& anchor(Side side) const { return side == kChild ? joint_.child_anchor : joint_.parent_anchor; }

  CarriedVector carried(Carrier carrier, const Vec3& local) const {
    CarriedVector z;
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

  Vec3 rate(const CarriedVector& z, const Twist* const u[2]) const {
    Vec3 total = Vec3::Zero();
    for (Side side : {kParent, kChild})
      total += z.sign[side] * u[side]->v + (frame_[side]->R * u[side]->w).cross(z.arm[side]);
    return total;
  }

  // R (d x (w x s)): second derivative of R s in the directions w, then d.
  Vec3 second(const Vec3& s, Side side, const Vec3& w, const Vec3& d) const {
    return frame_[side]->R * d.cross(w.cross(s));
  }
  Vec3 second(Carrier carrier, const Vec3& local, const Twist* const u[2]) const {
    if (carrier == Carrier::difference)
      return second(anchor(kChild), kChild, u[kChild]->w, u[kChild]->w) -
             second(anchor(kParent), kParent, u[kParent]->w, u[kParent]->w);
    const Side side = carrier == Carrier::child_axis ? kChild : kParent;
    return second(local, side, u[side]->w, u[side]->w);
  }

  // With B(u, d) = D_d (G u): the rows of B(u, .) restricted to one side, plus those of B(., u) for both_orders.
  void second_slope(Side side, const Twist& parent, const Twist& child, Rows& N, bool both_orders) const {
    const Twist* u[2] = {&parent, &child};
    const Mat3& R = frame_[side]->R;
    const Vec3& w = u[side]->w;
    N.leftCols<3>().setZero();
    int r = 0;
    if (joint_.spherical) {
      const Vec3& s = anchor(side);
      Mat3 slope = -hat(w.cross(s));
      if (both_orders) slope -= hat(w) * hat(s);
      N.block<3, 3>(0, 3) = (side == kChild ? 1. : -1.) * R * slope;
      r = 3;
    }
    for (const DotRow& row : joint_.dots) {
      const CarriedVector A = carried(row.a, row.a_local), B = carried(row.b, row.b_local);
      const Vec3 dA = rate(A, u), dB = rate(B, u);
      const double factor = row.scale * (both_orders ? 2 : 1);
      N.block<1, 3>(r, 0) = factor * (A.sign[side] * dB + B.sign[side] * dA).transpose();
      Eigen::RowVector3d turn = factor * (A.arm[side].cross(dB) + B.arm[side].cross(dA)).transpose() * R;
      for (const auto& [z, other] : {std::pair{&A, &B}, std::pair{&B, &A}}) {
        const Vec3 s = R.transpose() * z->arm[side], l = R.transpose() * other->value;
        Mat3 slope = -hat(w.cross(s));
        if (both_orders) slope -= hat(w) * hat(s);
        turn += row.scale * l.transpose() * slope;
      }
      N.block<1, 3>(r, 3) = turn;
      ++r;
    }
  }

  const Joint& joint_;
  const Frame* frame_[2];
  Vec3 arm_[2], d_;
};

}  // namespace lieeuler
