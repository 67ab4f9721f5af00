// Numbers, vectors and matrices of several systems at once: each lane of a register belongs to one system.
//
// Every operation rounds as the one on a single system does (model/so3.hpp, Eigen), so that a lane holds its system's
// result to the last bit. Files that include this are compiled once for every instruction set; nothing here has a
// symbol that a linker could mix up.
#pragma once

#include <cstdint>

#include "linalg/convolution.hpp"
#include "linalg/elimination.hpp"

namespace lieeuler {

template <int width>
struct Registers {
  typedef double Number __attribute__((vector_size(8 * width)));
  typedef std::int64_t Mask __attribute__((vector_size(8 * width)));  // of comparisons
  typedef std::uint64_t Bits __attribute__((vector_size(8 * width)));
};

template <class Number>
[[gnu::always_inline]] inline Number larger(const Number& a, const Number& b) {
  return a < b ? b : a;
}
template <class Number>
[[gnu::always_inline]] inline Number smaller(const Number& a, const Number& b) {
  return b < a ? b : a;
}
template <class Number>
[[gnu::always_inline]] inline Number absolute(const Number& a) {
  return a < 0 ? -a : a;
}

template <class Number>
using Triple = Stack<Number, 3>;

template <class Number>
[[gnu::always_inline]] inline Triple<Number> operator+(const Triple<Number>& a, const Triple<Number>& b) {
  return {{a[0] + b[0], a[1] + b[1], a[2] + b[2]}};
}
template <class Number>
[[gnu::always_inline]] inline Triple<Number> operator-(const Triple<Number>& a, const Triple<Number>& b) {
  return {{a[0] - b[0], a[1] - b[1], a[2] - b[2]}};
}
template <class Number>
[[gnu::always_inline]] inline Triple<Number> operator-(const Triple<Number>& a) {
  return {{-a[0], -a[1], -a[2]}};
}
template <class Number>
[[gnu::always_inline]] inline Triple<Number> operator*(const Number& s, const Triple<Number>& a) {
  return {{s * a[0], s * a[1], s * a[2]}};
}
template <class Number>
[[gnu::always_inline]] inline Triple<Number> cross(const Triple<Number>& a, const Triple<Number>& b) {
  return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}
template <class Number>
[[gnu::always_inline]] inline Number dot(const Triple<Number>& a, const Triple<Number>& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class Number>
[[gnu::always_inline]] inline Number largest(const Triple<Number>& a) {
  return larger(larger(absolute(a[0]), absolute(a[1])), absolute(a[2]));
}

// A matrix of three columns, or a matrix of four rows whose last one is left out.
template <class Number, int rows>
[[gnu::always_inline]] inline Triple<Number> times(const ColumnStack<Number, rows>& m, const Triple<Number>& x) {
  Triple<Number> y;
  for (int i = 0; i < 3; ++i) y[i] = m.part[0][i] * x[0] + m.part[1][i] * x[1] + m.part[2][i] * x[2];
  return y;
}
template <class Number, int rows>
[[gnu::always_inline]] inline Triple<Number> transposed_times(const ColumnStack<Number, rows>& m,
                                                              const Triple<Number>& x) {
  Triple<Number> y;
  for (int c = 0; c < 3; ++c) y[c] = m.part[c][0] * x[0] + m.part[c][1] * x[1] + m.part[c][2] * x[2];
  return y;
}

// a in every lane.
template <class Number>
[[gnu::always_inline]] inline Number all(double a) {
  return Number{} + a;
}
template <class Mask>
[[gnu::always_inline]] inline bool any(const Mask& mask) {
  std::int64_t found = 0;
  for (unsigned i = 0; i < sizeof(Mask) / sizeof(found); ++i) found |= mask[i];
  return found != 0;
}

template <class Number>
[[gnu::always_inline]] inline Triple<Number> column(const ColumnStack<Number, 3>& m, int c) {
  return {{m.part[c][0], m.part[c][1], m.part[c][2]}};
}
template <class Number>
[[gnu::always_inline]] inline void put_column(ColumnStack<Number, 3>& m, int c, const Triple<Number>& a) {
  for (int i = 0; i < 3; ++i) m.part[c][i] = a[i];
}
template <class Number>
[[gnu::always_inline]] inline ColumnStack<Number, 3> transposed(const ColumnStack<Number, 3>& m) {
  ColumnStack<Number, 3> t;
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < 3; ++i) t.part[c][i] = m.part[i][c];
  return t;
}
// a b, in the order of Eigen, which adds up the last row from its end.
template <class Number>
[[gnu::always_inline]] inline ColumnStack<Number, 3> product(const ColumnStack<Number, 3>& a,
                                                             const ColumnStack<Number, 3>& b) {
  ColumnStack<Number, 3> m;
  for (int c = 0; c < 3; ++c) {
    for (int i = 0; i < 2; ++i)
      m.part[c][i] = a.part[0][i] * b.part[c][0] + a.part[1][i] * b.part[c][1] + a.part[2][i] * b.part[c][2];
    m.part[c][2] = a.part[0][2] * b.part[c][0] + (a.part[1][2] * b.part[c][1] + a.part[2][2] * b.part[c][2]);
  }
  return m;
}
// R hat(s)
template <class Number>
[[gnu::always_inline]] inline ColumnStack<Number, 3> turned(const ColumnStack<Number, 3>& R, const Triple<Number>& s) {
  ColumnStack<Number, 3> m;
  put_column(m, 0, s[2] * column(R, 1) - s[1] * column(R, 2));
  put_column(m, 1, s[0] * column(R, 2) - s[2] * column(R, 0));
  put_column(m, 2, s[1] * column(R, 0) - s[0] * column(R, 1));
  return m;
}
// a I + b hat(theta) + c theta theta^T, as in so3.hpp.
template <class Number>
[[gnu::always_inline]] inline ColumnStack<Number, 3> quadratic(const Triple<Number>& theta, const Number& a,
                                                               const Number& b, const Number& c) {
  ColumnStack<Number, 3> m;
  const Triple<Number> scaled = c * theta, v = b * theta;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) m.part[j][i] = scaled[i] * theta[j];
  for (int i = 0; i < 3; ++i) m.part[i][i] += a;
  m.part[1][0] -= v[2], m.part[2][0] += v[1], m.part[0][1] += v[2];
  m.part[2][1] -= v[0], m.part[0][2] -= v[1], m.part[1][2] += v[0];
  return m;
}
// One Newton step towards the nearest rotation, as in so3.hpp.
template <class Number>
[[gnu::always_inline]] inline Number polish(ColumnStack<Number, 3>& R) {
  const Triple<Number> a = column(R, 0), b = column(R, 1), c = column(R, 2);
  const Number aa = 0.5 * (1 - dot(a, a)), bb = 0.5 * (1 - dot(b, b)), cc = 0.5 * (1 - dot(c, c));
  const Number ab = -0.5 * dot(a, b), bc = -0.5 * dot(b, c), ca = -0.5 * dot(c, a);
  put_column(R, 0, a + (aa * a + ab * b + ca * c));
  put_column(R, 1, b + (ab * a + bb * b + bc * c));
  put_column(R, 2, c + (ca * a + bc * b + cc * c));
  return 2 * larger(largest(Triple<Number>{{aa, bb, cc}}), largest(Triple<Number>{{ab, bc, ca}}));
}

// What the methods with lanes hold of bodies, one system to a lane.
template <int width>
struct LaneTwist {
  using Number = typename Registers<width>::Number;
  Triple<Number> v, w;
};
// The configuration and motion of a body.
template <int width>
struct LaneState {
  using Number = typename Registers<width>::Number;
  ColumnStack<Number, 3> R;
  Triple<Number> x;
  LaneTwist<width> u;
};
// What never changes of it.
template <int width>
struct LaneInertia {
  using Number = typename Registers<width>::Number;
  Number mass_inverse;
  Triple<Number> weight, spin;  // mass times gravity
  ColumnStack<Number, 3> deviation, inertia_inverse;
};

}  // namespace lieeuler
