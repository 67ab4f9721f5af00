// A method ready to run, and the units that bind functions: each is compiled by itself, and needs a minute at most.
#pragma once

#include "methods/method.hpp"
#include "model/plan.hpp"
#include "python/reduction.hpp"
#include "run/watch.hpp"

namespace lieeuler {

// A method with its steps or its tolerance, ready to run a system from a state.
struct Run {
  std::function<Outcome(const Plan&, const State& initial, const Record&, const Interrupted&)> run;
  size_t samples;
  bool monitored;
  double duration;  // s
  // The same in the coordinates of a tree's joints, for methods that can.
  std::function<Outcome(const Plan&, const State& initial, const Record&, const Interrupted&,
                        const std::vector<JointNode>&)>
      by_joints = {};
  std::vector<JointNode> nodes = {};       // of the tree; none: the bodies' coordinates
  std::vector<Reduction> reductions = {};  // from the problem to the one that is integrated, the first step first
  bool fewer_rows = false;                 // some are left out: multipliers are then those of the index-1 system
  unsigned held = 0;                       // the levels that the method holds: position 1, velocity 2, acceleration 4
  std::vector<double> t = {};              // s, of the samples
  std::optional<State> initial = {};       // of the problem that is integrated, where no other one is given

  Outcome operator()(const Plan& plan, const State& initial, const Record& record,
                     const Interrupted& interrupted) const {
    return nodes.empty() ? run(plan, initial, record, interrupted)
                         : by_joints(plan, initial, record, interrupted, nodes);
  }
};

void bind_implicit(nb::module_& module);
void bind_index1(nb::module_& module);

}  // namespace lieeuler
