// Members of an ensemble side by side in the lanes of registers: Taylor series of small trees of ball joints. A member
// that needs more than plain steps, or fails, is left to a run by itself, from its start.
#pragma once

#include "methods/taylor.hpp"
#include "methods/taylor_lanes.hpp"
#include "run/lanes.hpp"
#include "run/loop.hpp"

namespace lieeuler {

// A run of Taylor series that lanes may take over: output times from zero, and the tolerance.
struct TaylorRun {
  std::vector<double> t_eval;
  double rtol;
};

// Whether methods/taylor_lanes.cpp has the equations of a system.
inline bool fits_lanes(const Plan& plan) {
  return plan.hinges.complete && plan.forest && plan.expands_by == Elimination::small && plan.system.forces.empty() &&
         plan.system.n() <= kMostLaneBodies;
}

// Runs members in lanes; a lane whose member has ended takes the next one.
template <int width>
class TaylorLanes {
 public:
  TaylorLanes(const LaneCode<width>& code, const Members& members, const TaylorRun& run, double begin)
      : code_(code), members_(members), run_(run), begin_(begin), group_(std::make_unique<LaneGroup<width>>()) {
    group_->order = TaylorStepper::order_for(run.rtol), group_->rtol = run.rtol;
  }

  void run(size_t first, size_t last, const Interrupted& stopped) {
    const FlushDenormals flush;
    next_ = first, last_ = last;
    for (int lane = 0; lane < width; ++lane) refill(lane, stopped);
    while (running_ > 0 && !stopped()) {
      for (int lane = 0; lane < width; ++lane) group_->remaining[lane] = lanes_[lane].end - lanes_[lane].time;
      code_.expand(*group_);
      for (int lane = 0; lane < width; ++lane) group_->step[lane] = choose_step(lane);
      code_.evaluate(*group_, group_->state);
      record_between();
      for (int lane = 0; lane < width; ++lane) finish_step(lane, stopped);
    }
  }

 private:
  // The member in a lane, and where its run is.
  struct Slot {
    bool runs = false, stands = false;  // has a member; whose step is fine
    size_t member = 0, next = 0;        // `next`: among the output times
    const Plan* plan = nullptr;
    double time = 0, previous = 0, end = 0;
    std::int64_t steps = 0;
    std::optional<Projection> projection;  // of samples between steps
    std::optional<State> initial, shown;
  };

  // Gives a lane the next member that fits. Without one the lane stands still where it is, at first as the one before.
  void refill(int lane, const Interrupted& stopped) {
    Slot& slot = lanes_[lane];
    running_ -= slot.runs, slot.runs = false;
    for (; next_ < last_; ++next_) {
      const Plan& plan = members_.plan(next_);
      if (!fits_lanes(plan)) {
        members_.alone(next_, stopped);
        continue;
      }
      load(lane, plan, members_.initial(next_));
      slot.runs = true, slot.member = next_++, ++running_;
      return;
    }
    if (slot.plan == nullptr && lane > 0 && lanes_[lane - 1].plan != nullptr)
      load(lane, *lanes_[lane - 1].plan, *lanes_[lane - 1].initial);
  }
  void load(int lane, const Plan& plan, State initial) {
    Slot& slot = lanes_[lane];
    if (slot.plan != &plan) put(lane, plan), slot.plan = &plan, slot.shown.emplace(plan.system);
    for (int b = 0; b < group_->bodies; ++b) put_lane(group_->state[b], lane, initial.frames[b], initial.u[b]);
    slot.initial = std::move(initial), slot.projection.reset();
    slot.time = slot.previous = 0, slot.end = run_.t_eval.back(), slot.next = 1, slot.steps = 0;
  }

