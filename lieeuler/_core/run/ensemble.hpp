// Many runs of one method from different states: on threads, and in lanes where these fit.
#pragma once

#include "run/lanes.hpp"

namespace lieeuler {

// A method with its steps or its tolerance, ready to run a system from a state.
struct Run {
  std::function<Outcome(const Plan&, const State& initial, const Record&, const Interrupted&)> run;
  size_t samples;
  double begin = 0;  // s, the time of the initial state
  std::optional<TaylorRun> in_lanes = {};
};

// Runs members 0 ... count - 1; whether it was interrupted. lanes: one of lane_sets().
inline bool run_members(size_t count, const Members& members, const Run& run, [[maybe_unused]] const std::string& lanes,
                        int threads, const Interrupted& interrupted) {
#if defined(LIEEULER_LANES_X86)
  const auto blocks = [&](const auto& code) {
    return run_blocks(code, count, members, *run.in_lanes, run.begin, threads, interrupted);
  };
  if (run.in_lanes && lanes == "avx512") return blocks(kLanesOfAvx512);
  if (run.in_lanes && lanes == "avx2") return blocks(kLanesOfAvx2);
#endif
  return on_threads(count, threads, interrupted, members.alone);
}

}  // namespace lieeuler
