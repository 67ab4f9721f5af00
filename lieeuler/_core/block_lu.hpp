// Sparse LU in blocks of 3 x 3.
//
// Every unknown belongs to a node of three: a translation, a rotation, or up to three constraint rows (fewer are padded
// with the identity). Which blocks can be nonzero and in which order nodes are eliminated is fixed once, when the
// factorization is planned; a factorization then runs down a list of 3 x 3 operations, without search, branch on size
// or allocation.
#pragma once

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <vector>

#include "so3.hpp"

namespace lieeuler {

// A block is stored by rows of four, the last entry unused: rows then fit the vector registers.
inline constexpr int kRow = 4, kBlock = 3 * kRow;

inline void put(double* block, const Mat3& m) {
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) block[kRow * i + k] = m(i, k);
}
inline void add(double* block, const Mat3& m) {
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) block[kRow * i + k] += m(i, k);
}
inline void put_diagonal(double* block, double value) {
  for (int i = 0; i < 3; ++i) block[(kRow + 1) * i] = value;
}

class BlockLU {
 public:
  using Entry = std::pair<int, int>;  // (row node, column node)

  // `order` lists all nodes; `entries` the blocks that may be nonzero off the diagonal.
  void plan(const std::vector<int>& order, const std::set<Entry>& entries) {
    std::vector<std::set<int>> below(order.size()), right(order.size());  // nonzero rows of a column, columns of a row
    for (const auto& [row, column] : entries) below[column].insert(row), right[row].insert(column);
    std::map<Entry, int> places;
    auto place = [&](int row, int column) {
      return places.insert({{row, column}, kBlock * static_cast<int>(places.size())}).first->second;
    };
    for (int node : order) place(node, node);
    for (const auto& [row, column] : entries) place(row, column);
    pivots_.clear(), lowers_.clear(), uppers_.clear(), updates_.clear();
    for (int node : order) {
      for (int row : below[node]) right[row].erase(node), lowers_.push_back({place(row, node), 3 * row});
      for (int column : right[node]) below[column].erase(node), uppers_.push_back({place(node, column), 3 * column});
      for (int row : below[node])
        for (int column : right[node]) {
          updates_.push_back({place(row, node), place(node, column), place(row, column)});
          if (row != column) below[column].insert(row), right[row].insert(column);  // fill
        }
      pivots_.push_back({place(node, node), 3 * node, static_cast<int>(lowers_.size()),
                         static_cast<int>(uppers_.size()), static_cast<int>(updates_.size())});
    }
    values_.assign(kBlock * places.size(), 0.0);
    places_ = std::move(places);
    unknowns_ = 3 * static_cast<int>(order.size());
  }

  int unknowns() const { return unknowns_; }
  // The block (row, column), or nullptr where none was planned.
  double* block(int row, int column) {
    const auto found = places_.find({row, column});
    return found == places_.end() ? nullptr : values_.data() + found->second;
  }
  void set_zero() { std::fill(values_.begin(), values_.end(), 0.0); }

  // False when a diagonal block is singular to rounding.
  bool factor() {
    double* const values = values_.data();
    int upper = 0, update = 0;
    for (const Pivot& pivot : pivots_) {
      double* const diagonal = values + pivot.block;
      if (!invert(diagonal)) return false;
      for (; upper < pivot.last_upper; ++upper) multiply(diagonal, values + uppers_[upper].block);
      for (; update < pivot.last_update; ++update)
        subtract_product(values + updates_[update].lower, values + updates_[update].upper,
                         values + updates_[update].target);
    }
    return true;
  }

  void solve(double* b) const {
    const double* const values = values_.data();
    int lower = 0;
    for (const Pivot& pivot : pivots_) {
      double* const x = b + pivot.unknown;
      const double x0 = x[0], x1 = x[1], x2 = x[2];
      const double* const d = values + pivot.block;
      for (int i = 0; i < 3; ++i) x[i] = d[kRow * i] * x0 + d[kRow * i + 1] * x1 + d[kRow * i + 2] * x2;
      for (; lower < pivot.last_lower; ++lower) subtract(values + lowers_[lower].block, x, b + lowers_[lower].unknown);
    }
    int upper = static_cast<int>(uppers_.size());
    for (size_t k = pivots_.size(); k-- > 0;) {
      const int first = k == 0 ? 0 : pivots_[k - 1].last_upper;
      while (upper > first) {
        --upper;
        subtract(values + uppers_[upper].block, b + uppers_[upper].unknown, b + pivots_[k].unknown);
      }
    }
  }

 private:
  struct Pivot {
    int block, unknown, last_lower, last_upper, last_update;
  };
  struct OffDiagonal {
    int block, unknown;
  };
  struct Update {
    int lower, upper, target;
  };

  // a <- a^-1 by cofactors; false where the volume of the rows is rounding against the product of their lengths.
  static bool invert(double* a) {
    constexpr double kSingular = 1e-14;
    const double a0 = a[0], a1 = a[1], a2 = a[2], b0 = a[4], b1 = a[5], b2 = a[6], c0 = a[8], c1 = a[9], c2 = a[10];
    const double m00 = b1 * c2 - b2 * c1, m01 = b2 * c0 - b0 * c2, m02 = b0 * c1 - b1 * c0;
    const double volume = a0 * m00 + a1 * m01 + a2 * m02;
    const double lengths = (a0 * a0 + a1 * a1 + a2 * a2) * (b0 * b0 + b1 * b1 + b2 * b2) * (c0 * c0 + c1 * c1 + c2 * c2);
    if (!(volume * volume > kSingular * kSingular * lengths)) return false;
    const double inverse = 1 / volume;
    a[0] = inverse * m00, a[4] = inverse * m01, a[8] = inverse * m02;
    a[1] = inverse * (a2 * c1 - a1 * c2), a[5] = inverse * (a0 * c2 - a2 * c0), a[9] = inverse * (a1 * c0 - a0 * c1);
    a[2] = inverse * (a1 * b2 - a2 * b1), a[6] = inverse * (a2 * b0 - a0 * b2), a[10] = inverse * (a0 * b1 - a1 * b0);
    return true;
  }
  // b <- a b
  static void multiply(const double* __restrict a, double* __restrict b) {
    double row[3][kRow];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < kRow; ++j)
        row[i][j] = a[kRow * i] * b[j] + a[kRow * i + 1] * b[kRow + j] + a[kRow * i + 2] * b[2 * kRow + j];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < kRow; ++j) b[kRow * i + j] = row[i][j];
  }
  // c -= a b
  static void subtract_product(const double* __restrict a, const double* __restrict b, double* __restrict c) {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < kRow; ++j)
        c[kRow * i + j] -= a[kRow * i] * b[j] + a[kRow * i + 1] * b[kRow + j] + a[kRow * i + 2] * b[2 * kRow + j];
  }
  // y -= a x
  static void subtract(const double* a, const double* x, double* y) {
    for (int i = 0; i < 3; ++i) y[i] -= a[kRow * i] * x[0] + a[kRow * i + 1] * x[1] + a[kRow * i + 2] * x[2];
  }

  std::vector<Pivot> pivots_;
  std::vector<OffDiagonal> lowers_, uppers_;
  std::vector<Update> updates_;
  std::vector<double> values_;
  std::map<Entry, int> places_;
  int unknowns_ = 0;
};

}  // namespace lieeuler
