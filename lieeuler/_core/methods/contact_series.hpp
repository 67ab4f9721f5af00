// Series of the rows of a contact, (18.1) of docs/theory.md as in model/contact.hpp: t . (V + W x c) = 0 of the
// reference point's velocity V and the angular velocity W, both in world axes.
#pragma once

#include "methods/term_series.hpp"

namespace lieeuler {

class ContactSeries {
 public:
  const int index, body;  // of the part; of the body in contact

  ContactSeries(const Joint& joint, const Part& part, int index, const ReferencePoints& points)
      : index(index), body(joint.child), part_(part), point_(points.local(joint.child, joint.child_anchor)) {}

  void start() { known_ = 0; }

  // Subtracts the reaction of order k without lam_k from `force`; returns -gamma of order k.
  Vec3 begin(const BodySeries& bodies, int k, Twist& force) {
    for (; known_ <= k + 1; ++known_) extend(bodies, known_);
    turn_[k] = turned(bodies, 0, k);
    turn_[k + 1] = turned(bodies, 1, k + 1);  // without the acceleration of order k
    slide_[k] = slide(k);
    slide_[k] += (k + 1) * vector(bodies.x[body][k + 1]);
    slide_[k + 1] = slide(k + 1);
    pull_[k] = moment_[k] = Vec3::Zero();
    for (int j = 0; j < k; ++j)
      for (int r = 0; r < part_.rows(); ++r) pull_[k] += lam_[j][r] * direction(r, k - j);
    for (int j = 0; j <= k; ++j) moment_[k] += c_[j].cross(pull_[k - j]);
    force.v -= pull_[k];
    for (int j = 0; j <= k; ++j) force.w -= upper(bodies.R[body][j]).transpose() * moment_[k - j];
    Vec3 lack = Vec3::Zero();
    for (int r = 0; r < part_.rows(); ++r)
      for (int j = 0; j <= k + 1; ++j) lack[r] -= (k + 1) * direction(r, j).dot(slide_[k + 1 - j]);
    return lack;
  }
  void finish(int k, const Vec3& multipliers) {
    lam_[k] = multipliers;
    Vec3 pull = Vec3::Zero();
    for (int r = 0; r < part_.rows(); ++r) pull += multipliers[r] * direction(r, 0);
    pull_[k] += pull, moment_[k] += c_[0].cross(pull);
  }

 private:
  Vec3 direction(int row, int k) const {
    if (across_blade_) return across_[k];
    return k == 0 ? part_.dots[row].a_local : Vec3(Vec3::Zero());
  }
  // W of order k, summed over the orders of R from `first` on.
  Vec3 turned(const BodySeries& bodies, int first, int k) const {
    Vec3 sum = Vec3::Zero();
    for (int j = first; j <= k; ++j) sum += upper(bodies.R[body][j]) * vector(bodies.w[body][k - j]);
    return sum;
  }
  // W x c of order k.
  Vec3 slide(int k) const {
    Vec3 sum = Vec3::Zero();
    for (int j = 0; j <= k; ++j) sum += turn_[j].cross(c_[k - j]);
    return sum;
  }
  // Order k of the point of contact and of the direction across a blade.
  void extend(const BodySeries& bodies, int k) {
    const Mat3 R = upper(bodies.R[body][k]);
    const Vec3& n = contact_.normal;
    c_[k] = R * point_, axis_[k] = R * contact_.axis, across_[k] = n.cross(axis_[k]);
    if (contact_.kind == Contact::Kind::sphere && k == 0) c_[0] -= contact_.radius * n;
    if (contact_.kind != Contact::Kind::disk) return;
    height_[k] = n.dot(axis_[k]);
    square_[k] = k == 0 ? 1 : 0;
    for (int j = 0; j <= k; ++j) square_[k] -= height_[j] * height_[k - j];
    inverse_[k] = k == 0 ? 1 / std::sqrt(square_[0]) : 0;  // 1 / q: y = q^2, y g' = -y' g / 2
    for (int j = 1; j <= k; ++j) inverse_[k] += (0.5 * j - k) / (k * square_[0]) * square_[j] * inverse_[k - j];
    for (int j = 0; j <= k; ++j) {
      Vec3 up = j == 0 ? n : Vec3(Vec3::Zero());
      for (int i = 0; i <= j; ++i) up -= height_[i] * axis_[j - i];
      c_[k] -= contact_.radius * inverse_[k - j] * up;
    }
  }

  const Part& part_;
  const Contact& contact_ = *part_.contact;
  const Vec3 point_;  // from the reference point, body axes
  const bool across_blade_ = contact_.kind == Contact::Kind::edge && part_.slips;
  int known_ = 0;
  std::vector<Vec3> c_ = std::vector<Vec3>(kMostOrder + 3), turn_ = c_, axis_ = c_, across_ = c_, slide_ = c_;
  std::vector<Vec3> pull_ = c_, moment_ = c_, lam_ = c_;
  std::vector<double> height_ = std::vector<double>(kMostOrder + 3), square_ = height_,
                      inverse_ = height_;  // n . a, q^2, 1 / q
};

}  // namespace lieeuler
