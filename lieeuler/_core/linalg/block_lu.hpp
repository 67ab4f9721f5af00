// Sparse LU in blocks of 3 x 3, a list of operations planned once (docs/theory.md, section 8). The last nodes, the
// tail, belong to joints that close loops: they are factored densely with full pivoting, to a rank found beforehand.
#pragma once

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <vector>

#include "linalg/full_pivot.hpp"
#include "model/so3.hpp"

namespace lieeuler {

// A block is stored by columns of four, the last entry unused: columns then fit the vector registers.
inline constexpr int kColumn = 4, kBlock = 3 * kColumn;

inline void put(double* block, const Mat3& m) {
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) block[kColumn * j + i] = m(i, j);
}
inline void add(double* block, const Mat3& m) {
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) block[kColumn * j + i] += m(i, j);
}
inline void put_diagonal(double* block, double value) {
  for (int i = 0; i < 3; ++i) block[(kColumn + 1) * i] = value;
}

// a x, two rows at a time.
struct Product {
  Eigen::Vector2d head;
  double last;
};
EIGEN_ALWAYS_INLINE Product product(const double* a, const double* x) {
  using Head = Eigen::Map<const Eigen::Vector2d>;
  const double *b = a + kColumn, *c = b + kColumn;
  return {x[0] * Head(a) + x[1] * Head(b) + x[2] * Head(c), a[2] * x[0] + b[2] * x[1] + c[2] * x[2]};
}
// y -= a x
EIGEN_ALWAYS_INLINE void subtract(const double* a, const double* x, double* y) {
  const Product ax = product(a, x);
  Eigen::Map<Eigen::Vector2d>(y) -= ax.head;
  y[2] -= ax.last;
}
// a b_j, one column.
EIGEN_ALWAYS_INLINE Eigen::Vector4d column(const double* a, const double* b) {
  using Column = Eigen::Map<const Eigen::Vector4d>;
  return b[0] * Column(a) + b[1] * Column(a + kColumn) + b[2] * Column(a + 2 * kColumn);
}
// c -= a b
inline void subtract_product(const double* __restrict a, const double* __restrict b, double* __restrict c) {
  for (int j = 0; j < kBlock; j += kColumn) Eigen::Map<Eigen::Vector4d>(c + j) -= column(a, b + j);
}

// The inverse by cofactors of a matrix whose rows (or columns) are `stride` apart; false if their volume is rounding
// compared with the product of their lengths.
template <int stride>
bool invert_by_cofactors(const double* a, double* out) {
  constexpr double kSingular = 1e-14;
  const double *b = a + stride, *c = b + stride;
  const double a0 = a[0], a1 = a[1], a2 = a[2], b0 = b[0], b1 = b[1], b2 = b[2], c0 = c[0], c1 = c[1], c2 = c[2];
  const double m00 = b1 * c2 - b2 * c1, m01 = b2 * c0 - b0 * c2, m02 = b0 * c1 - b1 * c0;
  const double volume = a0 * m00 + a1 * m01 + a2 * m02;
  const double lengths = (a0 * a0 + a1 * a1 + a2 * a2) * (b0 * b0 + b1 * b1 + b2 * b2) * (c0 * c0 + c1 * c1 + c2 * c2);
  if (!(volume * volume > kSingular * kSingular * lengths)) return false;
  const double inverse = 1 / volume;
  double *p = out + stride, *q = p + stride;
  out[0] = inverse * m00, p[0] = inverse * m01, q[0] = inverse * m02;
  out[1] = inverse * (a2 * c1 - a1 * c2), p[1] = inverse * (a0 * c2 - a2 * c0), q[1] = inverse * (a1 * c0 - a0 * c1);
  out[2] = inverse * (a1 * b2 - a2 * b1), p[2] = inverse * (a2 * b0 - a0 * b2), q[2] = inverse * (a0 * b1 - a1 * b0);
  return true;
}
// Whether Eigen stores rows or columns does not matter here.
inline bool invert(const Mat3& m, Mat3& out) { return invert_by_cofactors<3>(m.data(), out.data()); }

