// The shapes of constraint rows and of their derivatives.
#pragma once

#include "model/system.hpp"

namespace lieeuler {

enum Side { kParent = 0, kChild = 1 };
inline constexpr Side kSides[2] = {kParent, kChild};
constexpr Side opposite(Side side) { return side == kChild ? kParent : kChild; }

// Three rows with respect to the quasi-velocities of one body.
struct Rows {
  Mat3 v = Mat3::Zero(), w = Mat3::Zero();
};
// A block of second derivatives: rows (v, w) of one body, columns of another.
struct Stiffness {
  Mat3 vv = Mat3::Zero(), vw = Mat3::Zero(), wv = Mat3::Zero(), ww = Mat3::Zero();
};

}  // namespace lieeuler
