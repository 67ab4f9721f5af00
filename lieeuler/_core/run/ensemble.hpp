// Many runs of one method from different states: on threads, and in lanes where these fit.
#pragma once

#include <variant>

#include "run/chain_lanes.hpp"
#include "run/taylor_lanes.hpp"

namespace lieeuler {

// A method with its steps or its tolerance, ready to run a system from a state.
struct Run {
  std::function<Outcome(const Plan&, const State& initial, const Record&, const Interrupted&)> run;
  size_t samples;
  bool monitored;
  double duration;   // s
  double begin = 0;  // s, the time of the initial state
  std::variant<std::monostate, TaylorRun, ExplicitRun> in_lanes = {};
  // The same in the coordinates of a tree's joints, for methods that can.
  std::function<Outcome(const Plan&, const State& initial, const Record&, const Interrupted&,
                        const std::vector<JointNode>&)>
      by_joints = {};
  std::vector<JointNode> nodes = {};  // of the tree; none: the bodies' coordinates

  Outcome operator()(const Plan& plan, const State& initial, const Record& record,
                     const Interrupted& interrupted) const {
    return nodes.empty() ? run(plan, initial, record, interrupted)
                         : by_joints(plan, initial, record, interrupted, nodes);
  }
};

#if defined(LIEEULER_LANES_X86)
template <int width>
bool run_in_lanes(const LaneCode<width>& taylor, const ChainCode<width>& chains, size_t count, const Members& members,
                  const Run& run, int threads, const Interrupted& interrupted) {
  return run_blocks(width, count, threads, interrupted, [&](size_t first, size_t last, const Interrupted& stopped) {
    if (const auto* series = std::get_if<TaylorRun>(&run.in_lanes))
      return TaylorLanes<width>(taylor, members, *series, run.begin).run(first, last, stopped);
    ChainLanes<width>(chains, members, std::get<ExplicitRun>(run.in_lanes)).run(first, last, stopped);
  });
}
#endif

// Runs members 0 ... count - 1; whether it was interrupted. lanes: one of lane_sets().
inline bool run_members(size_t count, const Members& members, const Run& run, [[maybe_unused]] const std::string& lanes,
                        int threads, const Interrupted& interrupted) {
#if defined(LIEEULER_LANES_X86)
  const bool fits = run.in_lanes.index() > 0;
  if (fits && lanes == "avx512")
    return run_in_lanes(kLanesOfAvx512, kChainsOfAvx512, count, members, run, threads, interrupted);
  if (fits && lanes == "avx2")
    return run_in_lanes(kLanesOfAvx2, kChainsOfAvx2, count, members, run, threads, interrupted);
#endif
  return on_threads(count, threads, interrupted, members.alone);
}

}  // namespace lieeuler
