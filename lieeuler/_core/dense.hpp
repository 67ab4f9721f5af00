// Small dense kernels, row-major, with sizes known to the compiler where scenes use them.
//
// A node of the elimination is a body (6 or 12 unknowns) or a joint (1 to 12); each operation is picked once, when the
// elimination is planned, so that a step runs without branches on sizes and without allocation.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>

namespace lieeuler::dense {

// LU factors of the leading n x n matrix, partial pivoting; false when a pivot vanishes against the column's size.
// N > 0: the size, known to the compiler; N = 0: given by n.
template <int N>
bool factor(int n, double* a, int* pivots) {
  if constexpr (N > 0) n = N;
  for (int k = 0; k < n; ++k) {
    int p = k;
    double largest = std::abs(a[k * n + k]);
    for (int i = k + 1; i < n; ++i)
      if (std::abs(a[i * n + k]) > largest) largest = std::abs(a[i * n + k]), p = i;
    pivots[k] = p;
    if (!(largest > 0) || !std::isfinite(largest)) return false;
    if (p != k)
      for (int j = 0; j < n; ++j) std::swap(a[k * n + j], a[p * n + j]);
    const double inverse = 1 / a[k * n + k];
    a[k * n + k] = inverse;  // the diagonal of U is kept inverted
    for (int i = k + 1; i < n; ++i) {
      const double l = a[i * n + k] *= inverse;
      for (int j = k + 1; j < n; ++j) a[i * n + j] -= l * a[k * n + j];
    }
  }
  return true;
}

// b <- A^-1 b for the factors above; b is n x C.
template <int N, int C>
void solve(int n, int columns, const double* a, const int* pivots, double* b) {
  if constexpr (N > 0) n = N;
  if constexpr (C > 0) columns = C;
  for (int k = 0; k < n; ++k)
    if (pivots[k] != k)
      for (int j = 0; j < columns; ++j) std::swap(b[k * columns + j], b[pivots[k] * columns + j]);
  for (int i = 1; i < n; ++i)
    for (int k = 0; k < i; ++k) {
      const double l = a[i * n + k];
      for (int j = 0; j < columns; ++j) b[i * columns + j] -= l * b[k * columns + j];
    }
  for (int i = n - 1; i >= 0; --i) {
    for (int k = i + 1; k < n; ++k) {
      const double u = a[i * n + k];
      for (int j = 0; j < columns; ++j) b[i * columns + j] -= u * b[k * columns + j];
    }
    for (int j = 0; j < columns; ++j) b[i * columns + j] *= a[i * n + i];
  }
}

// c -= a b; a is R x K, b is K x C.
template <int R, int K, int C>
void subtract_product(int rows, int inner, int columns, const double* a, const double* b, double* c) {
  if constexpr (R > 0) rows = R;
  if constexpr (K > 0) inner = K;
  if constexpr (C > 0) columns = C;
  for (int i = 0; i < rows; ++i)
    for (int k = 0; k < inner; ++k) {
      const double factor = a[i * inner + k];
      for (int j = 0; j < columns; ++j) c[i * columns + j] -= factor * b[k * columns + j];
    }
}

using Factor = bool (*)(int, double*, int*);
using Solve = void (*)(int, int, const double*, const int*, double*);
using SubtractProduct = void (*)(int, int, int, const double*, const double*, double*);

inline Factor pick_factor(int n) {
  switch (n) {
    case 3: return factor<3>;
    case 5: return factor<5>;
    case 6: return factor<6>;
    case 12: return factor<12>;
    default: return factor<0>;
  }
}

template <int N>
Solve pick_solve(int columns) {
  switch (columns) {
    case 1: return solve<N, 1>;
    case 3: return solve<N, 3>;
    case 5: return solve<N, 5>;
    case 6: return solve<N, 6>;
    case 12: return solve<N, 12>;
    default: return solve<N, 0>;
  }
}

inline Solve pick_solve(int n, int columns) {
  switch (n) {
    case 3: return pick_solve<3>(columns);
    case 5: return pick_solve<5>(columns);
    case 6: return pick_solve<6>(columns);
    case 12: return pick_solve<12>(columns);
    default: return pick_solve<0>(columns);
  }
}

template <int R, int K>
SubtractProduct pick_product(int columns) {
  switch (columns) {
    case 1: return subtract_product<R, K, 1>;
    case 3: return subtract_product<R, K, 3>;
    case 6: return subtract_product<R, K, 6>;
    case 12: return subtract_product<R, K, 12>;
    default: return subtract_product<R, K, 0>;
  }
}

template <int R>
SubtractProduct pick_product(int inner, int columns) {
  switch (inner) {
    case 3: return pick_product<R, 3>(columns);
    case 6: return pick_product<R, 6>(columns);
    case 12: return pick_product<R, 12>(columns);
    default: return pick_product<R, 0>(columns);
  }
}

inline SubtractProduct pick_product(int rows, int inner, int columns) {
  switch (rows) {
    case 3: return pick_product<3>(inner, columns);
    case 6: return pick_product<6>(inner, columns);
    case 12: return pick_product<12>(inner, columns);
    default: return pick_product<0>(inner, columns);
  }
}

}  // namespace lieeuler::dense
