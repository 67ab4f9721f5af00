// Newton's iteration for the equations of one step, to rounding level.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace lieeuler {

enum class Status { success, newton_failed, singular_matrix, map_domain, non_finite, step_too_small, interrupted };

struct Counters {
  long steps = 0, rejected_steps = 0, force_evaluations = 0, newton_iterations = 0, factorizations = 0,
       most_iterations = 0;

  // Adds the work; steps are counted when they are accepted.
  void add_to(Counters& total) const {
    total.force_evaluations += force_evaluations;
    total.newton_iterations += newton_iterations;
    total.factorizations += factorizations;
    total.most_iterations = std::max(total.most_iterations, most_iterations);
  }
};

// Guesses the unknowns of the next step by polynomial extrapolation, up to quartic, of the last solutions.
class Predictor {
 public:
  void reset(size_t unknowns) {
    for (auto& past : history_) past.assign(unknowns, 0.0);
    count_ = 0;
  }
  bool empty() const { return count_ == 0; }
  void push(const std::vector<double>& z) {
    newest_ = (newest_ + kPoints - 1) % kPoints;
    std::copy(z.begin(), z.end(), history_[newest_].begin());
    if (count_ < kPoints) ++count_;
  }
  void guess(std::vector<double>& z) const {
    static constexpr double weights[kPoints][kPoints] = {
        {1, 0, 0, 0, 0}, {2, -1, 0, 0, 0}, {3, -3, 1, 0, 0}, {4, -6, 4, -1, 0}, {5, -10, 10, -5, 1}};
    const double* const w = weights[count_ - 1];
    const double w0 = w[0], w1 = w[1], w2 = w[2], w3 = w[3], w4 = w[4];
    const double *const a = past(0), *const b = past(1), *const c = past(2), *const d = past(3), *const e = past(4);
    double* __restrict const out = z.data();
    const size_t n = z.size();
    for (size_t i = 0; i < n; ++i) out[i] = w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i] + w4 * e[i];
  }
  void forget() { count_ = 1; }
  bool extrapolates() const { return count_ > 1; }

 private:
  static constexpr int kPoints = 5;

  const double* past(int k) const { return history_[(newest_ + (k < count_ ? k : 0)) % kPoints].data(); }
  std::vector<double> history_[kPoints];
  int newest_ = 0, count_ = 0;
};

inline constexpr double kEps = std::numeric_limits<double>::epsilon();
inline constexpr double kFloor = 4 * kEps;    // a correction of this size is rounding
inline constexpr double kNoise = 1e3 * kEps;  // below this, corrections that no longer shrink are rounding

// Solves equations.residual(z) = 0 from the guess in z with the matrix at the guess (chord iteration), which is renewed
// if the corrections shrink slowly. equations.at.correct measures a correction as h |du|, the change of the
// configuration, because u itself has rounding errors of eps / h. `target` is the wanted error in that measure.
class Newton {
 public:
  template <class Equations>
  Status solve(Equations& equations, std::vector<double>& z, double target, Counters& counters) {
    const Status status = iterate(equations, z, target, counters);
    return status == Status::success && polishes && target < kNoise ? polish(equations, z, counters) : status;
  }

  // Whether to make one more correction at the end: the stopping test measures h u and leaves an error of eps / h in u.
  bool polishes = false;

  void reset(size_t unknowns) {
    residual_.assign(unknowns, 0.0);
    curvature_ = 1;
  }

 private:
  template <class Equations>
  Status polish(Equations& equations, std::vector<double>& z, Counters& counters) {
    ++counters.force_evaluations, ++counters.newton_iterations;
    if (const Status status = equations.residual(z, residual_); status != Status::success) return status;
    equations.solve_linear(residual_);
    return std::isfinite(equations.at.correct(z, residual_)) ? Status::success : Status::non_finite;
  }

  template <class Equations>
  Status iterate(Equations& equations, std::vector<double>& z, double target, Counters& counters) {
    double first = 0, last = std::numeric_limits<double>::infinity();
    bool renew = true;
    for (int k = 1; k <= kMostIterations; ++k) {
      ++counters.force_evaluations;
      if (const Status status = equations.residual(z, residual_); status != Status::success) return status;
      if (renew) {
        ++counters.factorizations;
        if (!equations.factor()) return Status::singular_matrix;
      }
      if (!equations.solve_linear(residual_)) return Status::newton_failed;
      const double size = equations.at.correct(z, residual_);
      ++counters.newton_iterations;
      counters.most_iterations = std::max<long>(counters.most_iterations, k);
      if (!std::isfinite(size)) return Status::non_finite;
      if (size <= kFloor) return Status::success;
      if (k == 1 ? equations.exact_matrix() && kCaution * curvature_ * size * size <= target
                 : shrunk(size, last, target))
        return Status::success;
      if (k == 1) first = size;
      if (k == 2 && size > kNoise) curvature_ = std::max(curvature_, size / (first * first));
      renew = k > 1 && size > kSlow * last;
      last = size;
    }
    return last <= kStalled ? Status::success : Status::newton_failed;
  }

  // The same next to a singular position, where rounding is larger. By then every matrix is new, so that curvature
  // would leave only the square of a correction: one of this size that does not shrink is rounding.
  static constexpr double kStalled = 1e-9;
  static constexpr double kSlow = 0.1;     // ratio of corrections above which the matrix is renewed
  static constexpr double kCaution = 100;  // safety factor on the curvature measured in earlier steps
  static constexpr int kMostIterations = 25;

  // The first correction, with the derivative at the guess, leaves an error of the curvature times its square. A later
  // one leaves an error of its size times the ratio of the last two.
  static bool shrunk(double size, double last, double target) {
    const double ratio = size / last;
    return size * ratio <= target || (size <= kNoise && ratio > 0.3);
  }

  double curvature_ = 1;  // largest ratio of a second correction to the square of the first; of order 1 by geometry
  std::vector<double> residual_;
};

}  // namespace lieeuler
