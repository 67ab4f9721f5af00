// The elimination order of bodies and joints, found once per system.
#pragma once

#include <algorithm>
#include <vector>

#include "system.hpp"

namespace lieeuler {

// Nodes 0 .. n-1 are bodies, n + j is joint j.
//
// Leaves first along a spanning tree: a body, then the joint that ties it to its parent. That joint's diagonal block,
// zero at first, has become -G A^-1 G^T of a body free to move, so no pivot of a tree can vanish. A joint that closes
// a loop comes right after the topmost body of its loop: earlier its block may lack rank, later it only costs fill.
inline std::vector<int> elimination_order(const System& system) {
  const int n = system.n(), ground = n, none = -1;
  std::vector<std::vector<int>> joints_at(n + 1);
  for (size_t j = 0; j < system.joints.size(); ++j) {
    joints_at[system.joints[j].parent].push_back(static_cast<int>(j));
    joints_at[system.joints[j].child].push_back(static_cast<int>(j));
  }

  std::vector<int> up(n + 1, none), tree_joint(n + 1, none), depth(n + 1, none), visited;
  auto span = [&](int root) {
    depth[root] = 0;
    visited.push_back(root);
    for (size_t k = visited.size() - 1; k < visited.size(); ++k) {
      const int body = visited[k];
      for (int j : joints_at[body]) {
        const Joint& joint = system.joints[j];
        const int other = joint.parent == body ? joint.child : joint.parent;
        if (depth[other] != none) continue;
        up[other] = body, tree_joint[other] = j, depth[other] = depth[body] + 1;
        visited.push_back(other);
      }
    }
  };
  span(ground);
  for (int body = 0; body < n; ++body)
    if (depth[body] == none) span(body);

  std::vector<std::vector<int>> loops_topped_by(n + 1);
  for (size_t j = 0; j < system.joints.size(); ++j) {
    int a = system.joints[j].parent, b = system.joints[j].child;
    if (tree_joint[a] == static_cast<int>(j) || tree_joint[b] == static_cast<int>(j)) continue;
    while (a != b) {
      int& deeper = depth[a] >= depth[b] ? a : b;
      deeper = up[deeper];
    }
    loops_topped_by[a].push_back(static_cast<int>(j));
  }

  std::vector<int> order;
  for (auto body = visited.rbegin(); body != visited.rend(); ++body) {
    if (*body != ground) order.push_back(*body);
    for (int j : loops_topped_by[*body]) order.push_back(n + j);
    if (tree_joint[*body] != none) order.push_back(n + tree_joint[*body]);
  }
  return order;
}

}  // namespace lieeuler
