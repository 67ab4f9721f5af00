// Sparse LU in blocks of 3 x 3, a list of operations planned once. The last nodes, the
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

// The inverse by cofactors of a matrix whose rows (or columns) are `stride` apart, and whether it exists: their volume
// is not rounding compared with the product of their lengths.
template <int stride>
[[gnu::always_inline]] inline bool invert_by_cofactors(const double* a, double* out) {
  constexpr double kSingular = 1e-14;
  const double *b = a + stride, *c = b + stride;
  const double a0 = a[0], a1 = a[1], a2 = a[2], b0 = b[0], b1 = b[1], b2 = b[2], c0 = c[0], c1 = c[1], c2 = c[2];
  const double m00 = b1 * c2 - b2 * c1, m01 = b2 * c0 - b0 * c2, m02 = b0 * c1 - b1 * c0;
  const double volume = a0 * m00 + a1 * m01 + a2 * m02;
  const double lengths = (a0 * a0 + a1 * a1 + a2 * a2) * (b0 * b0 + b1 * b1 + b2 * b2) * (c0 * c0 + c1 * c1 + c2 * c2);
  const double inverse = 1 / volume;
  double *p = out + stride, *q = p + stride;
  out[0] = inverse * m00, p[0] = inverse * m01, q[0] = inverse * m02;
  out[1] = inverse * (a2 * c1 - a1 * c2), p[1] = inverse * (a0 * c2 - a2 * c0), q[1] = inverse * (a1 * c0 - a0 * c1);
  out[2] = inverse * (a1 * b2 - a2 * b1), p[2] = inverse * (a2 * b0 - a0 * b2), q[2] = inverse * (a0 * b1 - a1 * b0);
  return volume * volume > kSingular * kSingular * lengths;
}

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
[[gnu::noinline]] inline void subtract_product(const double* __restrict a, const double* __restrict b,
                                               double* __restrict c) {
  for (int j = 0; j < kBlock; j += kColumn) Eigen::Map<Eigen::Vector4d>(c + j) -= column(a, b + j);
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

 private:
  friend class BlockLU;
  // Places of blocks among the values, and of unknowns; the first operations that belong to the next pivot.
  struct Pivot {
    int block, unknown, last_lower, last_upper, last_update;
  };
  struct OffDiagonal {
    int block, unknown;
  };
  struct Update {
    int lower, upper, target;
  };
  // What a factorization reads. It is copied: stores to the values might change others, as far as the compiler knows.
  struct Steps {
    int count = 0;
    const Pivot* pivots = nullptr;
    const OffDiagonal *lowers = nullptr, *uppers = nullptr;
    const Update* updates = nullptr;
  };

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
    steps_ = {static_cast<int>(plan.pivots_.size()), plan.pivots_.data(), plan.lowers_.data(), plan.uppers_.data(),
              plan.updates_.data()};
    const size_t tail = 3 * plan.tail_.size();
    dense_.resize(static_cast<int>(tail));
    tail_vector_.assign(tail, 0.0);
    tail_scale_.assign(tail, 1.0);
    values_.assign(kBlock * plan.places_.size(), 0.0);
  }

  int unknowns() const { return plan_->unknowns_; }
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

  // The same of a matrix that is all tail, by the matrix itself: the largest entries of all rows become of order one.
  void equilibrate_tail() {
    constexpr int kPasses = 6;  // each halves the decades that the largest entries of rows span
    std::fill(tail_scale_.begin(), tail_scale_.end(), 1.0);
    for (int pass = 0; pass < kPasses; ++pass) {
      copy_tail();
      for (int i = 0; i < dense_.size(); ++i) {
        double largest = 0;
        for (int j = 0; j < dense_.size(); ++j) largest = std::max(largest, std::abs(dense_(i, j)));
        if (largest > 0) tail_scale_[i] /= std::sqrt(largest);
      }
    }
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
    substitute_forward(b);
    if (const std::vector<int>& tail = plan_->tail_; !tail.empty()) {
      for (size_t i = 0; i < tail_vector_.size(); ++i) tail_vector_[i] = tail_scale_[i] * b[3 * tail[i / 3] + i % 3];
      dense_.solve(tail_vector_.data());
      scatter_tail(b);
    }
    substitute_back(b);
  }

 private:
  // a b in place of b.
  [[gnu::always_inline]] static void multiply(const double* a, double* __restrict b) {
    for (int j = 0; j < kBlock; j += kColumn) {
      const Eigen::Vector4d product = column(a, b + j);
      Eigen::Map<Eigen::Vector4d>(b + j) = product;
    }
  }
  bool eliminate() {
    const BlockPlan::Steps steps = steps_;
    double* const values = values_.data();
    int upper = 0, update = 0;
    for (int k = 0; k < steps.count; ++k) {
      const BlockPlan::Pivot& pivot = steps.pivots[k];
      double* const inverse = values + pivot.block;
      if (!invert_by_cofactors<kColumn>(inverse, inverse)) return false;
      for (; upper < pivot.last_upper; ++upper) multiply(inverse, values + steps.uppers[upper].block);
      for (; update < pivot.last_update; ++update) {
        const BlockPlan::Update& each = steps.updates[update];
        subtract_product(values + each.lower, values + each.upper, values + each.target);
      }
    }
    copy_tail();
    return true;
  }
  void substitute_forward(double* b) const {
    const BlockPlan::Steps steps = steps_;
    const double* const values = values_.data();
    int lower = 0;
    for (int k = 0; k < steps.count; ++k) {
      const BlockPlan::Pivot& pivot = steps.pivots[k];
      double* const x = b + pivot.unknown;
      const Product solved = product(values + pivot.block, x);
      Eigen::Map<Eigen::Vector2d>{x} = solved.head;
      x[2] = solved.last;
      for (; lower < pivot.last_lower; ++lower)
        subtract(values + steps.lowers[lower].block, x, b + steps.lowers[lower].unknown);
    }
  }
  void substitute_back(double* b) const {
    const BlockPlan::Steps steps = steps_;
    const double* const values = values_.data();
    for (int k = steps.count; k-- > 0;) {
      const int first = k == 0 ? 0 : steps.pivots[k - 1].last_upper;
      for (int upper = steps.pivots[k].last_upper; upper-- > first;)
        subtract(values + steps.uppers[upper].block, b + steps.uppers[upper].unknown, b + steps.pivots[k].unknown);
    }
  }
  void copy_tail() {
    const std::vector<int>& blocks = plan_->tail_blocks_;
    const int tail = static_cast<int>(plan_->tail_.size());
    for (int i = 0; i < 3 * tail; ++i)
      for (int j = 0; j < 3 * tail; ++j)
        dense_(i, j) =
            tail_scale_[i] * tail_scale_[j] * values_[blocks[tail * (i / 3) + j / 3] + kColumn * (j % 3) + i % 3];
  }
  void scatter_tail(double* b) const {
    const std::vector<int>& tail = plan_->tail_;
    for (size_t i = 0; i < tail_vector_.size(); ++i) b[3 * tail[i / 3] + i % 3] = tail_scale_[i] * tail_vector_[i];
  }

  const BlockPlan* plan_ = nullptr;
  BlockPlan::Steps steps_;
  std::vector<double> values_, tail_vector_, tail_scale_;
  FullPivotLU dense_;
  int deficiency_ = 0;
};

}  // namespace lieeuler
