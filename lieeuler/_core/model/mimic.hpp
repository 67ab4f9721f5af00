// Coordinates that follow others: the row of both, (19.1) of docs/theory.md, and the two of (19.2) in its place.
#pragma once

#include <numbers>

#include "model/forces.hpp"
#include "model/plan.hpp"

namespace lieeuler {

// follower - ratio leader - offset, rad or m; `angles`, those of the forces, unwrap that of the leader.
// Cold, as few systems have mimics: inlined it would slow the loops of all others.
[[gnu::noinline, gnu::cold]] inline double gap(const Plan& plan, const PlacedMimic& mimic, const Constraints& joints,
                                               const std::vector<double>& angles) {
  const auto wrapped = [](double angle) { return std::remainder(angle, 2 * std::numbers::pi); };
  const auto coordinate = [&](int k) { return joints[plan.parts[k]].position(plan.part(k))[0]; };
  double leader = coordinate(mimic.leader);
  if (mimic.angle >= 0) leader = angles[mimic.angle] + wrapped(leader - angles[mimic.angle]);
  const double found = coordinate(mimic.follower) - mimic.ratio * leader - mimic.offset;
  return mimic.turns ? wrapped(found) : found;
}

// Its rate for the velocities u.
inline double mimic_rate(const Plan& plan, const PlacedMimic& mimic, const Constraints& joints,
                         const std::vector<Twist>& u) {
  const auto rate = [&](int k) { return joints.velocity(plan.parts[k], u)[0]; };
  return rate(mimic.follower) - mimic.ratio * rate(mimic.leader);
}

// Combines the rows of followers and leaders, three values a part, in the follower's place.
inline void combine(const Plan& plan, double* rows) {
  for (const PlacedMimic& mimic : plan.mimics) {
    double* const leader = rows + 3 * mimic.leader;
    rows[3 * mimic.follower] -= mimic.ratio * leader[0];
    leader[0] = leader[1] = leader[2] = 0;
  }
}

// Blocks of a follower and a leader in a matrix that contains [M G^T; G 0].
struct MimicBlocks {
  double ratio;
  double *across, *back, *own;  // (follower, leader), (leader, follower), (leader, leader)

  template <class BlockOf>
  MimicBlocks(const PlacedMimic& mimic, const BlockOf& block)
      : ratio(mimic.ratio),
        across(block(mimic.follower, mimic.leader)),
        back(block(mimic.leader, mimic.follower)),
        own(block(mimic.leader, mimic.leader)) {}

  void put() const {
    across[kColumn] = back[1] = -ratio;
    own[kColumn] = own[1] = -1, own[kColumn + 1] = 0;
  }
};

}  // namespace lieeuler