// Which blocks may be nonzero, and the operations of a factorization in a given order of nodes.
class BlockPlan {
 public:
  using Entry = std::pair<int, int>;  // (row node, column node)

  // `order` lists all nodes, of which the last `tail` are factored densely; `entries` lists the blocks off the diagonal
  // that may be nonzero.
  BlockPlan(const std::vector<int>& order, int tail, const std::set<Entry>& entries)
      : tail_(order.end() - tail, order.end()), unknowns_(3 * static_cast<int>(order.size())) {
    const std::vector<int> sparse(order.begin(), order.end() - tail);
    std::vector<std::set<int>> below(order.size()), right(order.size());  // nonzero rows of a column, columns of a row
    for (const auto& [row, column] : entries) below[column].insert(row), right[row].insert(column);
    auto place = [&](int row, int column) {
      return places_.insert({{row, column}, kBlock * static_cast<int>(places_.size())}).first->second;
    };
    for (int node : sparse) {
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
    for (int row : tail_)
      for (int column : tail_) tail_blocks_.push_back(place(row, column));
  }

  struct Pivot {
    int block, unknown, last_lower, last_upper, last_update;
  };
  struct OffDiagonal {
    int block, unknown;
  };
  struct Update {
    int lower, upper, target;
  };
  const std::vector<Pivot>& pivots() const { return pivots_; }
  const std::vector<OffDiagonal>& lowers() const { return lowers_; }
  const std::vector<OffDiagonal>& uppers() const { return uppers_; }
  const std::vector<Update>& updates() const { return updates_; }
  int blocks() const { return static_cast<int>(places_.size()); }
  // Where the values of a block start.
  int place(int row, int column) const { return places_.at({row, column}); }

 private:
  friend class BlockLU;
  std::vector<int> tail_, tail_blocks_;
  int unknowns_;
  std::vector<Pivot> pivots_;
  std::vector<OffDiagonal> lowers_, uppers_;
  std::vector<Update> updates_;
  std::map<Entry, int> places_;
};

class BlockLU {
 public:
  // The plan must outlive this object and must not move.
  void follow(const BlockPlan& plan) {
    plan_ = &plan;
    const size_t tail = 3 * plan.tail_.size();
    dense_.resize(static_cast<int>(tail));
    tail_vector_.assign(tail, 0.0);
    tail_scale_.assign(tail, 1.0);
    values_.assign(kBlock * plan.places_.size(), 0.0);
  }

  int unknowns() const { return plan_->unknowns_; }
  const BlockPlan& plan() const { return *plan_; }
  // The block (row, column), or nullptr if the plan has none.
  double* block(int row, int column) {
    const auto found = plan_->places_.find({row, column});
    return found == plan_->places_.end() ? nullptr : values_.data() + found->second;
  }
  void set_zero() { std::fill(values_.begin(), values_.end(), 0.0); }

  // False if a diagonal block is singular to rounding.
  bool factor() { return eliminate() && (plan_->tail_.empty() || dense_.factor(dense_.size() - deficiency_)); }

  // Scales the tail's rows and columns, so that its pivots can be told from rounding. `scale` has three entries a node.
  void scale_tail(const std::vector<double>& scale) {
    for (size_t k = 0; k < plan_->tail_.size(); ++k)
      for (int r = 0; r < 3; ++r) tail_scale_[3 * k + r] = scale[3 * plan_->tail_[k] + r];
  }

  // Counts the dependent rows of the tail: pivots below `tolerance`. False if the rest of the matrix is singular.
  bool find_deficiency(double tolerance, int& deficiency) {
    if (!eliminate()) return false;
    deficiency = plan_->tail_.empty() ? 0 : dense_.size() - dense_.rank(tolerance);
    return true;
  }
  void expect_deficiency(int deficiency) { deficiency_ = deficiency; }
  double smallest_tail_pivot() { return dense_.smallest_pivot(); }

