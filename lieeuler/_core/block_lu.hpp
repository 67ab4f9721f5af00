// Sparse LU over the graph of bodies and joints, in blocks.
//
// Nodes are bodies and joints; a joint is tied to its bodies, and two bodies to each other where a joint or a force
// makes the force on one depend on the position of the other. The order is chosen once (graph.hpp); a tree then has no
// fill and a factorization costs O(n).
#pragma once

#include <algorithm>
#include <cstring>
#include <array>
#include <map>
#include <set>
#include <vector>

#include "dense.hpp"
#include "graph.hpp"
#include "system.hpp"

namespace lieeuler {

class BlockLU {
 public:
  // Plans the elimination: body nodes of `body_size` unknowns, joint nodes of `joint_factor` times their rows.
  void plan(const System& system, int body_size, int joint_factor) {
    const int n = system.n();
    std::vector<std::set<int>> neighbours(n + system.joints.size());
    sizes_.assign(n, body_size);
    auto connect = [&](int a, int b) { neighbours[a].insert(b), neighbours[b].insert(a); };
    for (size_t j = 0; j < system.joints.size(); ++j) {
      const Joint& joint = system.joints[j];
      const int node = n + static_cast<int>(j);
      sizes_.push_back(joint_factor * joint.rows());
      connect(node, joint.child);
      if (joint.parent < n) {
        connect(node, joint.parent);
        if (!joint.dots.empty()) connect(joint.parent, joint.child);
      }
    }
    eliminate(elimination_order(system), neighbours);
    layout();
  }

  int unknowns() const { return offsets_.back(); }
  int offset(int node) const { return offsets_[node]; }
  double* block(int row, int column) { return values_.data() + positions_.at({row, column}); }
  void set_zero() { std::fill(values_.begin(), values_.end(), 0.0); }

  bool factor() {
    for (const Pivot& pivot : pivots_) {
      double* diagonal = values_.data() + pivot.diagonal;
      if (!pivot.factor(pivot.size, diagonal, rows_.data() + pivot.offset)) return false;
      for (int k = pivot.first_solve; k < pivot.last_solve; ++k) {
        const Row& row = solves_[k];
        row.solve(pivot.size, row.columns, diagonal, rows_.data() + pivot.offset, values_.data() + row.upper);
      }
      for (int k = pivot.first_update; k < pivot.last_update; ++k) {
        const Update& u = updates_[k];
        u.product(u.rows, pivot.size, u.columns, values_.data() + u.lower, values_.data() + u.upper,
                  values_.data() + u.target);
      }
    }
    return true;
  }

  void solve(double* b) const {
    for (const Pivot& pivot : pivots_) {
      pivot.solve(pivot.size, 1, values_.data() + pivot.diagonal, rows_.data() + pivot.offset, b + pivot.offset);
      for (int k = pivot.first_solve; k < pivot.last_solve; ++k) {
        const Row& row = solves_[k];
        row.forward(row.columns, pivot.size, 1, values_.data() + row.lower, b + pivot.offset, b + row.offset);
      }
    }
    for (auto pivot = pivots_.rbegin(); pivot != pivots_.rend(); ++pivot)
      for (int k = pivot->first_solve; k < pivot->last_solve; ++k) {
        const Row& row = solves_[k];
        row.backward(pivot->size, row.columns, 1, values_.data() + row.upper, b + row.offset, b + pivot->offset);
      }
  }

 private:
  struct Pivot {
    dense::Factor factor;
    dense::Solve solve;
    int size, offset, diagonal, first_solve, last_solve, first_update, last_update;
  };
  struct Row {  // one later neighbour of a pivot
    dense::Solve solve;
    dense::SubtractProduct forward, backward;
    int columns, offset, upper, lower;
  };
  struct Update {
    dense::SubtractProduct product;
    int rows, columns, lower, upper, target;
  };

  // Follows the elimination through the graph, adding the fill to `neighbours`.
  void eliminate(const std::vector<int>& order, std::vector<std::set<int>>& neighbours) {
    later_.clear();
    for (int v : order) {
      std::vector<int> rest(neighbours[v].begin(), neighbours[v].end());
      for (int a : rest) {
        neighbours[a].erase(v);
        for (int b : rest)
          if (b != a) neighbours[a].insert(b);
      }
      later_.push_back({v, std::move(rest)});
    }
  }

  void layout() {
    offsets_.assign(1, 0);
    for (int size : sizes_) offsets_.push_back(offsets_.back() + size);
    positions_.clear();
    pivots_.clear(), solves_.clear(), updates_.clear();
    int used = 0;
    auto place = [&](int row, int column) {
      const auto [entry, added] = positions_.insert({{row, column}, used});
      if (added) used += sizes_[row] * sizes_[column];
      return entry->second;
    };
    for (const auto& [v, rest] : later_) {
      Pivot pivot{dense::pick_factor(sizes_[v]), dense::pick_solve(sizes_[v], 1), sizes_[v], offsets_[v], place(v, v),
                  static_cast<int>(solves_.size()), 0, static_cast<int>(updates_.size()), 0};
      for (int a : rest) {
        solves_.push_back({dense::pick_solve(sizes_[v], sizes_[a]), dense::pick_product(sizes_[a], sizes_[v], 1),
                           dense::pick_product(sizes_[v], sizes_[a], 1), sizes_[a], offsets_[a], place(v, a),
                           place(a, v)});
        for (int b : rest)
          updates_.push_back({dense::pick_product(sizes_[a], sizes_[v], sizes_[b]), sizes_[a], sizes_[b], place(a, v),
                              place(v, b), place(a, b)});
      }
      pivot.last_solve = static_cast<int>(solves_.size());
      pivot.last_update = static_cast<int>(updates_.size());
      pivots_.push_back(pivot);
    }
    values_.assign(used, 0.0);
    rows_.assign(offsets_.back(), 0);
  }

  std::vector<int> sizes_, offsets_;
  std::vector<std::pair<int, std::vector<int>>> later_;  // in elimination order: node, neighbours eliminated later
  std::map<std::pair<int, int>, int> positions_;
  std::vector<Pivot> pivots_;
  std::vector<Row> solves_;
  std::vector<Update> updates_;
  std::vector<double> values_;
  std::vector<int> rows_;  // row exchanges inside each diagonal block
};

}  // namespace lieeuler
