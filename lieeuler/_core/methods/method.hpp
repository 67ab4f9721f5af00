// What tells one method from another of its family.
#pragma once

#include <optional>
#include <vector>

#include "model/so3.hpp"

namespace lieeuler {

// The constraint equations of a step; stabilised: position and velocity.
enum class Level { position, velocity, stabilised, acceleration };

// Of Baumgarte's feedback.
struct Gains {
  double alpha = 0, beta = 0;  // 1/s
};

// The weight of G_n^T mu in xi when stabilised: M^-1, or none.
enum class Correction { mass, plain };

enum class Formulation { lagrange, hamilton };

// A method that factors one matrix a step.
struct Method {
  Formulation formulation;
  Level level;
  bool index1_output;  // (a, lam) from the index-1 system at the new state
  Gains gains = {};
  std::vector<double> composition = {};        // weights of a composition of RATTLE; empty: the method itself
  std::optional<double> spectral_radius = {};  // of generalized-alpha, in place of implicit Euler
  bool polish = true;  // make attitudes rotations again after every step; only Euler methods allow false
  Correction correction = Correction::mass;
};

// The coefficients of lieeuler/tableaux.py.
struct Tableau {
  std::vector<std::vector<double>> stages;
  std::vector<double> weights;
  int order;
  std::vector<std::vector<double>> errors, extra, dense;
};

// A node of a tree in the coordinates of its joints; parents come first.
struct JointNode {
  enum class Kind { hinge, slide, ball } kind;
  int parent;       // node; -1: the ground
  int joint;        // that it belongs to
  bool last;        // whether it carries the child of the joint, or a link without mass
  Mat3 turn;        // attitude of its link relative to the parent's where its angle is zero; not of a ball
  Vec3 axis;        // of a hinge in its link, of a slide in the parent's link
  double armature;  // kg m^2 or kg
};

}  // namespace lieeuler
