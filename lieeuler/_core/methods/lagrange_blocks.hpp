// The blocks of Newton's matrix that only Lagrangian steps have: derivatives with respect to xi.
#pragma once

#include "model/nodes.hpp"

namespace lieeuler {

struct LagrangeBlocks {
  struct Body {
    double *v, *w, *xi_v = nullptr, *xi_w = nullptr, *xi_v_v = nullptr, *xi_w_w = nullptr;
  };
  std::vector<Body> bodies;
  std::vector<PairBlocks> stiffness, springs;  // columns of xi, per part or force, row side, column side
  std::vector<SideBlocks> rates, drifts;       // columns of xi in velocity rows; position rows and mu with xi

  LagrangeBlocks() = default;
  LagrangeBlocks(const Plan& plan, const Nodes& columns, BlockLU& lu) {
    const System& system = plan.system;
    const int n = system.n();
    for (int b = 0; b < n; ++b) {
      const int v = columns.v(b), w = columns.w(b), xi_v = columns.xi_v(b), xi_w = columns.xi_w(b);
      bodies.push_back({lu.block(v, v), lu.block(w, w)});
      if (columns.doubled())
        bodies.back() = {lu.block(v, v),       lu.block(w, w),    lu.block(xi_v, xi_v),
                         lu.block(xi_w, xi_w), lu.block(xi_v, v), lu.block(xi_w, w)};
    }
    const auto against_xi = [&](int row, int column) {
      if (row == n || column == n) return PairBlocks{};
      return PairBlocks::of(lu, columns.v(row), columns.w(row), columns.xi_v(column), columns.xi_w(column));
    };
    for (int k = 0; k < columns.parts(); ++k) {
      const Joint& joint = plan.joint(k);
      for (int row : {joint.parent, joint.child})
        for (int column : {joint.parent, joint.child}) stiffness.push_back(against_xi(row, column));
      for (int b : {joint.parent, joint.child}) {
        const bool none = !columns.doubled() || b == n;
        rates.push_back(none ? SideBlocks{} : SideBlocks::of(lu, columns.lam(k), columns.xi_v(b), columns.xi_w(b)));
        const bool single = plan.part(k).compliance > 0 || plan.part(k).slips;  // no second multiplier
        drifts.push_back(none || single ? SideBlocks{}
                                        : SideBlocks::of(lu, columns.mu(k), columns.xi_v(b), columns.xi_w(b)));
      }
    }
    for (const Force& force : system.forces)
      for (int row : {force.parent, force.child})
        for (int column : {force.parent, force.child}) springs.push_back(against_xi(row, column));
  }
};

}  // namespace lieeuler
