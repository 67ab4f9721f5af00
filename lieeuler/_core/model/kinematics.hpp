// States, and the constraints of all joints, for all methods.
#pragma once

#include "model/forces.hpp"

namespace lieeuler {

// A point of the trajectory. The last entry of frames, u and a, after the bodies, is the ground at rest.
struct State {
  Configuration frames;
  std::vector<Twist> u, a;
  std::vector<double> lam;     // of the constraints, then of rotors and leaders
  std::vector<double> angles;  // of the torsional springs, one place per force

  explicit State(const System& system)
      : frames(system.n() + 1),
        u(system.n() + 1),
        a(system.n() + 1),
        lam(system.rows() + system.others(), 0.0),
        angles(system.forces.size(), 0.0) {}
};

EIGEN_ALWAYS_INLINE Vec3 load3(const double* at) { return {at[0], at[1], at[2]}; }
EIGEN_ALWAYS_INLINE Twist load(const double* at) { return {load3(at), load3(at + 3)}; }
EIGEN_ALWAYS_INLINE void store(const Vec3& value, double* at) { at[0] = value[0], at[1] = value[1], at[2] = value[2]; }
EIGEN_ALWAYS_INLINE void store(const Twist& twist, double* at) { store(twist.v, at), store(twist.w, at + 3); }

// All joints at one configuration.
class Constraints {
 public:
  explicit Constraints(const System& system) : system_(&system), states_(system.joints.size()) {
    for (int j = 0; j < static_cast<int>(states_.size()); ++j)
      for (const Part& part : system.joints[j].parts)
        if (AxisRows::suits(part)) axes_.emplace_back(part, j);
  }
  Constraints(Constraints&&) = default;  // states_ point into axes_
  Constraints& operator=(Constraints&&) = default;

  void update(const Configuration& frames) {
    for (size_t j = 0; j < states_.size(); ++j) states_[j].update(system_->joints[j], frames);
    for (AxisRows& axes : axes_) states_[axes.joint].take(axes);
  }
  const JointState& operator[](int joint) const { return states_[joint]; }

 private:
  const System* system_;
  std::vector<JointState> states_;
  std::vector<AxisRows> axes_;
};

// a = M^-1 (f - G^T lam) with the multipliers in `state`.
inline void accelerations_from_multipliers(const System& system, const Constraints& joints, State& state) {
  generalized_forces(system, state.frames, state.u, state.angles, state.a);
  for (size_t j = 0; j < system.joints.size(); ++j) {
    const Joint& joint = system.joints[j];
    for (const Part& part : joint.parts) {
      Vec3 lam = Vec3::Zero();
      for (int r = 0; r < part.rows(); ++r) lam[r] = state.lam[part.row + r];
      joints[static_cast<int>(j)].subtract_reaction(part, lam, state.a[joint.parent], state.a[joint.child]);
    }
  }
  for (int b = 0; b < system.n(); ++b) state.a[b] = velocity(system.bodies[b], state.a[b]);
  state.a[system.n()] = Twist{};
}

}  // namespace lieeuler
