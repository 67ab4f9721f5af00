// The chart of states in which the bodies are independent, equation (10.1) of docs/theory.md: y = (x, theta, v, w) of
// every body. The matrix factored at the end of a step serves the next first stage.
#pragma once

#include "solve/free_bodies.hpp"
#include "solve/projection.hpp"

namespace lieeuler {

// Sets R to base exp(hat theta), and `rate` to dexp^-1(theta) w; false if theta is longer than most_turn.
inline bool turn_by(const Vec3& theta, const Mat3& base, double most_turn, const Vec3& w, Mat3& R, double* rate) {
  const double s = theta.squaredNorm();
  if (!(s < most_turn * most_turn)) return false;
  const ChartCoefficients k = chart_coefficients(s);
  R.noalias() = base * quadratic(theta, 1 - k.cosc * s, k.sinc, k.cosc);
  const Vec3 turned = theta.cross(w);
  store(Vec3(w + 0.5 * turned + k.inverse * theta.cross(turned)), rate);
  return true;
}

class BodyChart {
 public:
  using Point = State;

  explicit BodyChart(const Plan& plan, bool conserves = false)
      : system_(plan.system),
        projection_(plan),
        free_(plan.system, conserves),
        most_turn_(most_turn(system_, 2 * std::numbers::pi)) {}

  State make() const { return State(system_); }
  int blocks() const { return system_.n(); }

  Status start(const State& given, State& state, double length, Counters& counters) {
    state = given;
    update_angles(system_, state.frames, state.u, state.angles);
    if (const Status status = projection_.start(state); status != Status::success) return status;
    free_.start(state);
    return projection_.settle(state, length, counters);
  }

  static void renew() {}

  bool configure(const double* y, const State& base, State& state, double* out) const {
    for (int b = 0; b < system_.n(); ++b, y += 12, out += 12) {
      const Vec3 v = base.u[b].v + load3(y + 6), w = base.u[b].w + load3(y + 9);
      if (!turn_by(load3(y + 3), base.frames[b].R, most_turn_, w, state.frames[b].R, out + 3)) return false;
      state.frames[b].x = base.frames[b].x + load3(y);
      state.u[b] = {v, w};
      store(v, out);
    }
    return true;
  }
  void put_rates(const State& state, double* out) const {
    for (int b = 0; b < system_.n(); ++b) store(state.u[b], out + 12 * b);
  }
  void put_accelerations(const State& state, double* out) const {
    for (int b = 0; b < system_.n(); ++b) store(state.a[b], out + 12 * b + 6);
  }

  Status accelerate(State& state) { return projection_.accelerate(state); }
  Status settle(State& state, double length, Counters& counters) {
    const Status status = projection_.settle(state, length, counters);
    if (status == Status::success) free_.restore(state);
    return status;
  }
  void return_to(const State& state) { projection_.move_to(state); }
  const State& state(const State& state) const { return state; }
  const State& whole(State& state) { return state; }

  Status confirm_rank() { return projection_.confirm_rank(); }
  const Constraints& joints() const { return projection_.joints(); }
  int redundant_rows() const { return projection_.redundant_rows(); }
  double smallest_pivot() { return projection_.smallest_pivot(); }

 private:
  const System& system_;
  Projection projection_;
  FreeBodies free_;
  const double most_turn_;  // of a body in a step: dexp^-1 is singular at a whole turn
};

}  // namespace lieeuler
