// Taylor coefficients of the even functions of |theta| in the maps (3.1) of docs/theory.md, for one number or several
// at once: without Eigen, because several instruction sets share this header.
#pragma once

namespace lieeuler {

// The first `Terms` of sum_k coefficients[k] s^k, highest power first in the loop (Horner).
template <int Terms, int N, class Number>
[[gnu::always_inline]] inline Number polynomial(const double (&coefficients)[N], const Number& s) {
  static_assert(Terms <= N);
  Number value = Number{} + coefficients[Terms - 1];
  for (int k = Terms - 2; k >= 0; --k) value = value * s + coefficients[k];
  return value;
}

// Below this squared angle the series are accurate to rounding with the terms given and need no trigonometric function;
// above it the closed forms lose at most one digit to cancellation.
inline constexpr double kSeriesLimit = 0.25;
// Below this one half of the terms are enough, as for the rotation of one small step.
inline constexpr double kShortSeriesLimit = 1e-3;

inline constexpr double kSincSeries[] = {1.,          -1. / 6,        1. / 120,         -1. / 5040,
                                         1. / 362880, -1. / 39916800, 1. / 6227020800., -1. / 1307674368000.};
inline constexpr double kCoscSeries[] = {1. / 2,       -1. / 24,         1. / 720,          -1. / 40320,
                                         1. / 3628800, -1. / 479001600., 1. / 87178291200., -1. / 20922789888000.};
inline constexpr double kCubicSeries[] = {
    1. / 6,        -1. / 120,         1. / 5040,           -1. / 362880,
    1. / 39916800, -1. / 6227020800., 1. / 1307674368000., -1. / 355687428096000.};
// |B_2k| / (2k)!, k = 1, 2, ...
inline constexpr double kInverseTangentSeries[] = {1. / 12,           1. / 720,
                                                   1. / 30240,        1. / 1209600,
                                                   1. / 47900160,     691. / 1307674368000.,
                                                   1. / 74724249600., 3617. / 10670622842880000.};

}  // namespace lieeuler
