// Munthe-Kaas Runge-Kutta and symplectic Euler steps over Pinocchio's `aba`, compiled: trees of ball joints.
//
// q holds a quaternion (x, y, z, w) per joint, v an angular velocity in body axes; SI units. pinocchio_compiled.py
// builds this and calls it.
#include <cmath>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/multibody.hpp>
#include <vector>

namespace {

using Eigen::Quaterniond, Eigen::Vector3d, Eigen::VectorXd;

struct Tree {
  pinocchio::Model model;
  pinocchio::Data data;
  VectorXd no_torque;
};

// From sin(angle / 2) / angle on, the half-angle formulas; below the limit three terms of the series are exact to
// rounding.
Quaterniond exponential(const Vector3d& theta) {
  const double square = theta.squaredNorm();
  if (square < 1e-4) {
    const double s = 0.5 - square * (1. / 48 - square / 3840),
                 c = 1 - square * (1. / 8 - square * (1. / 384 - square / 46080));
    return {c, s * theta.x(), s * theta.y(), s * theta.z()};
  }
  const double angle = std::sqrt(square), s = std::sin(0.5 * angle) / angle;
  return {std::cos(0.5 * angle), s * theta.x(), s * theta.y(), s * theta.z()};
}

// d theta / dt for R = R_0 exp(hat(theta)) turning at w.
Vector3d inverse_tangent(const Vector3d& theta, const Vector3d& w) {
  static constexpr double series[] = {1. / 12, 1. / 720, 1. / 30240, 1. / 1209600, 1. / 47900160, 691. / 1307674368000};
  const double square = theta.squaredNorm();
  double factor = 0;
  if (square < 0.01)
    for (int k = 5; k >= 0; --k) factor = factor * square + series[k];
  else
    factor = 1 / square - 0.5 / (std::sqrt(square) * std::tan(0.5 * std::sqrt(square)));
  const Vector3d turned = theta.cross(w);
  return w + 0.5 * turned + factor * theta.cross(turned);
}

// q_out = q * exp(theta), ball by ball, back to unit length.
void move(const VectorXd& q, const VectorXd& theta, VectorXd& out) {
  for (Eigen::Index b = 0; 3 * b < theta.size(); ++b) {
    const Quaterniond at(q.data() + 4 * b);
    Eigen::Map<Quaterniond>(out.data() + 4 * b) = (at * exponential(theta.segment<3>(3 * b))).normalized();
  }
}

}  // namespace

extern "C" {

// Ball joints 0 .. n-1, parents first (-1: the world); placements in the parent's joint frame, R by rows; inertias
// about the centres of mass at `lever`, axes of the joint frame.
void* tree_new(int n, const int* parents, const double* rotations, const double* translations, const double* masses,
               const double* levers, const double* inertias, const double* gravity) {
  using RowMatrix = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  pinocchio::Model model;
  model.gravity.linear(Eigen::Map<const Vector3d>(gravity));
  for (int b = 0; b < n; ++b) {
    const pinocchio::SE3 placement(Eigen::Map<const RowMatrix>(rotations + 9 * b),
                                   Eigen::Map<const Vector3d>(translations + 3 * b));
    const auto joint =
        model.addJoint(parents[b] + 1, pinocchio::JointModelSpherical(), placement, "ball_" + std::to_string(b));
    const pinocchio::Inertia inertia(masses[b], Eigen::Map<const Vector3d>(levers + 3 * b),
                                     Eigen::Map<const RowMatrix>(inertias + 9 * b));
    model.appendBodyToJoint(joint, inertia, pinocchio::SE3::Identity());
  }
  return new Tree{model, pinocchio::Data(model), VectorXd::Zero(3 * n)};
}
void tree_delete(void* tree) { delete static_cast<Tree*>(tree); }

void tree_accelerate(void* handle, const double* q, const double* v, double* a) {
  Tree& tree = *static_cast<Tree*>(handle);
  const Eigen::Map<const VectorXd> at(q, tree.model.nq), rate(v, tree.model.nv);
  Eigen::Map<VectorXd>(a, tree.model.nv) = pinocchio::aba(tree.model, tree.data, at, rate, tree.no_torque);
}

// v += h a(q, v), q moves by h v.
void tree_euler(void* handle, double h, int steps, double* q, double* v) {
  Tree& tree = *static_cast<Tree*>(handle);
  VectorXd at = Eigen::Map<VectorXd>(q, tree.model.nq), rate = Eigen::Map<VectorXd>(v, tree.model.nv), moved(at),
           turn(rate);
  for (int k = 0; k < steps; ++k) {
    rate += h * pinocchio::aba(tree.model, tree.data, at, rate, tree.no_torque);
    turn = h * rate;
    move(at, turn, moved);
    at.swap(moved);
  }
  Eigen::Map<VectorXd>(q, at.size()) = at, Eigen::Map<VectorXd>(v, rate.size()) = rate;
}

// An explicit tableau: `rows` is the strict lower triangle, row by row.
void tree_munthe_kaas(void* handle, int stages, const double* rows, const double* weights, double h, int steps,
                      double* q, double* v) {
  Tree& tree = *static_cast<Tree*>(handle);
  const Eigen::Index size = tree.model.nv;
  VectorXd at = Eigen::Map<VectorXd>(q, tree.model.nq), rate = Eigen::Map<VectorXd>(v, size), moved(at), theta(size),
           u(size);
  std::vector<VectorXd> turns(stages, VectorXd(size)), accelerations(turns);
  const auto combine = [&](int count, const double* factors) {
    theta.setZero(), u = rate;
    for (int j = 0; j < count; ++j)
      if (factors[j] != 0) theta += (h * factors[j]) * turns[j], u += (h * factors[j]) * accelerations[j];
  };
  for (int k = 0; k < steps; ++k) {
    const double* row = rows;
    for (int stage = 0; stage < stages; row += stage++) {
      combine(stage, row);
      for (Eigen::Index b = 0; b < size; b += 3)
        turns[stage].segment<3>(b) = inverse_tangent(theta.segment<3>(b), u.segment<3>(b));
      if (stage > 0) move(at, theta, moved);
      accelerations[stage] = pinocchio::aba(tree.model, tree.data, stage > 0 ? moved : at, u, tree.no_torque);
    }
    combine(stages, weights);
    move(at, theta, moved);
    at.swap(moved), rate = u;
  }
  Eigen::Map<VectorXd>(q, at.size()) = at, Eigen::Map<VectorXd>(v, size) = rate;
}

}  // extern "C"
