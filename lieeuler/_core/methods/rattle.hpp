// Symmetric compositions of RATTLE (docs/theory.md, section 9): successive steps of weights[0] h, weights[1] h, ...
#pragma once

#include "methods/euler_hamilton.hpp"

namespace lieeuler {

template <class Map>
class CompositionStepper : public HamiltonStepper<Map> {
  using Rattle = HamiltonStepper<Map>;

 public:
  CompositionStepper(const Plan& plan, std::vector<double> weights)
      : Rattle(plan, Level::stabilised, true, HamiltonEquations<Map>::Kind::rattle),
        weights_(std::move(weights)),
        predictors_(weights_.size()) {}

  Status start(const State& state, double h) {
    whole_step_ = h;
    const Status status = Rattle::start(state, h);
    // Each stage is guessed from the same stage of earlier steps: from one stage to the next nothing is smooth.
    for (Predictor& predictor : predictors_) predictor.reset(this->unknowns());
    return status;
  }

  Status step(Counters& counters) {
    for (size_t i = 0; i < weights_.size(); ++i) {
      this->equations_.at.index1_output = i + 1 == weights_.size();  // (a, lam) only at the end of the step
      const Status status = this->advance(weights_[i] * whole_step_, predictors_[i], counters);
      if (status != Status::success) return status;
    }
    ++counters.steps;
    return Status::success;
  }

 private:
  std::vector<double> weights_;
  std::vector<Predictor> predictors_;
  double whole_step_ = 0;
};

}  // namespace lieeuler
