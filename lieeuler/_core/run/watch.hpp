// What every run has: its interruption, such as by Ctrl-C, and no denormal numbers.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

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

// While an object of this class exists, numbers below 1e-308 count as zero. Along a chain of hundreds of bodies the
// influence of one end on the other decays through that range, where an operation takes a hundred times as long.
class FlushDenormals {
 public:
#if defined(__SSE2__)
  FlushDenormals() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | kFlushToZero | kDenormalsAreZero); }
  ~FlushDenormals() { _mm_setcsr(saved_); }

 private:
  static constexpr unsigned kFlushToZero = 0x8000, kDenormalsAreZero = 0x0040;
  unsigned saved_;
#else
  FlushDenormals() = default;
#endif
  FlushDenormals(const FlushDenormals&) = delete;
  FlushDenormals& operator=(const FlushDenormals&) = delete;
};

}  // namespace lieeuler
