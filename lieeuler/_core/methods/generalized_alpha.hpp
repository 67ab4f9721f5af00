// The stabilised generalized-alpha method, (4.3) of docs/theory.md. With A and a eliminated it is a stabilised implicit
// Euler step with other numbers:
//
//   M (u - from) = theta f - G^T Lam,   M xi = M (rho u + carry) - G_n^T eta,   Lam = theta lam
//   theta = h gamma (1 - alpha_f) / (1 - alpha_m),   rho = beta / gamma,   a = (u - from) / theta
#pragma once

#include "methods/euler_lagrange.hpp"

namespace lieeuler {

// The coefficients of a spectral radius at infinite frequency, from 0 (fast motions are damped out in one step) to 1
// (no damping).
struct AlphaCoefficients {
  explicit AlphaCoefficients(double radius)
      : alpha_m((2 * radius - 1) / (radius + 1)),
        alpha_f(radius / (radius + 1)),
        gamma(0.5 + alpha_f - alpha_m),
        beta(0.25 * (gamma + 0.5) * (gamma + 0.5)) {}

  double alpha_m, alpha_f, gamma, beta;
};

class AlphaEquations : public StabilisedEquations {
 public:
  AlphaEquations(const Plan& plan, CoordinateMap map, const AlphaCoefficients& by, Correction correction)
      : StabilisedEquations(plan, map, true, correction, by.gamma * (1 - by.alpha_f) / (1 - by.alpha_m),
                            by.beta / by.gamma),
        by_(by) {}

  // a, and A: the acceleration at a time a little later or earlier. Taken at the start itself, A would reduce the order
  // of the multipliers by one.
  Status begin() override {
    StabilisedEquations::begin();
    const double whole = std::exchange(h, (by_.alpha_m - by_.alpha_f) * h);
    start = state;
    state.frames.follow(start.frames, h);
    bool inside = true;
    for (int b = 0; b < system.n(); ++b) {
      const Twist &u = start.u[b], &a = start.a[b];
      xi[b] = u + 0.5 * h * a;
      state.u[b] = u + h * a;
      inside = move(b) && inside;
    }
    h = whole;
    if (inside) {
      evaluate_joints();
      inside = solve_index1() == Status::success;
    }
    // If the step is too long to solve this, the step itself will fail and give the reason.
    a_ = from_ = start.a, A_ = inside ? state.a : start.a;
    prepare(start.u);
    state = start;
    joints.update(state.frames);
    return saddle.factor(joints) ? Status::success : Status::singular_matrix;
  }
  Status finish() override {
    const Status status = StabilisedEquations::finish();
    for (size_t b = 0; b < a_.size(); ++b) {
      a_[b] = (state.u[b] - from_[b]) / force_time();
      A_[b] = 1 / (by_.gamma * h) * state.u[b] + -1 / (by_.gamma * h) * start.u[b] + (1 - 1 / by_.gamma) * A_[b];
    }
    prepare(state.u);
    return status;
  }
  bool exact_matrix() const override { return StabilisedEquations::exact_matrix() && plan.rotors.empty(); }

 protected:
  const std::vector<Twist>& from() const override { return from_; }
  bool accelerates() const override { return true; }

 private:
  // What the next step from u starts with.
  void prepare(const std::vector<Twist>& u) {
    const double by_A = (by_.alpha_m - (1 - by_.alpha_m) * (1 - by_.gamma) / by_.gamma) / (1 - by_.alpha_f);
    const double by_a = -by_.alpha_f / (1 - by_.alpha_f);
    for (size_t b = 0; b < a_.size(); ++b) {
      from_[b] = u[b] + -force_time() * by_A * A_[b] + -force_time() * by_a * a_[b];
      carry_[b] = (1 - velocity_share) * u[b] + (0.5 - velocity_share) * h * A_[b];
    }
  }

  const AlphaCoefficients by_;
  std::vector<Twist> a_, A_, from_;
};

}  // namespace lieeuler
