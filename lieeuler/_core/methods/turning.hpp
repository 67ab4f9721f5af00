// Taylor series of bodies that turn about axes fixed in the ground, all along the third axis: one angle a body,
// (16.3) and (16.4) of docs/theory.md,
//
//   I theta'' = P cos theta - Q sin theta + constant torques and torsional springs,
//   P = r_x F_y - r_y F_x,  Q = r_x F_x + r_y F_y,
//
// with I about the pin, and F the weight and the loads in world axes, at points r from the pin, body axes.
#pragma once

#include "methods/term_series.hpp"

namespace lieeuler {

// The angles of all bodies, order by order.
class TurningSeries {
 public:
  TurningSeries(const Plan& plan, const ReferencePoints& points) : system_(plan.system), bodies_(system_.n() + 1) {
    for (int b = 0; b < system_.n(); ++b) {
      bodies_[b].inertia = points.inertia(b)(2, 2);
      bodies_[b].pull = pull(points.centre(b), system_.bodies[b].mass * system_.gravity);
    }
    for (const Force& force : system_.forces) {
      if (force.kind == Force::Kind::torsional_spring) {
        springs_.push_back({&force, static_cast<int>(&force - system_.forces.data())});
        continue;
      }
      const Pair moments = pull(points.local(force.child, force.child_point), force.force);
      Body& body = bodies_[force.child];
      body.constant += force.torque[2];
      if (force.in_world)
        body.pull += moments;
      else
        body.constant += moments[1];
    }
  }

  static bool suits(const Plan& plan) {
    const std::vector<Force>& forces = plan.system.forces;
    return plan.turns_about_pins && plan.hinges.complete && plan.plain() &&
           std::all_of(forces.begin(), forces.end(), [](const Force& force) {
             return !force.drive && (force.kind == Force::Kind::torsional_spring || force.kind == Force::Kind::load);
           });
  }

  void start(const State& state) {
    for (int b = 0; b < system_.n(); ++b) {
      const Mat3& R = state.frames[b].R;
      bodies_[b].quarter[0] = Pair{-R(1, 0), R(0, 0)};
      bodies_[b].rate[0] = state.u[b].w[2];
    }
    for (Spring& spring : springs_) spring.angle = state.angles[spring.index];
  }

  // Computes order k of the accelerations, and with it order k + 1 of the rates.
  void extend(int k) {
    for (int b = 0; b < system_.n(); ++b) {
      Body& body = bodies_[b];
      if (k > 0) turn(body, k);
      const Pair moments = body.pull * body.quarter[k];
      body.torque = moments[0] + moments[1] + (k == 0 ? body.constant : 0);
    }
    for (const Spring& spring : springs_) {
      const Force& force = *spring.force;
      const double angle = k == 0 ? spring.angle - force.rest : rate(force, k - 1) / k;
      const double torque = force.axis[2] * (force.stiffness * angle + force.damping * rate(force, k));
      bodies_[force.child].torque -= torque, bodies_[force.parent].torque += torque;
    }
    for (int b = 0; b < system_.n(); ++b) bodies_[b].rate[k + 1] = bodies_[b].torque / (bodies_[b].inertia * (k + 1));
  }

  // Accelerations of a state whose bodies hang on `tree`; takes it for the centre of the series.
  void accelerate(const HingeTree& tree, State& state) {
    start(state), extend(0);
    for (const Hinge& hinge : tree.hinges) {
      const Vec3 &w = state.u[hinge.body].w, alpha(0, 0, bodies_[hinge.body].rate[1]);
      const Vec3 to_pin = alpha.cross(hinge.body_anchor) + w.cross(w.cross(hinge.body_anchor));
      state.a[hinge.body] = {-times(state.frames[hinge.body].R, to_pin), alpha};
    }
  }

  // Attitudes, rates and angles of springs at time h from the centre of the series.
  void evaluate(double h, int order, State& state) const {
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = bodies_[b];
      double w = body.rate[order], turned = body.rate[order] / (order + 1);
      for (int k = order - 1; k >= 0; --k) w = h * w + body.rate[k], turned = h * turned + body.rate[k] / (k + 1);
      const double c = std::cos(h * turned), s = std::sin(h * turned);
      const Pair from = body.quarter[0];
      const double cosine = c * from[1] + s * from[0], sine = s * from[1] - c * from[0];
      const double shrink = 1.5 - 0.5 * (cosine * cosine + sine * sine);  // back to length one, to first order
      const double x = shrink * cosine, y = shrink * sine;
      state.frames[b].R << x, -y, 0, y, x, 0, 0, 0, 1;
      state.u[b].w = {0, 0, w};
    }
    for (const Spring& spring : springs_) {
      double turned = 0;
      for (int k = order; k >= 0; --k) turned = h * turned + rate(*spring.force, k) / (k + 1);
      state.angles[spring.index] = spring.angle + h * turned;
    }
  }

  // The largest coefficient of the rates.
  double largest(int k) const {
    double most = 0, sum = 0;
    for (const Body& body : bodies_) most = std::max(most, std::abs(body.rate[k])), sum += body.rate[k];
    return std::isfinite(sum) ? most : sum;  // max() would hide a NaN
  }

 private:
  struct Body {
    double inertia = 1, constant = 0, torque = 0;
    Pair pull{};                        // Q, P
    Pair quarter[kMostOrder + 2] = {};  // -sin theta, cos theta
    double rate[kMostOrder + 2] = {};   // of the ground zero
  };
  struct Spring {
    const Force* force;
    int index;
    double angle = 0;  // unwrapped, at the centre of the series
  };

  static Pair pull(const Vec3& r, const Vec3& F) { return Pair{r[0] * F[0] + r[1] * F[1], r[0] * F[1] - r[1] * F[0]}; }
  // (cos, sin)' = theta' (-sin, cos)
  static void turn(Body& body, int k) {
    Pair sum{};
    for (int j = 0; j < k; ++j) sum += body.rate[k - 1 - j] * body.quarter[j];
    body.quarter[k] = Pair{-sum[1], sum[0]} / static_cast<double>(k);
  }
  double rate(const Force& spring, int k) const {
    return spring.axis[2] * (bodies_[spring.child].rate[k] - bodies_[spring.parent].rate[k]);
  }

  const System& system_;
  std::vector<Body> bodies_;  // the last is the ground
  std::vector<Spring> springs_;
};

}  // namespace lieeuler
