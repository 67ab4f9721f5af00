// Cauchy products of truncated power series of vectors, for (12.1) of docs/theory.md.
//
// Coefficients are stored order by order, with the components of one order side by side in registers of two. A product
// of series then multiplies whole columns by one number and adds up in registers of four, without shuffling.
#pragma once

#include <cstdint>
#include <cstring>

#include "model/so3.hpp"

namespace lieeuler {

typedef double Pair __attribute__((vector_size(16)));
typedef std::uint64_t PairBits __attribute__((vector_size(16)));
typedef double Four __attribute__((vector_size(32)));

// A vector; the fourth place is zero.
struct Quad {
  Pair part[2];
};
// A vector with every component by itself, to multiply columns.
struct Doubled {
  Pair component[3];
};
// The three columns of a matrix of four rows.
struct Columns {
  Pair part[3][2];
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

// Registers of four from and to those of two; by memcpy, because addresses are multiples of 16 only. Processors without
// them take two registers for one.
template <class To, class From>
[[gnu::always_inline]] inline void copy(To& to, const From& from) {
  static_assert(sizeof(To) == sizeof(From));
  std::memcpy(&to, &from, sizeof to);
}
// Sums read a vector at once; if it were written in halves just before, they would wait until it reached memory.
[[gnu::always_inline]] inline void put(Quad& to, const Quad& from) {
  copy(to, Four{from.part[0][0], from.part[0][1], from.part[1][0], from.part[1][1]});
}
[[gnu::always_inline]] inline void fill(Four& to, double a) { to = Four{a, a, a, a}; }

// total += A hat(w)
[[gnu::always_inline]] inline void add_turned(Columns& total, const Columns& A, const Doubled& w) {
  for (int i = 0; i < 2; ++i) {
    total.part[0][i] += A.part[1][i] * w.component[2] - A.part[2][i] * w.component[1];
    total.part[1][i] += A.part[2][i] * w.component[0] - A.part[0][i] * w.component[2];
    total.part[2][i] += A.part[0][i] * w.component[1] - A.part[1][i] * w.component[0];
  }
}
// Coefficient k + 1 of A hat(w) without the term A_0 hat(w_(k+1)). The last row of A is stored shifted by one order;
// for that row the result is the complete coefficient k. Registers of four have names here and below, because GCC keeps
// small arrays of them in memory.
[[gnu::always_inline]] inline void turn(const Columns* A, const Doubled* w, int k, Columns& total) {
  Four x{}, y{}, z{}, a, b, c, p{}, q{}, r{};
  for (int j = 1; j <= k + 1; ++j) {
    const Doubled& rate = w[k + 1 - j];
    copy(a, A[j].part[0]), copy(b, A[j].part[1]), copy(c, A[j].part[2]);
    fill(p, rate.component[0][0]), fill(q, rate.component[1][0]), fill(r, rate.component[2][0]);
    x += b * r - c * q;
    y += c * p - a * r;
    z += a * q - b * p;
  }
  copy(total.part[0], x), copy(total.part[1], y), copy(total.part[2], z);
}

// Coefficient k of A^T V, from A_first on. The fourth row of V is zero, so that of A does not matter.
[[gnu::always_inline]] inline Vec3 transpose_times(const Columns* A, const Quad* V, int first, int k) {
  Quad total[3];
  Four x{}, y{}, z{}, a, b, c, v;
  for (int j = first; j <= k; ++j) {
    copy(a, A[j].part[0]), copy(b, A[j].part[1]), copy(c, A[j].part[2]), copy(v, V[k - j]);
    x += a * v, y += b * v, z += c * v;
  }
  copy(total[0], x), copy(total[1], y), copy(total[2], z);
  return {sum(total[0]), sum(total[1]), sum(total[2])};
}

// Coefficient k of A . B.
[[gnu::always_inline]] inline double dot(const Quad* A, const Quad* B, int k) {
  Quad total;
  Four products{}, a, b;
  for (int j = 0; j <= k; ++j) copy(a, A[j]), copy(b, B[k - j]), products += a * b;
  copy(total, products);
  return sum(total);
}

// Adds coefficient k of factor s B, with the orders of s below `end`. s is a component of a Quad: its coefficients are
// four doubles apart.
[[gnu::always_inline]] inline void add_scaled(Quad& total, double factor, const double* s, const Quad* B, int end,
                                              int k) {
  Quad product;
  Four products{}, share{}, b;
  for (int j = 0; j < end; ++j) copy(b, B[k - j]), fill(share, s[4 * j]), products += share * b;
  copy(product, products);
  for (int i = 0; i < 2; ++i) total.part[i] += both(factor) * product.part[i];
}

inline void add_scaled(Columns& total, double factor, const Columns& A) {
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < 2; ++i) total.part[c][i] += both(factor) * A.part[c][i];
}

// The series at h, from coefficients 0 .. order, by Horner's rule.
template <class Coefficient>
Coefficient evaluate(const Coefficient* series, int order, double h) {
  constexpr int n = sizeof(Coefficient) / sizeof(Pair);
  const Pair step = both(h);
  Coefficient value = series[order];
  Pair* const sum = reinterpret_cast<Pair*>(&value);
  for (int k = order - 1; k >= 0; --k)
    for (int i = 0; i < n; ++i) sum[i] = sum[i] * step + reinterpret_cast<const Pair*>(series + k)[i];
  return value;
}

// x^(1/p) of positive numbers, to 1e-8 and with the same bits on every processor: for step sizes. It is 2^(log2(x)
// inverse), inverse = 1/p; zero where x is. x = 2^e m: log2 m from the series of artanh about sqrt 2, 2^f of the rest f
// from that of exp.
inline Pair root(const Pair& x, const Pair& inverse) {
  constexpr double kLog2 = 0.69314718055994531, kSqrt2 = 1.4142135623730951;
  constexpr double kUnits = 0x1p52, kRounding = 0x1.8p52;  // their last place is one
  constexpr std::uint64_t kOne = 0x3ff0000000000000, kMantissa = 0x000fffffffffffff, kUnitsBits = 0x4330000000000000;
  const PairBits bits = (PairBits)x;
  const Pair exponent = (Pair)((bits >> 52) | kUnitsBits) - (kUnits + 1023);
  const Pair m = (Pair)((bits & kMantissa) | kOne);
  const Pair t = (m - kSqrt2) / (m + kSqrt2), s = t * t;
  const Pair artanh = t * (1 + s * (1. / 3 + s * (1. / 5 + s * (1. / 7 + s * (1. / 9)))));
  const Pair y = inverse * (exponent + 0.5 + (2 / kLog2) * artanh);
  const Pair whole = y + kRounding, f = kLog2 * (y - (whole - kRounding));
  const Pair power =
      1 + f * (1 + f * (1. / 2 + f * (1. / 6 + f * (1. / 24 + f * (1. / 120 + f * (1. / 720 + f * (1. / 5040)))))));
  const Pair value = (Pair)((PairBits)power + ((PairBits)whole << 52));
  return x > 0 ? value : Pair{};
}

}  // namespace lieeuler
