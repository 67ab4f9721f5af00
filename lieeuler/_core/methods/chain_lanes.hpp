// Data of explicit Runge-Kutta-Munthe-Kaas steps of several members of an ensemble at once, one to a lane: chains of
// bodies on ball joints under gravity. Code for any processor fills it (run/chain_lanes.hpp);
// methods/chain_lanes.cpp is compiled once for each set of instructions.
#pragma once

#include "linalg/elimination.hpp"
#include "linalg/lanes.hpp"

namespace lieeuler {

inline constexpr int kMostChainBodies = 4, kMostSlopes = 17;

template <int width>
struct ChainBody : LaneInertia<width> {
  typename Registers<width>::Number mass;
};
// A ball joint; the parent may be the ground, whose index is the number of bodies. The rest as in TreeSchur: the blocks
// of S of its two ends, that of the parent without its turn.
template <int width>
struct ChainJoint {
  using Number = typename Registers<width>::Number;
  int parent, child, diagonal;
  Triple<Number> anchors[2];         // parent, child
  ColumnStack<Number, 3> blocks[2];  // of the ends
};
// Two joints on one body, the child of the first and the parent of the second.
template <int width>
struct ChainPair {
  int turn, blocks[2];  // the second joint; the places of their block and of its transpose
  ColumnStack<typename Registers<width>::Number, 3> share;
};

// The nonzero coefficients of a row of the tableau.
struct LaneTerms {
  int count, slopes[kMostSlopes];
  double weights[kMostSlopes];
};

template <int width>
struct ChainGroup {
  using Number = typename Registers<width>::Number;
  using Matrix = ColumnStack<Number, 3>;
  int bodies, joints, pairs, stages;
  LaneTerms rows[kMostSlopes];  // of the stages, and the weights
  BlockSteps elimination;       // of the plan of one member: all have the same structure
  int blocks;
  ChainBody<width> body[kMostChainBodies];
  ChainJoint<width> joint[kMostChainBodies];
  ChainPair<width> pair[kMostChainBodies];
  Number length;                         // of the system
  typename Registers<width>::Mask fine;  // lanes that the equations here hold for; others run by themselves
  LaneState<width> state[kMostChainBodies + 1], trial[kMostChainBodies + 1];  // last the ground
  LaneTwist<width> a[kMostChainBodies];
  Triple<Number> slopes[kMostSlopes][kMostChainBodies][4];  // of x, theta, v, w
  Matrix block[kMostChainBodies * kMostChainBodies], axes[kMostChainBodies], turns[kMostChainBodies];
};

// The code for one set of instructions: a step of size h from `state` and `a`.
template <int width>
struct ChainCode {
  void (*step)(ChainGroup<width>&, double h);
};
extern const ChainCode<4> kChainsOfAvx2;
extern const ChainCode<8> kChainsOfAvx512;

}  // namespace lieeuler
