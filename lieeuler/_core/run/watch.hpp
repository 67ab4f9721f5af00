// Interruption of a run, such as by Ctrl-C.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>

#include "model/system.hpp"

namespace lieeuler {

// Called from time to time; true ends the run.
using Interrupted = std::function<bool()>;

// Checks for an interruption every 50 ms of the run, however long a step takes.
class Watch {
 public:
  // A step may take as little as a microsecond a body: small systems read the clock only every few steps, to save time.
  Watch(const Interrupted& interrupted, const System& system)
      : interrupted_(interrupted), steps_between_readings_(std::max(1, kCheap / parts(system))) {}

  // Call once a step, or as often as that takes.
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
