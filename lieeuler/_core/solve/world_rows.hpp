// What several eliminations of the saddle point share: constraint rows in world axes, as the joints give them, and rows
// that never depend on others.
#pragma once

#include "model/joints.hpp"
#include "model/plan.hpp"

namespace lieeuler {

// What eliminations of trees have in common: no row depends on others.
struct FullRank {
  static bool count_redundancy(const Constraints&, int& redundant) {
    redundant = 0;
    return true;
  }
  static int redundant() { return 0; }
};

class WorldRows {
 public:
  explicit WorldRows(const Plan& plan) : plan_(plan) {}

  static Vec3 own(int, const Vec3& rows) { return rows; }
  static Vec3 in_world(int, const Vec3& lam) { return lam; }
  Vec3 gamma(int k, const Constraints& joints, const std::vector<Twist>& u) const {
    return joints.gamma(plan_.parts[k], u);
  }

 protected:
  const Plan& plan_;
};

}  // namespace lieeuler
