// Coefficients and memory of the generalized-alpha method, equation (4.3) of docs/theory.md. With A and a eliminated it
// is a stabilised implicit Euler step with other numbers:
//
//   M (u - from) = theta f - G^T Lam,   M xi = M (rho u + carry) - G_n^T eta,   Lam = theta lam
//   theta = h gamma (1 - alpha_f) / (1 - alpha_m),   rho = beta / gamma,   a = (u - from) / theta
#pragma once

#include "model/system.hpp"

namespace lieeuler {

class GeneralizedAlpha {
 public:
  // The spectral radius at infinite frequency, from 0 (fast motions are damped out in one step) to 1 (no damping).
  explicit GeneralizedAlpha(double spectral_radius)
      : alpha_m_((2 * spectral_radius - 1) / (spectral_radius + 1)),
        alpha_f_(spectral_radius / (spectral_radius + 1)),
        gamma_(0.5 + alpha_f_ - alpha_m_),
        beta_(0.25 * (gamma_ + 0.5) * (gamma_ + 0.5)) {}

  double force_share() const { return gamma_ * (1 - alpha_f_) / (1 - alpha_m_); }  // theta / h
  double velocity_share() const { return beta_ / gamma_; }                         // rho
  // The time from the start at which A is the acceleration to second order; taken at the start itself, A_0 would reduce
  // the order of the multipliers by one.
  double ahead(double h) const { return (alpha_m_ - alpha_f_) * h; }

  Twist from(int b) const { return from_[b]; }
  Twist carry(int b) const { return carry_[b]; }

  // a and A at the start.
  void start(const std::vector<Twist>& a, const std::vector<Twist>& A) { a_ = a, A_ = A, from_ = carry_ = a; }
  // Updates a and A after a step from u_n to u.
  void advance(const std::vector<Twist>& u_n, const std::vector<Twist>& u, double h) {
    const double theta = force_share() * h;
    for (size_t b = 0; b < a_.size(); ++b) {
      a_[b] = (u[b] - from_[b]) / theta;
      A_[b] = 1 / (gamma_ * h) * u[b] + -1 / (gamma_ * h) * u_n[b] + (1 - 1 / gamma_) * A_[b];
    }
  }
  // Computes from() and carry() for a step from u_n.
  void prepare(const std::vector<Twist>& u_n, double h) {
    const double theta = force_share() * h, rho = velocity_share();
    const double by_A = (alpha_m_ - (1 - alpha_m_) * (1 - gamma_) / gamma_) / (1 - alpha_f_);
    const double by_a = -alpha_f_ / (1 - alpha_f_);
    for (size_t b = 0; b < a_.size(); ++b) {
      from_[b] = u_n[b] + -theta * by_A * A_[b] + -theta * by_a * a_[b];
      carry_[b] = (1 - rho) * u_n[b] + (0.5 - rho) * h * A_[b];
    }
  }

 private:
  double alpha_m_, alpha_f_, gamma_, beta_;
  std::vector<Twist> a_, A_, from_, carry_;
};

}  // namespace lieeuler
