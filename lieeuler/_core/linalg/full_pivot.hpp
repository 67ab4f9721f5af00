// Dense LU with full pivoting and a given rank, for the rows of joints that close loops, redundant ones included.
// The matrix must be scaled so that entries of independent rows are of order one.
#pragma once

#include <cmath>
#include <utility>
#include <vector>

namespace lieeuler {

class FullPivotLU {
 public:
  void resize(int n) {
    n_ = n;
    a_.assign(static_cast<size_t>(n) * n, 0.0);
    rows_.resize(n), columns_.resize(n), work_.resize(n);
  }
  int size() const { return n_; }
  double& operator()(int i, int j) { return a_[static_cast<size_t>(i) * n_ + j]; }

  // Eliminates `rank` pivots and treats the rest as zero. False if one of these pivots is rounding: the rank has
  // dropped, which happens at a singular position.
  bool factor(int rank) {
    rank_ = rank;
    for (int i = 0; i < n_; ++i) rows_[i] = columns_[i] = i;
    return eliminate_while_above(kSingular, rank) == rank;
  }

  // Number of pivots above `tolerance`; overwrites the matrix.
  int rank(double tolerance) { return eliminate_while_above(tolerance, n_); }

  // The smallest pivot taken: near a singular position it is proportional to the square of the distance to it.
  double smallest_pivot() { return rank_ > 0 ? std::abs((*this)(rank_ - 1, rank_ - 1)) : 1; }

  // x <- a solution y of A y = x, with zeros for the columns without a pivot.
  void solve(double* x) {
    for (int i = 0; i < rank_; ++i) {
      double sum = x[rows_[i]];
      for (int k = 0; k < i; ++k) sum -= (*this)(i, k) * work_[k];
      work_[i] = sum;
    }
    back_substitute();
    for (int i = 0; i < n_; ++i) x[columns_[i]] = i < rank_ ? work_[i] : 0.0;
  }

  // x <- the k-th vector with A x = 0, k < size - rank.
  void null_vector(int k, double* x) {
    for (int i = 0; i < rank_; ++i) work_[i] = -(*this)(i, rank_ + k);
    back_substitute();
    for (int i = 0; i < n_; ++i) x[columns_[i]] = i < rank_ ? work_[i] : (i == rank_ + k ? 1.0 : 0.0);
  }

 private:
  static constexpr double kSingular = 1e-13;

  int eliminate_while_above(double tolerance, int most) {
    for (int k = 0; k < most; ++k) {
      if (!(bring_up_largest(k) > tolerance)) return k;
      eliminate(k);
    }
    return most;
  }
  double bring_up_largest(int k) {
    int row = k, column = k;
    double largest = -1;
    for (int i = k; i < n_; ++i)
      for (int j = k; j < n_; ++j)
        if (std::abs((*this)(i, j)) > largest) largest = std::abs((*this)(i, j)), row = i, column = j;
    if (row != k) {
      std::swap(rows_[row], rows_[k]);
      for (int j = 0; j < n_; ++j) std::swap((*this)(row, j), (*this)(k, j));
    }
    if (column != k) {
      std::swap(columns_[column], columns_[k]);
      for (int i = 0; i < n_; ++i) std::swap((*this)(i, column), (*this)(i, k));
    }
    return largest;
  }
  void eliminate(int k) {
    for (int i = k + 1; i < n_; ++i) {
      const double factor = (*this)(i, k) /= (*this)(k, k);
      for (int j = k + 1; j < n_; ++j) (*this)(i, j) -= factor * (*this)(k, j);
    }
  }
  void back_substitute() {
    for (int i = rank_; i-- > 0;) {
      for (int k = i + 1; k < rank_; ++k) work_[i] -= (*this)(i, k) * work_[k];
      work_[i] /= (*this)(i, i);
    }
  }

  int n_ = 0, rank_ = 0;
  std::vector<double> a_, work_;
  std::vector<int> rows_, columns_;
};

}  // namespace lieeuler
