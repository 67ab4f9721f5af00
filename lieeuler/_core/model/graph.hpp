// The elimination order of bodies and joints, found once per system.
#pragma once

#include <algorithm>
#include <set>
#include <vector>

#include "model/system.hpp"

namespace lieeuler {

// An order of nodes for elimination in which the next one always has the fewest neighbours left; pairs: (row, column).
inline std::vector<int> minimum_degree_order(int nodes, const std::set<std::pair<int, int>>& pairs) {
  std::vector<std::set<int>> near(nodes);
  for (const auto& [a, b] : pairs)
    if (a != b) near[a].insert(b), near[b].insert(a);
  std::set<std::pair<size_t, int>> waiting;  // by degree
  for (int node = 0; node < nodes; ++node) waiting.insert({near[node].size(), node});
  std::vector<int> order;
  while (!waiting.empty()) {
    const int node = waiting.begin()->second;
    waiting.erase(waiting.begin());
    order.push_back(node);
    for (int a : near[node]) {
      waiting.erase({near[a].size(), a});
      near[a].erase(node);
      for (int b : near[node])
        if (a != b) near[a].insert(b);
      waiting.insert({near[a].size(), a});
    }
  }
  return order;
}

// Nodes 0 .. n-1 are bodies, n + j is joint j.
//
// Leaves first along a spanning tree: a body, then the joint that ties it to its parent. That joint's diagonal block,
// zero at first, has become -G A^-1 G^T of a body free to move, so no pivot of a tree can vanish. Joints that close
// loops come last of all: only what is left of their blocks then can lack rank.
struct EliminationOrder {
  std::vector<int> tree;   // bodies and joints
  std::vector<int> loops;  // joints
};

// Whether joints close no loop.
inline bool is_forest(const System& system) {
  std::vector<int> base(system.n() + 1);  // of the bodies joined so far, one stands for all
  for (size_t b = 0; b < base.size(); ++b) base[b] = static_cast<int>(b);
  const auto root = [&](int body) {
    while (base[body] != body) body = base[body] = base[base[body]];
    return body;
  };
  for (const Joint& joint : system.joints) {
    const int parent = root(joint.parent), child = root(joint.child);
    if (parent == child) return false;
    base[child] = parent;
  }
  return true;
}

inline EliminationOrder elimination_order(const System& system) {
  const int n = system.n(), ground = n, none = -1;
  std::vector<std::vector<int>> joints_at(n + 1);
  for (size_t j = 0; j < system.joints.size(); ++j) {
    joints_at[system.joints[j].parent].push_back(static_cast<int>(j));
    joints_at[system.joints[j].child].push_back(static_cast<int>(j));
  }

  std::vector<int> tree_joint(n + 1, none), depth(n + 1, none), visited;
  auto span = [&](int root) {
    depth[root] = 0;
    visited.push_back(root);
    for (size_t k = visited.size() - 1; k < visited.size(); ++k) {
      const int body = visited[k];
      for (int j : joints_at[body]) {
        const Joint& joint = system.joints[j];
        const int other = joint.parent == body ? joint.child : joint.parent;
        if (depth[other] != none) continue;
        tree_joint[other] = j, depth[other] = depth[body] + 1;
        visited.push_back(other);
      }
    }
  };
  span(ground);
  for (int body = 0; body < n; ++body)
    if (depth[body] == none) span(body);

  EliminationOrder order;
  std::vector<char> in_tree(system.joints.size(), 0);
  for (auto body = visited.rbegin(); body != visited.rend(); ++body) {
    if (*body != ground) order.tree.push_back(*body);
    if (tree_joint[*body] == none) continue;
    order.tree.push_back(n + tree_joint[*body]);
    in_tree[tree_joint[*body]] = 1;
  }
  for (size_t j = 0; j < system.joints.size(); ++j)
    if (!in_tree[j]) order.loops.push_back(n + static_cast<int>(j));
  return order;
}

}  // namespace lieeuler
