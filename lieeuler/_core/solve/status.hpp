// How a run ends, what it counts, and the sizes of corrections that are rounding.
#pragma once

#include <algorithm>
#include <limits>

namespace lieeuler {

enum class Status {
  success,
  newton_failed,
  singular_matrix,
  map_domain,
  non_finite,
  step_too_small,
  interrupted,
  constraints_open
};

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

inline constexpr double kEps = std::numeric_limits<double>::epsilon();
inline constexpr double kFloor = 4 * kEps;    // a correction of this size is rounding
inline constexpr double kNoise = 1e3 * kEps;  // below this, corrections that no longer shrink are rounding

}  // namespace lieeuler
