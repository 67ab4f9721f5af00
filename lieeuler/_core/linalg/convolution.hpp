// Cauchy products of truncated power series of vectors.
//
// Coefficients are stored order by order, with the components of one order side by side in registers. A product of
// series then multiplies whole columns by one number and adds up in registers, without shuffling. A register holds two
// components of one system (linalg/series.hpp), or one component of several systems (methods/taylor_lanes.hpp); both
// add up in the same order. Always inlined, because several instruction sets share this header.
#pragma once

namespace lieeuler {

// A vector, or a column of a matrix, in registers.
template <class Register, int count>
struct Stack {
  using Part = Register;
  Register part[count];
  [[gnu::always_inline]] Register& operator[](int i) { return part[i]; }
  [[gnu::always_inline]] const Register& operator[](int i) const { return part[i]; }
};
// A vector with every component by itself, to multiply columns.
template <class Register>
struct Factors {
  using Part = Register;
  Register component[3];
};
// The three columns of a matrix of four rows.
template <class Register, int count>
struct ColumnStack {
  using Part = Register;
  Register part[3][count];
};

// total += A hat(w)
template <class Register, int count>
[[gnu::always_inline]] inline void add_turned(ColumnStack<Register, count>& total,
                                              const ColumnStack<Register, count>& A, const Factors<Register>& w) {
  for (int i = 0; i < count; ++i) {
    total.part[0][i] += A.part[1][i] * w.component[2] - A.part[2][i] * w.component[1];
    total.part[1][i] += A.part[2][i] * w.component[0] - A.part[0][i] * w.component[2];
    total.part[2][i] += A.part[0][i] * w.component[1] - A.part[1][i] * w.component[0];
  }
}
// Coefficient k + 1 of A hat(w) without the term A_0 hat(w_(k+1)). The last row of A is stored shifted by one order;
// for that row the result is the complete coefficient k.
template <class Columns, class Rate>
[[gnu::always_inline]] inline Columns turned(const Columns* A, const Rate* w, int k) {
  Columns total{};
  for (int j = 1; j <= k + 1; ++j) add_turned(total, A[j], w[k + 1 - j]);
  return total;
}

// Coefficient k of A^T V, from A_first on, by columns of products that are still to be added up.
template <class Register, int rows, int count>
[[gnu::always_inline]] inline void transpose_products(const ColumnStack<Register, rows>* A,
                                                      const Stack<Register, count>* V, int first, int k,
                                                      Stack<Register, count> (&total)[3]) {
  for (int j = first; j <= k; ++j)
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < count; ++i) total[c].part[i] += A[j].part[c][i] * V[k - j].part[i];
}

// Horner's rule, coefficients 0 .. order; `step` fills a register.
template <class Coefficient>
[[gnu::always_inline]] inline Coefficient horner(const Coefficient* series, int order,
                                                 const typename Coefficient::Part& step) {
  using Part = typename Coefficient::Part;
  constexpr int n = sizeof(Coefficient) / sizeof(Part);
  Coefficient value = series[order];
  Part* const sum = reinterpret_cast<Part*>(&value);
  for (int k = order - 1; k >= 0; --k)
    for (int i = 0; i < n; ++i) sum[i] = sum[i] * step + reinterpret_cast<const Part*>(series + k)[i];
  return value;
}

}  // namespace lieeuler
