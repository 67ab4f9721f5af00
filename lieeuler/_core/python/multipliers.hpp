// The multipliers at given states.
#pragma once

#include "python/arrays.hpp"

namespace lieeuler {

// Multipliers (N, m) of the index-1 system at N states, with least norm if rows are redundant, the number of redundant
// rows at the first state, and the first state without multipliers, else N. `angles` (N, forces) are those of torsional
// springs, unwrapped.
inline nb::tuple multipliers(const Plan& plan, const Array& times, const Array& x, const Array& R, const Array& v,
                             const Array& w, const Array& angles) {
  const System& system = plan.system;
  const size_t n = system.n(), N = x.size() / (3 * n), m = system.rows(), springs = system.forces.size();
  require(times.size() == N && angles.size() == N * springs, "every state needs a time and an angle a force");
  std::vector<double> lam;
  size_t unknown = N;
  lam.reserve(N * m);
  const auto solve = [](Projection& by, State& state, bool first) {
    if (first && by.start(state) != Status::success) return false;
    if (by.accelerate(state) != Status::success) return false;
    by.make_least_norm(state);
    return true;
  };
  Projection projection(plan);
  for (size_t k = 0; k < N; ++k) {
    State state = make_state(system, x, R, v, w, k);
    state.frames.time = times.data()[k];
    std::copy_n(angles.data() + k * springs, springs, state.angles.data());
    if (!solve(projection, state, k == 0)) {
      Projection there(plan);  // at a singular position more rows depend on others: count them again
      if (!solve(there, state, true)) {
        std::fill(state.lam.begin(), state.lam.end(), std::numeric_limits<double>::quiet_NaN());
        unknown = std::min(unknown, k);
      }
    }
    lam.insert(lam.end(), state.lam.begin(),
               state.lam.begin() + static_cast<long>(m));  // not those of rotors and leaders
  }
  return nb::make_tuple(make_array(std::move(lam), {N, m}), projection.redundant_rows(), unknown);
}

}  // namespace lieeuler
