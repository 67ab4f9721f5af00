// The unknowns of a step as nodes of three, and the order in which they are eliminated.
#pragma once

#include "model/plan.hpp"

namespace lieeuler {

// Numbering of nodes. Bodies come first, each with v, w and, when doubled, xi_v, xi_w; then the multipliers of all
// parts; then, when doubled, their second set.
class Nodes {
 public:
  Nodes(const Plan& plan, bool doubled) : plan_(&plan), bodies_(plan.system.n()), doubled_(doubled) {}
  int v(int body) const { return stride() * body; }
  int w(int body) const { return v(body) + 1; }
  int xi_v(int body) const { return doubled_ ? v(body) + 2 : v(body); }
  int xi_w(int body) const { return doubled_ ? v(body) + 3 : w(body); }
  int lam(int part) const { return stride() * bodies_ + part; }
  int mu(int part) const { return doubled_ ? lam(part) + parts() : lam(part); }
  int parts() const { return plan_->count(); }
  bool doubled() const { return doubled_; }
  int count() const { return lam(0) + parts() * (doubled_ ? 2 : 1); }

  // The symbolic factorization of a matrix of these nodes. second_order: with the second derivatives of the
  // constraints.
  const BlockPlan& blocks(bool second_order) const {
    return plan_->blocks({Pattern::Matrix::step, doubled_, second_order}, [&] {
      int tail;
      const std::vector<int> nodes = order(tail);
      return BlockPlan(nodes, tail, entries(second_order));
    });
  }

 private:
  int stride() const { return doubled_ ? 4 : 2; }

  // Blocks that can be nonzero.
  std::set<BlockPlan::Entry> entries(bool second_order) const {
    std::set<BlockPlan::Entry> found;
    auto both = [&](int a, int b) { found.insert({a, b}), found.insert({b, a}); };
    if (doubled_)
      for (int b = 0; b < bodies_; ++b) found.insert({xi_v(b), v(b)}), found.insert({xi_w(b), w(b)});
    for (int k = 0; k < parts(); ++k) {
      const Joint& joint = plan_->joint(k);
      const Part& part = plan_->part(k);
      for (int body : {joint.parent, joint.child}) {
        if (body == bodies_) continue;
        both(lam(k), w(body));
        if (doubled_) both(mu(k), xi_w(body)), found.insert({lam(k), xi_w(body)});
        if (!part.translational()) continue;
        both(lam(k), v(body));
        if (doubled_) both(mu(k), xi_v(body));
        if (doubled_ && !part.spherical) found.insert({lam(k), xi_v(body)});
      }
      if (second_order) stiffness_entries(joint, part, found);
    }
    for (const PlacedMimic& mimic : plan_->mimics) {
      both(lam(mimic.follower), lam(mimic.leader));
      both(mu(mimic.follower), mu(mimic.leader));
    }
    for (const Force& force : plan_->system.forces) force_entries(force, found);
    std::erase_if(found, [](const BlockPlan::Entry& entry) { return entry.first == entry.second; });
    return found;
  }

  // Nodes in elimination order; the multipliers of joints that close loops are its last `tail`.
  std::vector<int> order(int& tail) const {
    const std::vector<std::vector<int>> parts_of = plan_->parts_of_joints();
    std::vector<int> nodes;
    auto append = [&](int item) {
      if (item < bodies_) {
        for (int node = v(item); node < v(item + 1); ++node) nodes.push_back(node);
        return;
      }
      for (int k : parts_of[item - bodies_]) nodes.push_back(lam(k));
      if (doubled_)
        for (int k : parts_of[item - bodies_]) nodes.push_back(mu(k));
    };
    for (int item : plan_->order.tree) append(item);
    tail = -static_cast<int>(nodes.size());
    for (int item : plan_->order.loops) append(item);
    tail += static_cast<int>(nodes.size());
    return nodes;
  }

  void stiffness_entries(const Joint& joint, const Part& part, std::set<BlockPlan::Entry>& found) const {
    for (int row : {joint.parent, joint.child})
      for (int column : {joint.parent, joint.child}) {
        if (row == bodies_ || column == bodies_) continue;
        if (part.spherical && row != column) continue;  // an anchor's stiffness acts on its own body only
        found.insert({w(row), xi_w(column)});
        if (part.spherical || !part.translational()) continue;
        found.insert({v(row), xi_v(column)}), found.insert({v(row), xi_w(column)}),
            found.insert({w(row), xi_v(column)});
      }
  }

  // Every node of one side with every node of the other: springs depend on q, dampers on u.
  void force_entries(const Force& force, std::set<BlockPlan::Entry>& found) const {
    for (int row : {force.parent, force.child})
      for (int column : {force.parent, force.child}) {
        if (row == bodies_ || column == bodies_) continue;
        for (int i : {v(row), w(row)})
          for (int j : {v(column), w(column), xi_v(column), xi_w(column)}) found.insert({i, j});
      }
  }

  const Plan* plan_;
  int bodies_;
  bool doubled_;
};

// Blocks of the force on one body against the position or velocity of another.
struct PairBlocks {
  double *vv = nullptr, *vw = nullptr, *wv = nullptr, *ww = nullptr;

  static PairBlocks of(BlockLU& lu, int v, int w, int column_v, int column_w) {
    return {lu.block(v, column_v), lu.block(v, column_w), lu.block(w, column_v), lu.block(w, column_w)};
  }
  // Adds factor times K, its rotational columns times T.
  void add(double factor, const Stiffness& K, const Mat3& T) const {
    if (ww) lieeuler::add(ww, factor * K.ww * T);
    if (vv) lieeuler::add(vv, factor * K.vv);
    if (vw) lieeuler::add(vw, factor * K.vw * T);
    if (wv) lieeuler::add(wv, factor * K.wv);
  }
};

// Blocks of one side of a part: its rows and the body's columns, and the body's rows and its columns. A block that is
// zero by structure is nullptr.
struct SideBlocks {
  double *row_v = nullptr, *row_w = nullptr, *column_v = nullptr, *column_w = nullptr;

  static SideBlocks of(BlockLU& lu, int part, int v, int w) {
    return {lu.block(part, v), lu.block(part, w), lu.block(v, part), lu.block(w, part)};
  }
  void put_rows(const Mat3& v, const Mat3& w) const {
    if (row_v) put(row_v, v);
    if (row_w) put(row_w, w);
  }
  void put_columns(const Rows& G) const {  // G^T
    if (column_v) put(column_v, G.v.transpose());
    if (column_w) put(column_w, G.w.transpose());
  }
};

}  // namespace lieeuler
