// Constraint rows in world axes, as the joints give them; most eliminations of the saddle point use these.
#pragma once

#include "model/joints.hpp"
#include "model/plan.hpp"

namespace lieeuler {

class WorldRows {
 public:
  explicit WorldRows(const Plan& plan) : plan_(plan) {}

  static Vec3 own(int, const Vec3& rows) { return rows; }
  static Vec3 in_world(int, const Vec3& lam) { return lam; }
  Vec3 gamma(int k, const Constraints& joints, const std::vector<Twist>& u) const {
    return joints[plan_.parts[k].joint].gamma(plan_.part(k), u[plan_.body(k, kParent)], u[plan_.body(k, kChild)]);
  }

 protected:
  // target -= G^T values
  void subtract_reactions(const Constraints& joints, const std::vector<Vec3>& values,
                          std::vector<Twist>& target) const {
    for (int k = 0; k < plan_.count(); ++k)
      joints[plan_.parts[k].joint].subtract_reaction(plan_.part(k), values[k], target[plan_.body(k, kParent)],
                                                     target[plan_.body(k, kChild)]);
  }

  const Plan& plan_;
};

}  // namespace lieeuler
