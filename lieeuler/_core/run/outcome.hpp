// How a run ended, and where its samples go.
#pragma once

#include <cmath>
#include <functional>

#include "model/system.hpp"
#include "solve/status.hpp"

namespace lieeuler {

// Largest values over all steps. energy_error is |E - E(0)| in J; the caller divides it by kinetic.
struct Maxima {
  double energy_error = 0, kinetic = 0, position = 0, velocity = 0, acceleration = 0, orthogonality = 0;
};

// A NaN counts as infinity: a plain maximum would ignore it.
inline void raise(double& maximum, double value) {
  if (!(value <= maximum)) maximum = std::isnan(value) ? std::numeric_limits<double>::infinity() : value;
}
template <class Values>
void raise(double& maximum, const Eigen::MatrixBase<Values>& values) {
  raise(maximum, values.cwiseAbs().template maxCoeff<Eigen::PropagateNaN>());
}

struct Outcome {
  Status status = Status::success;
  int samples = 0;  // filled, including the start
  int redundant_rows = 0;
  double time_reached = 0;
  Counters counters;
  Maxima maxima;
};

// Where the samples go; each call appends one.
using Record = std::function<void(int sample, const State&)>;

}  // namespace lieeuler
