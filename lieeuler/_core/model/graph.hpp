// The graph of bodies and joints: its elimination order, its loops, and its trees of spherical joints.
#pragma once

#include <algorithm>
#include <set>
#include <vector>

#include "model/system.hpp"

namespace lieeuler {

// An order of elimination whose next node always has the fewest neighbours left (minimum degree); pairs: (row, column).
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

// Nodes 0 .. n-1 are bodies, n + j is joint j. Leaves first along a spanning tree, a body before the joint that
// connects it to its parent.
struct EliminationOrder {
  std::vector<int> tree;   // bodies and joints
  std::vector<int> loops;  // joints
};

// The joints at each body and, as the last entry, at the ground, in the order of their indices.
inline std::vector<std::vector<int>> joints_at_bodies(const System& system) {
  std::vector<std::vector<int>> joints_at(system.n() + 1);
  for (int j = 0; j < static_cast<int>(system.joints.size()); ++j)
    joints_at[system.joints[j].parent].push_back(j), joints_at[system.joints[j].child].push_back(j);
  return joints_at;
}

// The other body of a joint.
inline int across(const Joint& joint, int body) { return joint.parent == body ? joint.child : joint.parent; }

inline EliminationOrder elimination_order(const System& system) {
  const int n = system.n(), ground = n, none = -1;
  const std::vector<std::vector<int>> joints_at = joints_at_bodies(system);

  std::vector<int> tree_joint(n + 1, none), depth(n + 1, none), visited;
  auto span = [&](int root) {
    depth[root] = 0;
    visited.push_back(root);
    for (size_t k = visited.size() - 1; k < visited.size(); ++k) {
      const int body = visited[k];
      for (int j : joints_at[body]) {
        const int other = across(system.joints[j], body);
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

// The joints of a loop: those of a shortest path between the two bodies of the one that closes it, through the tree and
// the loops closed before, and that one as the last.
using Loop = std::vector<int>;

inline std::vector<Loop> find_loops(const System& system, const EliminationOrder& order) {
  std::vector<std::vector<int>> joints_at(system.n() + 1);
  const auto accept = [&](int j) {
    joints_at[system.joints[j].parent].push_back(j), joints_at[system.joints[j].child].push_back(j);
  };
  const auto shortest_way = [&](const Joint& joint) {
    std::vector<int> by(joints_at.size(), -1), queue{joint.parent};
    Loop way;
    for (size_t k = 0; by[joint.child] < 0; ++k)
      for (int j : joints_at[queue[k]]) {
        const int other = across(system.joints[j], queue[k]);
        if (by[other] >= 0 || other == joint.parent) continue;
        by[other] = j;
        queue.push_back(other);
      }
    for (int body = joint.child; body != joint.parent; body = across(system.joints[way.back()], body))
      way.push_back(by[body]);
    return way;
  };
  for (int item : order.tree)
    if (item >= system.n()) accept(item - system.n());
  std::vector<Loop> loops;
  for (int item : order.loops) {
    const int j = item - system.n();
    loops.push_back(shortest_way(system.joints[j]));
    loops.back().push_back(j);
    accept(j);
  }
  return loops;
}

// Bodies connected by spherical parts of joints: one on the ground turns about a fixed point, and along a tree of such
// parts positions follow from attitudes.

// Anchors of two bodies that coincide. `base` comes before `body` in the list, or is the ground.
struct Hinge {
  int body, base, joint;
  Vec3 body_anchor, base_anchor;
};

class HingeTree {
 public:
  explicit HingeTree(const System& system) : hangs(system.n(), 0) {
    const std::vector<std::vector<int>> joints_at = joints_at_bodies(system);
    std::vector<char> reached(system.n() + 1, 0);
    int rows = 0;
    auto hang_from = [&](int root) {
      reached[root] = 1;
      std::vector<int> queue{root};
      for (size_t i = 0; i < queue.size(); ++i)
        for (int j : joints_at[queue[i]]) {
          const Joint& joint = system.joints[j];
          const int other = across(joint, queue[i]);
          if (!joint.parts.front().spherical || reached[other]) continue;
          const bool down = other == joint.child;
          hinges.push_back({other, queue[i], j, down ? joint.child_anchor : joint.parent_anchor,
                            down ? joint.parent_anchor : joint.child_anchor});
          reached[other] = hangs[other] = 1, rows += 3;
          queue.push_back(other);
        }
    };
    hang_from(system.n());
    for (int b = 0; b < system.n(); ++b)
      if (!reached[b]) hang_from(b);
    complete = rows == system.rows();
  }

  // Computes positions and velocities of the bodies that hang on others from the attitudes and their rates.
  void settle(State& state) const {
    for (const Hinge& hinge : hinges) {
      const Frame& base = state.frames[hinge.base];
      const Twist& above = state.u[hinge.base];
      Frame& body = state.frames[hinge.body];
      Twist& u = state.u[hinge.body];
      body.x = base.x + times(base.R, hinge.base_anchor) - times(body.R, hinge.body_anchor);
      u.v = above.v + times(base.R, above.w.cross(hinge.base_anchor)) - times(body.R, u.w.cross(hinge.body_anchor));
    }
  }

  std::vector<Hinge> hinges;
  std::vector<char> hangs;  // bodies that hang on another one or the ground
  bool complete;            // whether these are all constraints of the system
};

}  // namespace lieeuler
