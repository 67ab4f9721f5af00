// Whether somebody wants a run to end.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>

#include "model/system.hpp"

namespace lieeuler {

// Asked now and then; true ends the run.
using Interrupted = std::function<bool()>;

// Asks about an interruption every 50 ms of the run, whatever a step costs.
class Watch {
 public:
  // Of steps as cheap as a microsecond a body the clock is read every so many only, where reading it would be felt.
  Watch(const Interrupted& interrupted, const System& system)
      : interrupted_(interrupted), steps_between_readings_(std::max(1, kCheap / parts(system))) {}

  // Once a step, or whatever takes as long.
  bool ends() {
    if (++steps_ < steps_between_readings_) return false;
    steps_ = 0;
    const auto now = std::chrono::steady_clock::now();
    if (now - asked_ < kPeriod) return false;
    asked_ = now;
    return interrupted_();
  }

 private:
  static constexpr std::chrono::milliseconds kPeriod{50};
  static constexpr int kCheap = 50;
  static int parts(const System& system) {
    return static_cast<int>(system.bodies.size() + system.joints.size() + system.forces.size());
  }

  const Interrupted& interrupted_;
  const int steps_between_readings_;
  int steps_ = 0;
  std::chrono::steady_clock::time_point asked_ = std::chrono::steady_clock::now();
};

}  // namespace lieeuler
