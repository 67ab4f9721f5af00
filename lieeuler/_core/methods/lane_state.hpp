// What the methods with lanes hold of bodies, one system to a lane.
#pragma once

#include "linalg/lanes.hpp"

namespace lieeuler {

template <int width>
struct LaneTwist {
  using Number = typename Registers<width>::Number;
  Triple<Number> v, w;
};
// The configuration and motion of a body.
template <int width>
struct LaneState {
  using Number = typename Registers<width>::Number;
  ColumnStack<Number, 3> R;
  Triple<Number> x;
  LaneTwist<width> u;
};
// What never changes of it.
template <int width>
struct LaneInertia {
  using Number = typename Registers<width>::Number;
  Number mass_inverse;
  Triple<Number> weight, spin;  // mass times gravity
  ColumnStack<Number, 3> deviation, inertia_inverse;
};

}  // namespace lieeuler
