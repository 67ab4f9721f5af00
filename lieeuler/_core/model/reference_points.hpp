// The point of each body about which its motion is written: the centre of mass, or a point that a spherical constraint
// pins to the ground. About a pin the body does not translate, its inertia is constant too, and the pin's reaction
// exerts no torque: neither translation nor reaction is an unknown.
#pragma once

#include "model/plan.hpp"

namespace lieeuler {

class ReferencePoints {
 public:
  ReferencePoints(const Plan& plan, bool use_pins)
      : system_(&plan.system),
        centre_(system_->n() + 1, Vec3::Zero()),
        place_(centre_),
        joint_(system_->n() + 1, kNone) {
    if (!use_pins) return;
    for (const Hinge& hinge : plan.hinges.hinges)
      if (hinge.base == system_->n())
        centre_[hinge.body] = -hinge.body_anchor, place_[hinge.body] = hinge.base_anchor,
        joint_[hinge.body] = hinge.joint;
  }

  int ground() const { return system_->n(); }
  bool pinned(int body) const { return joint_[body] != kNone; }
  // Whether this part is a pin, and so needs no rows.
  bool holds(const PlacedPart& placed) const {
    if (!placed.part->spherical) return false;
    return joint_[placed.bodies[kParent]] == placed.joint || joint_[placed.bodies[kChild]] == placed.joint;
  }
  // Centre of mass and any other point, from the reference point, body axes.
  const Vec3& centre(int body) const { return centre_[body]; }
  Vec3 local(int body, const Vec3& from_centre) const { return centre_[body] + from_centre; }
  // Where the reference point is and how it moves, world.
  Vec3 position(int body, const State& state) const { return pinned(body) ? place_[body] : state.frames[body].x; }
  Vec3 velocity(int body, const State& state) const { return pinned(body) ? Vec3(Vec3::Zero()) : state.u[body].v; }

  Mat3 inertia(int body) const {
    const Vec3& c = centre_[body];
    return system_->bodies[body].inertia +
           system_->bodies[body].mass * (c.squaredNorm() * Mat3::Identity() - c * c.transpose());
  }
  // The same less a multiple of the identity, which has no effect on w x (J w). Taken from that about the centre of
  // mass: the moments of a needle or a thin plate differ by less than the rounding of those about a pin.
  Mat3 deviation(int body) const {
    return system_->bodies[body].inertia_deviation -
           system_->bodies[body].mass * centre_[body] * centre_[body].transpose();
  }
  // Turns rows of G for the velocities of the centre of mass into rows for those of the reference point.
  Rows moved(Rows G, int body, const Mat3& R) const {
    if (!pinned(body)) return G;
    G.w -= G.v * R * hat(centre_[body]);
    G.v.setZero();
    return G;
  }

 private:
  static constexpr int kNone = -1;
  const System* system_;
  std::vector<Vec3> centre_, place_;
  std::vector<int> joint_;  // that pins the body
};

}  // namespace lieeuler
