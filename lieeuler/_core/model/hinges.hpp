// Bodies connected by spherical parts of joints: one on the ground turns about a fixed point, and along a tree of such
// parts positions follow from attitudes.
#pragma once

#include "model/graph.hpp"

namespace lieeuler {

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
