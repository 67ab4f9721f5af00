// Cauchy products of truncated power series of vectors.
//
// Coefficients are stored order by order, with the components of one order side by side in registers of two. A product
// of series then multiplies whole columns by one number and adds up in registers, without shuffling.
#pragma once

#include "model/so3.hpp"

namespace lieeuler {

typedef double Pair __attribute__((vector_size(16), may_alias));

// A vector; the fourth place is zero.
struct Quad {
  Pair half[2];
};
// A vector with every component stored twice, to multiply columns.
struct Doubled {
  Pair component[3];
};
// The three columns of a matrix of four rows.
struct Columns {
  Pair half[3][2];
  double& operator()(int row, int column) { return reinterpret_cast<double*>(half[column])[row]; }
  double operator()(int row, int column) const { return half[column][row / 2][row % 2]; }
};

inline Pair both(double a) { return Pair{a, a}; }
inline Quad quad(const Vec3& a) { return {{Pair{a[0], a[1]}, Pair{a[2], 0}}}; }
inline Doubled doubled(const Vec3& a) { return {{both(a[0]), both(a[1]), both(a[2])}}; }
inline Vec3 vector(const Quad& a) { return {a.half[0][0], a.half[0][1], a.half[1][0]}; }
inline Vec3 vector(const Doubled& a) { return {a.component[0][0], a.component[1][0], a.component[2][0]}; }
inline Vec3 row(const Columns& A, int i) { return {A(i, 0), A(i, 1), A(i, 2)}; }
inline Mat3 upper(const Columns& A) {
  Mat3 R;
  for (int c = 0; c < 3; ++c) R.col(c) << A.half[c][0][0], A.half[c][0][1], A.half[c][1][0];
  return R;
}
inline void put_upper(Columns& A, const Mat3& R) {
  for (int c = 0; c < 3; ++c) A.half[c][0] = Pair{R(0, c), R(1, c)}, A.half[c][1][0] = R(2, c);
}
// The first three rows times a.
inline Quad times(const Columns& A, const Vec3& a) {
  const Pair p = both(a[0]), q = both(a[1]), r = both(a[2]);
  Quad y;
  for (int i = 0; i < 2; ++i) y.half[i] = A.half[0][i] * p + A.half[1][i] * q + A.half[2][i] * r;
  y.half[1][1] = 0;
  return y;
}
inline double sum(const Quad& a) {
  const Pair pair = a.half[0] + a.half[1];
  return pair[0] + pair[1];
}

// total += A hat(w)
inline void add_turned(Columns& total, const Columns& A, const Doubled& w) {
  for (int i = 0; i < 2; ++i) {
    total.half[0][i] += A.half[1][i] * w.component[2] - A.half[2][i] * w.component[1];
    total.half[1][i] += A.half[2][i] * w.component[0] - A.half[0][i] * w.component[2];
    total.half[2][i] += A.half[0][i] * w.component[1] - A.half[1][i] * w.component[0];
  }
}
// Coefficient k + 1 of A hat(w) without the term A_0 hat(w_(k+1)). The last row of A is stored shifted by one order;
// for that row the result is the complete coefficient k.
inline Columns turned(const Columns* A, const Doubled* w, int k) {
  Columns total{};
  for (int j = 1; j <= k + 1; ++j) add_turned(total, A[j], w[k + 1 - j]);
  return total;
}

// Coefficient k of A^T V, from A_first on. The fourth row of V is zero, so that of A does not matter.
inline Vec3 transpose_times(const Columns* A, const Quad* V, int first, int k) {
  Quad total[3] = {};
  for (int j = first; j <= k; ++j)
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < 2; ++i) total[c].half[i] += A[j].half[c][i] * V[k - j].half[i];
  return {sum(total[0]), sum(total[1]), sum(total[2])};
}

// Coefficient k of A . B.
inline double dot(const Quad* A, const Quad* B, int k) {
  Quad total{};
  for (int j = 0; j <= k; ++j)
    for (int i = 0; i < 2; ++i) total.half[i] += A[j].half[i] * B[k - j].half[i];
  return sum(total);
}

// Adds coefficient k of factor s B, with the orders of s below `end`. s is a component of a Quad: its coefficients are
// four doubles apart.
inline void add_scaled(Quad& total, double factor, const double* s, const Quad* B, int end, int k) {
  Quad product{};
  for (int j = 0; j < end; ++j)
    for (int i = 0; i < 2; ++i) product.half[i] += both(s[4 * j]) * B[k - j].half[i];
  for (int i = 0; i < 2; ++i) total.half[i] += both(factor) * product.half[i];
}

inline void add_scaled(Columns& total, double factor, const Columns& A) {
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < 2; ++i) total.half[c][i] += both(factor) * A.half[c][i];
}

// Horner's rule, coefficients 0 .. order.
template <class Coefficient>
Coefficient evaluate(const Coefficient* series, int order, double h) {
  constexpr int n = sizeof(Coefficient) / sizeof(Pair);
  Coefficient value = series[order];
  Pair* const sum = reinterpret_cast<Pair*>(&value);
  const Pair step = both(h);
  for (int k = order - 1; k >= 0; --k)
    for (int i = 0; i < n; ++i) sum[i] = sum[i] * step + reinterpret_cast<const Pair*>(series + k)[i];
  return value;
}

}  // namespace lieeuler
