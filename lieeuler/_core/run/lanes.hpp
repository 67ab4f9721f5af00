// Members of an ensemble, and how they share registers (docs/theory.md, section 12): what methods with lanes share.
#pragma once

#include <string>

#include "linalg/lanes.hpp"
#include "run/loop.hpp"
#include "run/threads.hpp"

namespace lieeuler {

// Members by their index, all of the same structure. end: how one ended, in how many lanes; alone: runs one by itself.
struct Members {
  std::function<const Plan&(size_t)> plan;
  std::function<State(size_t)> initial;
  std::function<void(size_t, int sample, const State&)> record;
  std::function<void(size_t, const Outcome&, int lanes)> end;
  std::function<void(size_t, const Interrupted&)> alone;
};

template <class Number>
void put_lane(Triple<Number>& out, int lane, const Vec3& values) {
  for (int i = 0; i < 3; ++i) out.part[i][lane] = values[i];
}
template <class Number>
void put_lane(ColumnStack<Number, 3>& out, int lane, const Mat3& values) {
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < 3; ++i) out.part[c][i][lane] = values(i, c);
}
template <int width>
void put_lane(LaneState<width>& out, int lane, const Frame& frame, const Twist& u) {
  put_lane(out.R, lane, frame.R), put_lane(out.x, lane, frame.x);
  put_lane(out.u.v, lane, u.v), put_lane(out.u.w, lane, u.w);
}
template <int width>
void put_lane(LaneInertia<width>& out, int lane, const Body& body, const Vec3& gravity, const Mat3& deviation,
              const Mat3& inertia_inverse) {
  out.mass_inverse[lane] = 1 / body.mass;
  put_lane(out.weight, lane, body.mass * gravity), put_lane(out.spin, lane, body.spin);
  put_lane(out.deviation, lane, deviation), put_lane(out.inertia_inverse, lane, inertia_inverse);
}
// Writes the bodies of one lane to a system's state.
template <int width>
void show_lane(const LaneState<width>* from, int lane, int bodies, State& out) {
  for (int b = 0; b < bodies; ++b)
    for (int i = 0; i < 3; ++i) {
      out.frames[b].x[i] = from[b].x[i][lane];
      out.u[b].v[i] = from[b].u.v[i][lane], out.u[b].w[i] = from[b].u.w[i][lane];
      for (int c = 0; c < 3; ++c) out.frames[b].R(i, c) = from[b].R.part[c][i][lane];
    }
}

// The sets of instructions that this processor has code for, best first; "none": each member by itself. Two lanes, as
// any x86-64 or ARM processor has, gain nothing: one system fills them too.
inline std::vector<std::string> lane_sets() {
  std::vector<std::string> found{"none"};
#if defined(LIEEULER_LANES_X86)
  if (__builtin_cpu_supports("avx2")) found.insert(found.begin(), "avx2");
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
    found.insert(found.begin(), "avx512");
#endif
  return found;
}

// Calls run(first, last, stopped) for blocks of members on threads; whether it was interrupted.
template <class Block>
bool run_blocks(int width, size_t count, int threads, const Interrupted& interrupted, const Block& run) {
  constexpr size_t kMostInLane = 16;  // keeps lanes full for most of a block
  const size_t share = (count + threads * width - 1) / (threads * width);
  const size_t block = width * std::clamp<size_t>(share / 4, 1, kMostInLane);
  return on_threads((count + block - 1) / block, threads, interrupted, [&](size_t k, const Interrupted& stopped) {
    run(k * block, std::min(count, (k + 1) * block), stopped);
  });
}

}  // namespace lieeuler
