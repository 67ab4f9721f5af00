// Numbers, vectors and matrices of several systems at once: each lane of a register belongs to one system.
//
// Every operation rounds as the one on a single system does (model/so3.hpp, Eigen), so that a lane holds its system's
// result to the last bit. Files that include this are compiled once for every instruction set; nothing here has a
// symbol that a linker could mix up.
#pragma once

#include <cstdint>

#include "linalg/convolution.hpp"

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

}  // namespace lieeuler