  // The k-th vector of the null space, k < deficiency.
  void null_vector(int k, double* x) {
    std::fill(x, x + unknowns(), 0.0);
    dense_.null_vector(k, tail_vector_.data());
    scatter_tail(x);
    substitute_back(x);
  }

  void solve(double* b) {
    const double* const values = values_.data();
    const BlockPlan::OffDiagonal* const lowers = plan_->lowers_.data();
    int lower = 0;
    for (const BlockPlan::Pivot& pivot : plan_->pivots_) {
      double* const x = b + pivot.unknown;
      const Product solved = product(values + pivot.block, x);
      Eigen::Map<Eigen::Vector2d>{x} = solved.head;
      x[2] = solved.last;
      for (; lower < pivot.last_lower; ++lower) subtract(values + lowers[lower].block, x, b + lowers[lower].unknown);
    }
    if (const std::vector<int>& tail = plan_->tail_; !tail.empty()) {
      for (size_t i = 0; i < tail_vector_.size(); ++i) tail_vector_[i] = tail_scale_[i] * b[3 * tail[i / 3] + i % 3];
      dense_.solve(tail_vector_.data());
      scatter_tail(b);
    }
    substitute_back(b);
  }

 private:
  bool eliminate() {
    double* const values = values_.data();
    const BlockPlan::OffDiagonal* const uppers = plan_->uppers_.data();
    const BlockPlan::Update* const updates = plan_->updates_.data();
    int upper = 0, update = 0;
    for (const BlockPlan::Pivot& pivot : plan_->pivots_) {
      double* const diagonal = values + pivot.block;
      if (!invert_by_cofactors<kColumn>(diagonal, diagonal)) return false;
      for (; upper < pivot.last_upper; ++upper) multiply(diagonal, values + uppers[upper].block);
      for (; update < pivot.last_update; ++update)
        subtract_product(values + updates[update].lower, values + updates[update].upper,
                         values + updates[update].target);
    }
    const std::vector<int>& blocks = plan_->tail_blocks_;
    const int tail = static_cast<int>(plan_->tail_.size());
    for (int i = 0; i < 3 * tail; ++i)
      for (int j = 0; j < 3 * tail; ++j)
        dense_(i, j) =
            tail_scale_[i] * tail_scale_[j] * values[blocks[tail * (i / 3) + j / 3] + kColumn * (j % 3) + i % 3];
    return true;
  }
  void scatter_tail(double* b) const {
    const std::vector<int>& tail = plan_->tail_;
    for (size_t i = 0; i < tail_vector_.size(); ++i) b[3 * tail[i / 3] + i % 3] = tail_scale_[i] * tail_vector_[i];
  }
  void substitute_back(double* b) const {
    const double* const values = values_.data();
    const std::vector<BlockPlan::Pivot>& pivots = plan_->pivots_;
    const BlockPlan::OffDiagonal* const uppers = plan_->uppers_.data();
    int upper = static_cast<int>(plan_->uppers_.size());
    if (upper == 0) return;
    for (size_t k = pivots.size(); k-- > 0;) {
      const int first = k == 0 ? 0 : pivots[k - 1].last_upper;
      while (upper > first) {
        --upper;
        subtract(values + uppers[upper].block, b + uppers[upper].unknown, b + pivots[k].unknown);
      }
    }
  }

  // b <- a b
  static void multiply(const double* __restrict a, double* __restrict b) {
    for (int j = 0; j < kBlock; j += kColumn) {
      const Eigen::Vector4d product = column(a, b + j);
      Eigen::Map<Eigen::Vector4d>(b + j) = product;
    }
  }

  const BlockPlan* plan_ = nullptr;
  std::vector<double> values_, tail_vector_, tail_scale_;
  FullPivotLU dense_;
  int deficiency_ = 0;
};

}  // namespace lieeuler
