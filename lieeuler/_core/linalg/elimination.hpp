// Elimination of matrices of 3 x 3 blocks and of small dense ones.
#pragma once

#include <cmath>

namespace lieeuler {

// A block is stored by columns of four, the last entry unused: columns then fit the vector registers.
inline constexpr int kColumn = 4, kBlock = 3 * kColumn;

// The inverse by cofactors of a matrix whose rows (or columns) are `stride` apart, and whether it exists: their volume
// is not rounding compared with the product of their lengths.
template <int stride>
[[gnu::always_inline]] inline bool invert_by_cofactors(const double* a, double* out) {
  constexpr double kSingular = 1e-14;
  const double *b = a + stride, *c = b + stride;
  const double a0 = a[0], a1 = a[1], a2 = a[2], b0 = b[0], b1 = b[1], b2 = b[2], c0 = c[0], c1 = c[1], c2 = c[2];
  const double m00 = b1 * c2 - b2 * c1, m01 = b2 * c0 - b0 * c2, m02 = b0 * c1 - b1 * c0;
  const double volume = a0 * m00 + a1 * m01 + a2 * m02;
  const double lengths = (a0 * a0 + a1 * a1 + a2 * a2) * (b0 * b0 + b1 * b1 + b2 * b2) * (c0 * c0 + c1 * c1 + c2 * c2);
  const double inverse = 1 / volume;
  double *p = out + stride, *q = p + stride;
  out[0] = inverse * m00, p[0] = inverse * m01, q[0] = inverse * m02;
  out[1] = inverse * (a2 * c1 - a1 * c2), p[1] = inverse * (a0 * c2 - a2 * c0), q[1] = inverse * (a1 * c0 - a0 * c1);
  out[2] = inverse * (a1 * b2 - a2 * b1), p[2] = inverse * (a2 * b0 - a0 * b2), q[2] = inverse * (a0 * b1 - a1 * b0);
  return volume * volume > kSingular * kSingular * lengths;
}

// The operations of a factorization in blocks: places of blocks among the values, and of unknowns.
struct BlockSteps {
  struct Pivot {
    int block, unknown, last_lower, last_upper, last_update;
  };
  struct OffDiagonal {
    int block, unknown;
  };
  struct Update {
    int lower, upper, target;
  };
  int count;
  const Pivot* pivots;
  const OffDiagonal *lowers, *uppers;
  const Update* updates;
};

// The steps are copied: stores to registers of a matrix might change others, as far as the compiler knows.
//
// Factors by the steps with  invert(block),  multiply(a, b): b <- a b,  subtract(a, b, c): c -= a b.  False as soon as
// invert() is.
template <class By>
[[gnu::always_inline]] inline bool factor_blocks(const BlockSteps steps, const By by) {
  int upper = 0, update = 0;
  for (int k = 0; k < steps.count; ++k) {
    const BlockSteps::Pivot& pivot = steps.pivots[k];
    if (!by.invert(pivot.block)) return false;
    for (; upper < pivot.last_upper; ++upper) by.multiply(pivot.block, steps.uppers[upper].block);
    for (; update < pivot.last_update; ++update) {
      const BlockSteps::Update& each = steps.updates[update];
      by.subtract(each.lower, each.upper, each.target);
    }
  }
  return true;
}
// Solves with  multiply(block, x): x <- block x,  subtract(block, x, y): y -= block x  of unknowns x and y.
template <class By>
[[gnu::always_inline]] inline void substitute_forward(const BlockSteps steps, const By by) {
  int lower = 0;
  for (int k = 0; k < steps.count; ++k) {
    const BlockSteps::Pivot& pivot = steps.pivots[k];
    by.multiply(pivot.block, pivot.unknown);
    for (; lower < pivot.last_lower; ++lower)
      by.subtract(steps.lowers[lower].block, pivot.unknown, steps.lowers[lower].unknown);
  }
}
template <class By>
[[gnu::always_inline]] inline void substitute_back(const BlockSteps steps, const By by) {
  for (int k = steps.count; k-- > 0;) {
    const int first = k == 0 ? 0 : steps.pivots[k - 1].last_upper;
    for (int upper = steps.pivots[k].last_upper; upper-- > first;)
      by.subtract(steps.uppers[upper].block, steps.uppers[upper].unknown, steps.pivots[k].unknown);
  }
}

// S = L L^T of so many rows, by columns `stride` apart, with L in place of the lower half and the inverses of its
// diagonal apart. Returns the smallest pivot relative to its entry of S; a NaN is one.
template <int stride>
[[gnu::always_inline]] inline double factor_dense(double* S, int rows, double* inverse) {
  double entry[stride], least = 1;
  for (int j = 0; j < rows; ++j) entry[j] = S[(stride + 1) * j];
  for (int j = 0; j < rows; ++j) {
    double* const column = S + stride * j;
    const double left = column[j] / entry[j];
    least = (left > least) | (least != least) ? least : left;
    inverse[j] = 1 / std::sqrt(column[j]);
    for (int i = j + 1; i < rows; ++i) column[i] *= inverse[j];
    for (int k = j + 1; k < rows; ++k) {
      double* const other = S + stride * k;
      const double factor = column[k];
      for (int i = k; i < rows; ++i) other[i] -= factor * column[i];
    }
  }
  return least;
}
// x <- S^-1 x
template <int stride>
[[gnu::always_inline]] inline void solve_dense(const double* S, int rows, const double* inverse, double* x) {
  for (int j = 0; j < rows; ++j) {
    const double* const column = S + stride * j;
    x[j] *= inverse[j];
    for (int i = j + 1; i < rows; ++i) x[i] -= x[j] * column[i];
  }
  for (int j = rows - 1; j >= 0; --j) {
    const double* const column = S + stride * j;
    double sum = x[j];
    for (int i = j + 1; i < rows; ++i) sum -= column[i] * x[i];
    x[j] = sum * inverse[j];
  }
}

}  // namespace lieeuler
