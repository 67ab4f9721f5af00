// Results of single parts of the kernel as dense arrays, for the tests.
#pragma once

#include <nanobind/eigen/dense.h>

#include "python/arrays.hpp"

namespace lieeuler {

using Dense = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Adds a block of second derivatives between two bodies, if neither is the ground.
inline void add_block(Dense& sum, int row, int column, const Stiffness& K) {
  if (6 * row == sum.rows() || 6 * column == sum.cols()) return;
  auto block = sum.block<6, 6>(6 * row, 6 * column);
  block.topLeftCorner<3, 3>() += K.vv, block.topRightCorner<3, 3>() += K.vw;
  block.bottomLeftCorner<3, 3>() += K.wv, block.bottomRightCorner<3, 3>() += K.ww;
}

// Phi, G, gamma, d(G u)/dq and d(gamma)/du of a state, dense; and d(G^T lam)/dq.
inline Parts constraints(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
                         const Array& lam) {
  const System& system = plan.system;
  const State state = make_state(system, x, R, v, w);
  const int m = system.rows() + system.others(), columns = 6 * system.n();
  require(lam.size() == static_cast<size_t>(m), "lam must be that of the system's rows");
  Eigen::VectorXd phi(m), gamma(m);
  Dense G = Dense::Zero(m, columns), slope = G, gamma_slope = G, K = Dense::Zero(columns, columns);
  const auto put_rows = [](Dense& out, const Part& part, int body, const Rows& rows) {
    out.block(part.row, 6 * body, part.rows(), 3) = rows.v.topRows(part.rows());
    out.block(part.row, 6 * body + 3, part.rows(), 3) = rows.w.topRows(part.rows());
  };
  Constraints joints(system);
  joints.update(state.frames);
  for (size_t j = 0; j < system.joints.size(); ++j) {
    const Joint& joint = system.joints[j];
    const JointState& here = joints[static_cast<int>(j)];
    const Twist &parent = state.u[joint.parent], &child = state.u[joint.child];
    const int bodies[2] = {joint.parent, joint.child};
    for (const Part& part : joint.parts) {
      phi.segment(part.row, part.rows()) = here.position(part).head(part.rows());
      gamma.segment(part.row, part.rows()) = here.gamma(part, parent, child).head(part.rows());
      Vec3 multipliers = Vec3::Zero();
      std::copy_n(lam.data() + part.row, part.rows(), multipliers.data());
      for (Side side : kSides) {
        if (bodies[side] == system.n()) continue;
        put_rows(G, part, bodies[side], here.jacobian(part, side));
        put_rows(slope, part, bodies[side], here.velocity_slope(part, side, parent, child, false));
        put_rows(gamma_slope, part, bodies[side], here.velocity_slope(part, side, parent, child, true));
        for (Side other : kSides)
          add_block(K, bodies[side], bodies[other], here.geometric_stiffness(part, side, other, multipliers));
      }
    }
  }
  Parts result;
  result["phi"] = phi, result["gamma"] = gamma, result["G"] = G;
  result["velocity_slope"] = slope, result["gamma_velocity_slope"] = gamma_slope, result["geometric_stiffness"] = K;
  return result;
}

// f without -w x J w, its derivatives with respect to q and u, and the energy of springs.
inline Parts forces(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w) {
  const System& system = plan.system;
  const State state = make_state(system, x, R, v, w);
  const int columns = 6 * system.n();
  Dense by_q = Dense::Zero(columns, columns), by_u = by_q;
  double potential = 0;
  std::vector<Twist> f(system.n() + 1);
  applied_forces(system, state.frames, state.u, state.angles, f);
  for (const Force& force : system.forces) {
    const ForceState here(force, state.frames, state.u, 0.0);
    potential += here.potential();
    const int bodies[2] = {force.parent, force.child};
    for (Side row : kSides)
      for (Side column : kSides) {
        add_block(by_q, bodies[row], bodies[column], here.by_position(row, column));
        add_block(by_u, bodies[row], bodies[column], here.by_velocity(row, column));
      }
  }
  Parts result;
  result["f"] = Eigen::VectorXd(Eigen::Map<Eigen::VectorXd>(flat(f), columns));
  result["by_q"] = by_q, result["by_u"] = by_u;
  result["potential"] = potential;
  return result;
}

inline Parts map_values(CoordinateMap kind, const Vec3& xi, const Mat3& J, double h) {
  Map map(kind);
  Parts result;
  result["inside"] = map.set(h * xi);
  result["rotation"] = Mat3(map.rotation());
  result["left_tangent"] = Mat3(map.left_tangent());
  result["momentum"] = Vec3(map.momentum(J * xi));
  result["momentum_slope"] = Mat3(map.momentum_slope(xi, J * xi, J, h));
  return result;
}

}  // namespace lieeuler
