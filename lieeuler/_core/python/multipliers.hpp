// The multipliers of states of Python.
#pragma once

#include <Eigen/QR>

#include "python/arrays.hpp"

namespace lieeuler {

// One set of them where the rows have lost a rank, as at a singular position.
inline Eigen::VectorXd multipliers_by_rank(const System& system, const State& state) {
  constexpr double kDependent = 1e-11;  // pivots go as squares of singular values of G
  const int m = system.rows();
  std::vector<Twist> forces(system.n() + 1);
  generalized_forces(system, state.frames, state.u, state.angles, forces);
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(m, 6 * system.n()), H = Eigen::MatrixXd::Zero(6 * system.n(), m);
  Eigen::VectorXd y(6 * system.n()), gamma(m);
  for (const Joint& joint : system.joints) {
    JointState here;
    here.update(joint, state.frames);
    for (const Part& part : joint.parts) {
      gamma.segment(part.row, part.rows()) =
          here.gamma(part, state.u[joint.parent], state.u[joint.child]).head(part.rows());
      for (Side side : kSides) {
        const int body = side == kChild ? joint.child : joint.parent;
        if (body == system.n()) continue;
        const Rows rows = here.jacobian(part, side);
        G.block(part.row, 6 * body, part.rows(), 3) = rows.v.topRows(part.rows());
        G.block(part.row, 6 * body + 3, part.rows(), 3) = rows.w.topRows(part.rows());
      }
    }
  }
  for (int b = 0; b < system.n(); ++b) {
    const Body& body = system.bodies[b];
    y.segment<3>(6 * b) = forces[b].v / body.mass, y.segment<3>(6 * b + 3) = body.inertia_inverse * forces[b].w;
    H.middleRows<3>(6 * b) = G.middleCols<3>(6 * b).transpose() / body.mass;
    H.middleRows<3>(6 * b + 3) = body.inertia_inverse * G.middleCols<3>(6 * b + 3).transpose();
  }
  const Eigen::MatrixXd S = G * H;
  const Eigen::VectorXd scales = S.diagonal().cwiseSqrt().cwiseInverse();  // masses may lie decades apart
  Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> ranked(m, m);
  ranked.setThreshold(kDependent);
  ranked.compute(scales.asDiagonal() * S * scales.asDiagonal());
  return scales.cwiseProduct(ranked.solve(scales.cwiseProduct(G * y + gamma)));
}

// (N, m) of the index-1 system at N states, of least norm where rows are redundant.
// angles (N, forces): those of torsional springs, unwrapped. With it the number of redundant rows at the first state.
inline nb::tuple multipliers(const Plan& plan, const Array& times, const Array& x, const Array& R, const Array& v,
                             const Array& w, const Array& angles) {
  const System& system = plan.system;
  const size_t n = system.n(), N = x.size() / (3 * n), m = system.rows(), springs = system.forces.size();
  require(times.size() == N && angles.size() == N * springs, "every state needs a time and an angle a force");
  std::vector<double> lam;
  lam.reserve(N * m);
  Projection projection(plan);
  for (size_t k = 0; k < N; ++k) {
    State state = make_state(system, x, R, v, w, k);
    state.frames.time = times.data()[k];
    std::copy_n(angles.data() + k * springs, springs, state.angles.data());
    const Status status = k == 0 ? projection.start(state) : Status::success;
    if (status == Status::success && projection.accelerate(state) == Status::success) {
      projection.make_least_norm(state);
      lam.insert(lam.end(), state.lam.begin(), state.lam.begin() + static_cast<long>(m));
    } else {
      const Eigen::VectorXd values = multipliers_by_rank(system, state);
      lam.insert(lam.end(), values.begin(), values.end());
    }
  }
  return nb::make_tuple(make_array(std::move(lam), {N, m}), projection.redundant_rows());
}

}  // namespace lieeuler
