// Power series of the vectors of one system, in registers of two components (docs/theory.md, section 12).
#pragma once

#include <cstdint>

#include "linalg/convolution.hpp"
#include "model/so3.hpp"

namespace lieeuler {

typedef double Pair __attribute__((vector_size(16)));
typedef std::uint64_t PairBits __attribute__((vector_size(16)));

using Quad = Stack<Pair, 2>;  // the fourth place is zero
using Doubled = Factors<Pair>;
struct Columns : ColumnStack<Pair, 2> {
  double& operator()(int row, int column) { return reinterpret_cast<double*>(part[column])[row]; }
  double operator()(int row, int column) const { return part[column][row / 2][row % 2]; }
};

inline Pair both(double a) { return Pair{a, a}; }
inline Quad quad(const Vec3& a) { return {{Pair{a[0], a[1]}, Pair{a[2], 0}}}; }
inline Doubled doubled(const Vec3& a) { return {{both(a[0]), both(a[1]), both(a[2])}}; }
inline Vec3 vector(const Quad& a) { return {a.part[0][0], a.part[0][1], a.part[1][0]}; }
inline Vec3 vector(const Doubled& a) { return {a.component[0][0], a.component[1][0], a.component[2][0]}; }
inline Vec3 row(const Columns& A, int i) { return {A(i, 0), A(i, 1), A(i, 2)}; }
inline Mat3 upper(const Columns& A) {
  Mat3 R;
  for (int c = 0; c < 3; ++c) R.col(c) << A.part[c][0][0], A.part[c][0][1], A.part[c][1][0];
  return R;
}
inline void put_upper(Columns& A, const Mat3& R) {
  for (int c = 0; c < 3; ++c) A.part[c][0] = Pair{R(0, c), R(1, c)}, A.part[c][1][0] = R(2, c);
}
// The first three rows times a.
inline Quad times(const Columns& A, const Vec3& a) {
  const Pair p = both(a[0]), q = both(a[1]), r = both(a[2]);
  Quad y;
  for (int i = 0; i < 2; ++i) y.part[i] = A.part[0][i] * p + A.part[1][i] * q + A.part[2][i] * r;
  y.part[1][1] = 0;
  return y;
}
inline double sum(const Quad& a) {
  const Pair pair = a.part[0] + a.part[1];
  return pair[0] + pair[1];
}

// Coefficient k of A^T V, from A_first on. The fourth row of V is zero, so that of A does not matter.
inline Vec3 transpose_times(const Columns* A, const Quad* V, int first, int k) {
  Quad total[3] = {};
  transpose_products(A, V, first, k, total);
  return {sum(total[0]), sum(total[1]), sum(total[2])};
}

// Coefficient k of A . B.
inline double dot(const Quad* A, const Quad* B, int k) {
  Quad total{};
  for (int j = 0; j <= k; ++j)
    for (int i = 0; i < 2; ++i) total.part[i] += A[j].part[i] * B[k - j].part[i];
  return sum(total);
}

// Adds coefficient k of factor s B, with the orders of s below `end`. s is a component of a Quad: its coefficients are
// four doubles apart.
inline void add_scaled(Quad& total, double factor, const double* s, const Quad* B, int end, int k) {
  Quad product{};
  for (int j = 0; j < end; ++j)
    for (int i = 0; i < 2; ++i) product.part[i] += both(s[4 * j]) * B[k - j].part[i];
  for (int i = 0; i < 2; ++i) total.part[i] += both(factor) * product.part[i];
}

inline void add_scaled(Columns& total, double factor, const Columns& A) {
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < 2; ++i) total.part[c][i] += both(factor) * A.part[c][i];
}

// The series at h, from coefficients 0 .. order.
template <class Coefficient>
Coefficient evaluate(const Coefficient* series, int order, double h) {
  return horner(series, order, both(h));
}

}  // namespace lieeuler
