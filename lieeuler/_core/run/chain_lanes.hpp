// Members of an ensemble side by side in the lanes of registers: fixed explicit steps of small chains of ball joints.
// All members take the same steps, so that a group runs from the start to the end together; one that needs more than
// plain steps, or fails, is left to a run by itself.
#pragma once

#include <array>

#include "methods/chain_lanes.hpp"
#include "methods/rkmk.hpp"
#include "run/lanes.hpp"

namespace lieeuler {

// A run of an explicit method that lanes may take over: counts[k] steps of steps[k] to each output time.
struct ExplicitRun {
  Tableau tableau;
  std::vector<double> steps;
  std::vector<std::int64_t> counts;
};

// Whether methods/chain_lanes.cpp has the equations of a system: chains, with one joint above and one below a body at
// most.
inline bool fits_chain(const Plan& plan) {
  const System& system = plan.system;
  if (plan.projects_by != Elimination::tree || !plan.hinges.complete || !system.forces.empty() ||
      system.n() > kMostChainBodies || system.joints.empty())
    return false;
  std::vector<int> above(system.n() + 1, 0), below(above);
  for (const Joint& joint : system.joints) ++below[joint.parent], ++above[joint.child];
  below[system.n()] = 0;
  return above[system.n()] == 0 && *std::max_element(above.begin(), above.end()) <= 1 &&
         *std::max_element(below.begin(), below.end()) <= 1;
}

template <int width>
class ChainLanes {
 public:
  ChainLanes(const ChainCode<width>& code, const Members& members, const ExplicitRun& run)
      : code_(code), members_(members), run_(run), group_(std::make_unique<ChainGroup<width>>()) {
    const auto stages = sparse(run.tableau.stages), weights = sparse({run.tableau.weights});
    group_->stages = static_cast<int>(stages.size());
    for (int i = 0; i <= group_->stages; ++i) {
      LaneTerms& out = group_->rows[i];
      for (const auto& [slope, weight] : i < group_->stages ? stages[i] : weights[0])
        out.slopes[out.count] = slope, out.weights[out.count++] = weight;
    }
  }

  void run(size_t first, size_t last, const Interrupted& stopped) {
    const FlushDenormals flush;
    for (size_t k = first; k < last;) {
      int count = 0;
      for (; k < last && count < width; ++k) {
        if (!fits_chain(members_.plan(k)))
          members_.alone(k, stopped);
        else
          lanes_[count++].member = k;
      }
      if (count > 0 && !stopped()) run_group(count, stopped);
    }
  }

 private:
  struct Lane {
    size_t member = 0;
    const Plan* plan = nullptr;
    std::optional<FixedMuntheKaas<BodyChart>> stepper;  // starts the run
    std::optional<State> state;
  };

  void run_group(int count, const Interrupted& stopped) {
    double t = 0, h = 0;
    group_->fine = typename Registers<width>::Mask{};
    for (int lane = 0; lane < count; ++lane) group_->fine[lane] = -1;
    for (size_t k = 0; k < run_.steps.size(); ++k) {
      if (run_.steps[k] != h) {
        h = run_.steps[k];
        for (int lane = 0; lane < count; ++lane)
          if (group_->fine[lane] && !start(lane, k == 0, h)) group_->fine[lane] = 0;
      }
      const double begin = t;
      for (std::int64_t i = 0; i < run_.counts[k] && any(group_->fine); ++i) {
        if (i % kStepsBetweenLooks == 0 && stopped()) return;
        code_.step(*group_, h);
        t = begin + (i + 1) * h;
      }
      for (int lane = 0; lane < count; ++lane)
        if (group_->fine[lane]) members_.record(lanes_[lane].member, static_cast<int>(k) + 1, show(lane));
    }
    Outcome outcome;
    outcome.samples = static_cast<int>(run_.steps.size()) + 1, outcome.time_reached = t;
    outcome.counters.steps = std::accumulate(run_.counts.begin(), run_.counts.end(), std::int64_t{0});
    for (int lane = 0; lane < count; ++lane) {
      if (group_->fine[lane])
        members_.end(lanes_[lane].member, outcome, width);
      else
        members_.alone(lanes_[lane].member, stopped);
    }
  }

  // Starts a member's steps, with the first size or another one; false if it has to run by itself.
  bool start(int lane, bool first, double h) {
    Lane& own = lanes_[lane];
    if (const Plan& plan = members_.plan(own.member); own.plan != &plan) {
      own.plan = &plan, own.stepper.emplace(plan, run_.tableau), own.state.emplace(plan.system);
      put(lane, plan);
    }
    const State initial = first ? members_.initial(own.member) : show(lane);
    if (own.stepper->start(initial, h) != Status::success || !is_finite(own.stepper->state())) return false;
    const State& state = own.stepper->state();
    for (int b = 0; b < group_->bodies; ++b) {
      put_lane(group_->state[b], lane, state.frames[b], state.u[b]);
      put_lane(group_->a[b].v, lane, state.a[b].v), put_lane(group_->a[b].w, lane, state.a[b].w);
    }
    if (first) members_.record(own.member, 0, state);
    return true;
  }

  void put(int lane, const Plan& plan) {
    const System& system = plan.system;
    const TreeSchur schur(plan);
    const BlockPlan& blocks = schur.elimination();
    ChainGroup<width>& group = *group_;
    group.bodies = system.n(), group.joints = plan.count(), group.pairs = static_cast<int>(schur.pairs().size());
    group.length[lane] = system.length;
    put_lane(group.trial[system.n()].R, lane, Mat3::Identity());
    for (int b = 0; b < system.n(); ++b) {
      const Body& body = system.bodies[b];
      ChainBody<width>& out = group.body[b];
      out.mass[lane] = body.mass;
      put_lane(out, lane, body, system.gravity, body.inertia_deviation, body.inertia_inverse);
    }
    for (int k = 0; k < plan.count(); ++k) {
      ChainJoint<width>& out = group.joint[k];
      out.parent = plan.body(k, kParent), out.child = plan.body(k, kChild);
      out.diagonal = blocks.place(k, k) / kBlock;
      put_lane(out.anchors[kParent], lane, plan.joint(k).parent_anchor);
      put_lane(out.anchors[kChild], lane, plan.joint(k).child_anchor);
    }
    for (const TreeSchur::End& end : schur.ends()) put_lane(group.joint[end.part].blocks[end.side], lane, end.own);
    for (int k = 0; k < group.pairs; ++k) {
      const TreeSchur::Pair& pair = schur.pairs()[k];
      const int row = schur.ends()[pair.a].part, column = schur.ends()[pair.b].part;
      group.pair[k].turn = column;
      group.pair[k].blocks[0] = blocks.place(row, column) / kBlock;
      group.pair[k].blocks[1] = blocks.place(column, row) / kBlock;
      put_lane(group.pair[k].share, lane, pair.share);
    }
    group.elimination = blocks.steps(), group.blocks = blocks.blocks();
  }

  const State& show(int lane) {
    show_lane(group_->state, lane, group_->bodies, *lanes_[lane].state);
    return *lanes_[lane].state;
  }

  const ChainCode<width>& code_;
  const Members& members_;
  const ExplicitRun& run_;
  std::unique_ptr<ChainGroup<width>> group_;
  std::array<Lane, width> lanes_;
};

}  // namespace lieeuler
