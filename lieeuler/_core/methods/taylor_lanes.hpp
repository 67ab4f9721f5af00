// Data of Taylor series of several members of an ensemble at once, one to a lane: trees of bodies on ball joints under
// gravity. Code for any processor fills it (run/taylor_lanes.hpp); methods/taylor_lanes.cpp is compiled once for each
// set of instructions.
#pragma once

#include "linalg/lanes.hpp"

namespace lieeuler {

inline constexpr int kMostLaneBodies = 4, kMostLaneOrder = 40;

// What the equations of a body need, and its series (see BodySeries).
template <int width>
struct LaneBody : LaneInertia<width> {  // about the reference point
  using Number = typename Registers<width>::Number;
  bool pinned;                          // to the ground, which is then its reference point
  Triple<Number> centre, place, lever;  // from the reference point; of the pin; mass times centre
  ColumnStack<Number, 4> R[kMostLaneOrder + 3];
  Factors<Number> w[kMostLaneOrder + 3];
  Triple<Number> x[kMostLaneOrder + 3];
};

// Which body hangs on which; `base` may be the ground, whose index is the number of bodies.
template <int width>
struct LaneHinge {
  using Number = typename Registers<width>::Number;
  int body, base;
  Triple<Number> body_anchor, base_anchor;
};

// A ball joint that is no pin.
template <int width>
struct LaneJoint {
  using Number = typename Registers<width>::Number;
  int bodies[2];                      // parent and child
  Triple<Number> anchors[2];          // from the centres of mass
  Triple<Number> points[2];           // from the reference points
  ColumnStack<Number, 3> G[2], H[2];  // rows against the rotations of its bodies, and M^-1 G^T
  Triple<Number> lam[kMostLaneOrder + 3];
};

template <int width>
struct LaneGroup {
  using Number = typename Registers<width>::Number;
  int bodies, joints, hinges, order;
  double rtol;
  Number length;  // of the system
  Triple<Number> gravity;
  Number remaining;  // s, to the end of the run
  Number step;       // s; out: the step that the tolerance asks for
  typename Registers<width>::Mask
      fine;  // out: lanes that the equations here hold for; others are left to TaylorStepper
  LaneState<width> state[kMostLaneBodies + 1], sample[kMostLaneBodies + 1];  // last the ground
  LaneBody<width> body[kMostLaneBodies];
  LaneHinge<width> hinge[kMostLaneBodies];
  LaneJoint<width> joint[kMostLaneBodies];
  Number schur[3 * kMostLaneBodies][3 * kMostLaneBodies], pivot_inverse[3 * kMostLaneBodies];  // by columns
};

// The code for one set of instructions.
template <int width>
struct LaneCode {
  void (*expand)(LaneGroup<width>&);                       // the series about `state`, and `step`
  void (*evaluate)(LaneGroup<width>&, LaneState<width>*);  // at `step`
};
extern const LaneCode<4> kLanesOfAvx2;
extern const LaneCode<8> kLanesOfAvx512;

}  // namespace lieeuler
