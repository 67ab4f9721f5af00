// Rows that are products of an axis of each body, (2.2) of docs/theory.md.
#pragma once

#include <array>

#include "model/system.hpp"

namespace lieeuler {

// Parts of a joint with such rows alone, at one configuration. They are evaluated once, because every residual,
// derivative and reaction needs them.
class AxisRows {
 public:
  AxisRows(const Part& part, int joint) : part(&part), joint(joint), rows_(part.rows()) {}
  static bool suits(const Part& part) {
    return !part.spherical && !part.turn && !part.contact &&
           std::all_of(part.dots.begin(), part.dots.end(), [](const DotRow& dot) {
             return dot.a != Carrier::difference && dot.b != Carrier::difference && dot.a != dot.b;
           });
  }

  const Part* const part;
  const int joint;

  // `frames` must outlive this object.
  void update(const Frame* const (&frames)[2]) {
    for (Side side : kSides) R_[side] = &frames[side]->R;
    for (size_t r = 0; r < rows_.size(); ++r) {
      const DotRow& dot = part->dots[r];
      for (Side side : kSides) {
        const bool first = (dot.a == Carrier::child_axis) == (side == kChild);
        const Vec3 &own = first ? dot.a_local : dot.b_local, &other = first ? dot.b_local : dot.a_local;
        const Vec3 seen = seen_from(side, other);
        rows_[r][side] = {own, seen, dot.scale * own.cross(seen)};
      }
    }
  }

  // G u, impulse -= G^T lam, and G, as those of JointState; all of rotations.
  Vec3 velocity(const Vec3& parent, const Vec3& child) const {
    Vec3 rate = Vec3::Zero();
    for (size_t r = 0; r < rows_.size(); ++r) rate[r] = rows_[r][kParent].G.dot(parent) + rows_[r][kChild].G.dot(child);
    return rate;
  }
  void subtract_reaction(const Vec3& lam, Vec3& parent, Vec3& child) const {
    for (size_t r = 0; r < rows_.size(); ++r)
      parent -= lam[r] * rows_[r][kParent].G, child -= lam[r] * rows_[r][kChild].G;
  }
  Mat3 jacobian(Side side) const {
    Mat3 G = Mat3::Zero();
    for (size_t r = 0; r < rows_.size(); ++r) G.row(r) = rows_[r][side].G;
    return G;
  }

  // d(G u)/dq of one side; the angular velocities of that side and of the other.
  Mat3 velocity_slope(Side side, const Vec3& w, const Vec3& other) const {
    Mat3 N = Mat3::Zero();
    const Vec3 turn = seen_from(side, other);
    for (size_t r = 0; r < rows_.size(); ++r) {
      const Row& row = rows_[r][side];
      N.row(r) = part->dots[r].scale * (row.own.cross(turn.cross(row.other)) + row.other.cross(row.own.cross(w)));
    }
    return N;
  }
  // d(G^T lam)/dq of one side by its own rotation, and its change if the other side turns.
  Mat3 own_stiffness(Side side, const Vec3& lam) const {
    Mat3 K = Mat3::Zero();
    for (size_t r = 0; r < rows_.size(); ++r) {
      const Row& row = rows_[r][side];
      const Vec3 pull = part->dots[r].scale * lam[r] * row.other;
      K += pull * row.own.transpose();
      K.diagonal().array() -= pull.dot(row.own);
    }
    return K;
  }
  Vec3 coupled_torque(Side side, const Vec3& lam, const Vec3& other) const {
    Vec3 torque = Vec3::Zero();
    const Vec3 turn = seen_from(side, other);
    for (size_t r = 0; r < rows_.size(); ++r) {
      const Row& row = rows_[r][side];
      torque += part->dots[r].scale * lam[r] * row.own.cross(turn.cross(row.other));
    }
    return torque;
  }

 private:
  // The axis of one side and that of the other, in the axes of its body, and its row of G, which is their product.
  struct Row {
    Vec3 own, other, G;
  };

  // A vector in the axes of the other body, in those of this one.
  Vec3 seen_from(Side side, const Vec3& vector) const {
    return transposed_times(*R_[side], times(*R_[opposite(side)], vector));
  }

  const Mat3* R_[2] = {};
  std::vector<std::array<Row, 2>> rows_;
};

}  // namespace lieeuler