  // Writes what the equations of a member's system need.
  void put(int lane, const Plan& plan) {
    const System& system = plan.system;
    const ReferencePoints points(plan, true);
    LaneGroup<width>& group = *group_;
    group.bodies = system.n(), group.hinges = static_cast<int>(plan.hinges.hinges.size()), group.joints = 0;
    group.length[lane] = system.length;
    put_lane(group.gravity, lane, system.gravity);
    for (int b = 0; b < system.n(); ++b) {
      const Body& body = system.bodies[b];
      LaneBody<width>& out = group.body[b];
      out.pinned = points.pinned(b);
      put_lane(out.centre, lane, points.centre(b)), put_lane(out.lever, lane, body.mass * points.centre(b));
      put_lane(out.place, lane, points.position(b, State(system)));
      put_lane(out, lane, body, system.gravity, points.deviation(b), points.inertia(b).inverse());
    }
    for (int k = 0; k < group.hinges; ++k) {
      const Hinge& hinge = plan.hinges.hinges[k];
      LaneHinge<width>& out = group.hinge[k];
      out.body = hinge.body, out.base = hinge.base;
      put_lane(out.body_anchor, lane, hinge.body_anchor), put_lane(out.base_anchor, lane, hinge.base_anchor);
    }
    for (int k = 0; k < plan.count(); ++k) {
      if (points.holds(plan.parts[k])) continue;
      LaneJoint<width>& out = group.joint[group.joints++];
      for (Side side : kSides) {
        const Vec3& anchor = side == kChild ? plan.joint(k).child_anchor : plan.joint(k).parent_anchor;
        out.bodies[side] = plan.body(k, side);
        put_lane(out.anchors[side], lane, anchor);
        put_lane(out.points[side], lane, points.local(out.bodies[side], anchor));
      }
    }
    for (LaneState<width>* ground : {&group.state[system.n()], &group.sample[system.n()]})
      put_lane(*ground, lane, Frame{}, Twist{});
  }

  // As TaylorStepper::step without breaks; 0 of a lane without a member, or whose member has to run alone.
  double choose_step(int lane) {
    Slot& slot = lanes_[lane];
    slot.stands = false;
    const double h = group_->step[lane];
    if (!slot.runs || !group_->fine[lane] || h < std::min(smallest_step(0, slot.end), slot.end - slot.time)) return 0;
    const double time = slot.time + h < slot.end ? slot.time + h : slot.end;
    if (time == slot.time) return 0;
    slot.previous = std::exchange(slot.time, time), slot.stands = true;
    if (slot.steps++ == 0) members_.record(slot.member, 0, *slot.initial);
    return time - slot.previous;
  }

  // Samples between the ends of the last step.
  void record_between() {
    const auto pending = [&](const Slot& slot) { return slot.stands && run_.t_eval[slot.next] < slot.time; };
    while (std::any_of(lanes_, lanes_ + width, pending)) {
      for (int lane = 0; lane < width; ++lane)
        group_->step[lane] = pending(lanes_[lane]) ? run_.t_eval[lanes_[lane].next] - lanes_[lane].previous : 0;
      code_.evaluate(*group_, group_->sample);
      for (int lane = 0; lane < width; ++lane)
        if (Slot& slot = lanes_[lane]; pending(slot)) slot.stands = record_projected(lane, slot);
    }
  }
  bool record_projected(int lane, Slot& slot) {
    Counters unused;
    Status status = Status::success;
    if (!slot.projection) status = slot.projection.emplace(*slot.plan).start(*slot.initial);
    State& sample = show(lane, group_->sample, run_.t_eval[slot.next]);
    if (status == Status::success)
      status = slot.projection->project(sample, Scales::of_motion(slot.plan->system, sample).length, unused);
    if (status != Status::success || !is_finite(sample)) return false;
    members_.record(slot.member, static_cast<int>(slot.next++), sample);
    return true;
  }
  State& show(int lane, const LaneState<width>* from, double time) {
    State& out = *lanes_[lane].shown;
    show_lane(from, lane, group_->bodies, out);
    out.frames.time = begin_ + time;
    return out;
  }

  void finish_step(int lane, const Interrupted& stopped) {
    Slot& slot = lanes_[lane];
    if (!slot.runs) return;
    if (slot.stands && run_.t_eval[slot.next] == slot.time) {
      const State& state = show(lane, group_->state, slot.time);
      slot.stands = is_finite(state);
      if (slot.stands) members_.record(slot.member, static_cast<int>(slot.next++), state);
    }
    if (!slot.stands) {
      members_.alone(slot.member, stopped);
      return refill(lane, stopped);
    }
    if (slot.next < run_.t_eval.size()) return;
    Outcome outcome;
    outcome.samples = static_cast<int>(slot.next), outcome.time_reached = slot.time;
    outcome.counters.steps = slot.steps;
    members_.end(slot.member, outcome, width);
    refill(lane, stopped);
  }

  const LaneCode<width>& code_;
  const Members& members_;
  const TaylorRun& run_;
  const double begin_;
  std::unique_ptr<LaneGroup<width>> group_;
  Slot lanes_[width];
  int running_ = 0;
  size_t next_ = 0, last_ = 0;
};

}  // namespace lieeuler
