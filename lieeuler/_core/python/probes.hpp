// Results of single parts of the kernel as dense arrays, for the tests.
#pragma once

#include <nanobind/eigen/dense.h>

#include "methods/taylor.hpp"
#include "python/arrays.hpp"

namespace lieeuler {

// Taylor coefficients of x, R and w about a state, order by order, from a stepper's expansion.
inline nb::dict taylor_coefficients(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
                                    int order) {
  require(order >= 0 && order <= kMostOrder, "no series has this order");
  const System& system = plan.system;
  TaylorStepper stepper(plan);
  const Status status = stepper.expand_at(make_state(system, x, R, v, w), order);
  const size_t n = system.n(), count = order + 1;
  std::vector<double> xs(3 * n * count), Rs(9 * n * count), ws(3 * n * count);
  for (size_t k = 0; k < count; ++k)
    for (size_t b = 0; b < n; ++b) {
      const size_t at = k * n + b;
      const auto [position, attitude, rate] = stepper.series().coefficient(static_cast<int>(b), static_cast<int>(k));
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
  std::vector<double> xs(3 * n), Rs(9 * n), vs(3 * n), ws(3 * n);
  for (size_t b = 0; b < n; ++b) {
    put(xs, 3 * b, state.frames[b].x), put(Rs, 9 * b, state.frames[b].R);
    put(vs, 3 * b, state.u[b].v), put(ws, 3 * b, state.u[b].w);
  }
  nb::dict result;
  result["status"] = name_of(status);
  result["x"] = make_array(std::move(xs), {n, 3});
  result["R"] = make_array(std::move(Rs), {n, 3, 3});
  result["v"] = make_array(std::move(vs), {n, 3});
  result["w"] = make_array(std::move(ws), {n, 3});
  return result;
}

// Phi, G, gamma, d(G u)/dq and d(gamma)/du of a state, dense; and d(G^T lam)/dq.
inline nb::dict constraints(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
                            const Array& lam) {
  const System& system = plan.system;
  const State state = make_state(system, x, R, v, w);
  const size_t m = system.rows() + system.others(), columns = 6 * system.n();
  require(lam.size() == m, "lam must be that of the system's rows");
  std::vector<double> phi(m), gamma(m), G(m * columns), slope(m * columns), gamma_slope(m * columns),
      K(columns * columns);
  auto put_rows = [&](std::vector<double>& out, const Part& part, int body, const Rows& rows) {
    for (int r = 0; r < part.rows(); ++r)
      for (int c = 0; c < 3; ++c) {
        const size_t at = (part.row + r) * columns + 6 * body + c;
        out[at] = rows.v(r, c), out[at + 3] = rows.w(r, c);
      }
  };
  auto add_block = [&](int row, int column, const Mat3& block) {
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) K[(row + r) * columns + column + c] += block(r, c);
  };
  for (const Joint& joint : system.joints) {
    JointState here;
    here.update(joint, state.frames);
    const Twist &parent = state.u[joint.parent], &child = state.u[joint.child];
    for (const Part& part : joint.parts) {
      const Vec3 position = here.position(part), bias = here.gamma(part, parent, child);
      std::copy_n(position.data(), part.rows(), phi.data() + part.row);
      std::copy_n(bias.data(), part.rows(), gamma.data() + part.row);
      Vec3 multipliers = Vec3::Zero();
      std::copy_n(lam.data() + part.row, part.rows(), multipliers.data());
      for (Side side : kSides) {
        const int body = side == kChild ? joint.child : joint.parent;
        if (body == system.n()) continue;
        put_rows(G, part, body, here.jacobian(part, side));
        put_rows(slope, part, body, here.velocity_slope(part, side, parent, child, false));
        put_rows(gamma_slope, part, body, here.velocity_slope(part, side, parent, child, true));
        for (Side other : kSides) {
          const int column = other == kChild ? joint.child : joint.parent;
          if (column == system.n()) continue;
          const Stiffness block = here.geometric_stiffness(part, side, other, multipliers);
          add_block(6 * body, 6 * column, block.vv), add_block(6 * body, 6 * column + 3, block.vw);
          add_block(6 * body + 3, 6 * column, block.wv), add_block(6 * body + 3, 6 * column + 3, block.ww);
        }
      }
    }
  }
  nb::dict result;
  result["phi"] = make_array(std::move(phi), {m});
  result["gamma"] = make_array(std::move(gamma), {m});
  result["G"] = make_array(std::move(G), {m, columns});
  result["velocity_slope"] = make_array(std::move(slope), {m, columns});
  result["gamma_velocity_slope"] = make_array(std::move(gamma_slope), {m, columns});
  result["geometric_stiffness"] = make_array(std::move(K), {columns, columns});
  return result;
}

// f without -w x J w, its derivatives with respect to q and u, and the energy of springs.
inline nb::dict forces(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w) {
  const System& system = plan.system;
  const State state = make_state(system, x, R, v, w);
  const size_t columns = 6 * system.n();
  std::vector<double> f(columns), by_q(columns * columns), by_u(columns * columns);
  double potential = 0;
  std::vector<Twist> twists(system.n() + 1);
  applied_forces(system, state.frames, state.u, state.angles, twists);
  for (int b = 0; b < system.n(); ++b) put(f, 6 * b, twists[b].v), put(f, 6 * b + 3, twists[b].w);
  auto add_blocks = [&](std::vector<double>& out, int row, int column, const Stiffness& K) {
    if (row == system.n() || column == system.n()) return;
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) {
        double* at = out.data() + (6 * row + r) * columns + 6 * column + c;
        at[0] += K.vv(r, c), at[3] += K.vw(r, c), at[3 * columns] += K.wv(r, c), at[3 * columns + 3] += K.ww(r, c);
      }
  };
  for (const Force& force : system.forces) {
    const ForceState here(force, state.frames, state.u, 0.0);
    const Linearised slopes = here.linearised();
    potential += here.potential();
    const int bodies[2] = {force.parent, force.child};
    for (Side row : kSides)
      for (Side column : kSides) {
        add_blocks(by_q, bodies[row], bodies[column], slopes.q[row][column]);
        add_blocks(by_u, bodies[row], bodies[column], slopes.u[row][column]);
      }
  }
  nb::dict result;
  result["f"] = make_array(std::move(f), {columns});
  result["by_q"] = make_array(std::move(by_q), {columns, columns});
  result["by_u"] = make_array(std::move(by_u), {columns, columns});
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
