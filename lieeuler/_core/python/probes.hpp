// Results of single parts of the kernel as dense arrays, for the tests.
#pragma once

#include <nanobind/eigen/dense.h>

#include "methods/taylor.hpp"
#include "python/arrays.hpp"

namespace lieeuler {

using Dense = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Taylor coefficients of x, R and w about a state, order by order, from a stepper's expansion.
inline nb::dict taylor_coefficients(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
                                    int order) {
  require(order >= 0 && order <= kMostOrder, "no series has this order");
  TaylorStepper stepper(plan);
  const Status status = stepper.expand_at(make_state(plan.system, x, R, v, w), order);
  const size_t n = plan.system.n(), count = order + 1;
  std::vector<double> xs(3 * n * count), Rs(9 * n * count), ws(3 * n * count);
  for (size_t at = 0; at < n * count; ++at) {
    const auto [position, attitude, rate] =
        stepper.series().coefficient(static_cast<int>(at % n), static_cast<int>(at / n));
    put(xs, 3 * at, position), put(ws, 3 * at, rate), put(Rs, 9 * at, attitude);
  }
  nb::dict result;
  result["status"] = name_of(status);
  result["x"] = make_array(std::move(xs), {count, n, 3});
  result["R"] = make_array(std::move(Rs), {count, n, 3, 3});
  result["w"] = make_array(std::move(ws), {count, n, 3});
  return result;
}

// A state projected onto Phi = 0 and G u = 0 with a matrix of its own, with the number of redundant rows at `home`.
inline nb::dict project(const Plan& plan, const Array& home_x, const Array& home_R, const Array& x, const Array& R,
                        const Array& v, const Array& w) {
  const System& system = plan.system;
  State state = make_state(system, x, R, v, w);
  const State home = make_state(system, home_x, home_R, v, w);
  Projection projection(plan);
  Counters counters;
  Status status = projection.start(home);
  if (status == Status::success) status = projection.project(state, Scales::of_motion(system, home).length, counters);
  const size_t n = system.n();
  std::vector<double> Rs(9 * n);
  Dense xs(n, 3), vs(n, 3), ws(n, 3);
  for (size_t b = 0; b < n; ++b) {
    put(Rs, 9 * b, state.frames[b].R);
    xs.row(b) = state.frames[b].x, vs.row(b) = state.u[b].v, ws.row(b) = state.u[b].w;
  }
  nb::dict result;
  result["status"] = name_of(status);
  result["x"] = xs, result["v"] = vs, result["w"] = ws;
  result["R"] = make_array(std::move(Rs), {n, 3, 3});
  return result;
}

// Adds a block of second derivatives between two bodies, if neither is the ground.
inline void add_block(Dense& sum, int row, int column, const Stiffness& K) {
  if (6 * row == sum.rows() || 6 * column == sum.cols()) return;
  auto block = sum.block<6, 6>(6 * row, 6 * column);
  block.topLeftCorner<3, 3>() += K.vv, block.topRightCorner<3, 3>() += K.vw;
  block.bottomLeftCorner<3, 3>() += K.wv, block.bottomRightCorner<3, 3>() += K.ww;
}

// Phi, G, gamma, d(G u)/dq and d(gamma)/du of a state, dense; and d(G^T lam)/dq.
inline nb::dict constraints(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
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
  nb::dict result;
  result["phi"] = phi, result["gamma"] = gamma, result["G"] = G;
  result["velocity_slope"] = slope, result["gamma_velocity_slope"] = gamma_slope, result["geometric_stiffness"] = K;
  return result;
}

// f without -w x J w, its derivatives with respect to q and u, and the energy of springs.
inline nb::dict forces(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w) {
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
  nb::dict result;
  result["f"] = Eigen::VectorXd(Eigen::Map<Eigen::VectorXd>(flat(f), columns));
  result["by_q"] = by_q, result["by_u"] = by_u;
  result["potential"] = potential;
  return result;
}

template <class Map>
nb::dict map_values(const Vec3& xi, const Mat3& J, double h) {
  Map map;
  nb::dict result;
  result["inside"] = map.set(h * xi);
  result["rotation"] = Mat3(map.rotation());
  result["left_tangent"] = Mat3(map.left_tangent());
  result["momentum"] = Vec3(map.momentum(J * xi));
  result["momentum_slope"] = Mat3(map.momentum_slope(xi, J * xi, J, h));
  return result;
}

}  // namespace lieeuler
