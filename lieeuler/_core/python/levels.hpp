// How far given states violate the constraints.
#pragma once

#include "model/mimic.hpp"
#include "model/scales.hpp"
#include "python/arrays.hpp"
#include "run/loop.hpp"

namespace lieeuler {

// Largest entries of Phi and of G u, relative to the length and the rate of the system.
//
// A state after the start does not say how many turns the leader of a mimic has made; the position row of the mimic is
// skipped if they make a difference.
inline std::pair<double, double> constraint_levels(const Plan& plan, const State& state) {
  const System& system = plan.system;
  const Scales scales = Scales::of_motion(system, state);
  const double rate = std::max(scales.rate, scales.natural(system));
  double position = 0, velocity = 0;
  for (const Joint& joint : system.joints) {
    JointState here;
    here.update(joint, state.frames);
    for (const Part& part : joint.constraints()) {
      Vec3 gap = here.position(part), speed = here.velocity(part, state.u[joint.parent], state.u[joint.child]);
      speed += here.drift(part);
      for (int r = 0; r < part.rows(); ++r)
        if (part.translational(r)) gap[r] /= system.length, speed[r] /= system.length;
      raise(position, gap), raise(velocity, speed);
    }
  }
  if (!plan.mimics.empty()) {
    Constraints joints(system);
    joints.update(state.frames);
    for (const PlacedMimic& mimic : plan.mimics) {
      const double size = mimic.turns ? 1 : 1 / system.length;
      const bool any_turn = mimic.angle < 0 || (mimic.turns && mimic.ratio == std::round(mimic.ratio));
      if (any_turn || state.frames.time == 0) raise(position, size * std::abs(gap(plan, mimic, joints, state.angles)));
      raise(velocity, size * std::abs(mimic_rate(plan, mimic, joints, state.u)));
    }
  }
  return {position, rate > 0 ? velocity / rate : velocity};  // without a rate nothing moves
}

// The two levels (N, 2) of N states at a time.
inline nb::object levels_of_states(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
                                   double time) {
  const System& system = plan.system;
  const size_t n = system.n(), N = x.size() / (3 * n);
  std::vector<double> levels;
  for (size_t k = 0; k < N; ++k) {
    State state = make_state(system, x, R, v, w, k);
    state.frames.time = time;
    const auto [position, velocity] = constraint_levels(plan, state);
    levels.insert(levels.end(), {position, velocity});
  }
  return make_array(std::move(levels), {N, 2});
}

}  // namespace lieeuler
