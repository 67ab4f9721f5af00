// Runs with fixed steps, and of steppers that choose theirs: stepping, sampling, also between steps, monitoring every
// step, final status.
#pragma once

#include <cstdint>
#include <optional>

#include "run/outcome.hpp"
#include "run/watch.hpp"
#include "solve/projection.hpp"

namespace lieeuler {

class Monitor {
 public:
  Monitor(const Plan& plan, bool enabled) : plan_(plan), system_(plan.system), enabled_(enabled) {}

  void start(const State& state, const Constraints& joints) {
    double kinetic;
    start_energy_ = energy(state, joints, kinetic);
    if (enabled_) watch(state, joints);
  }

  void watch(const State& state, const Constraints& joints) {
    if (!enabled_) return;
    double kinetic;
    raise(maxima.energy_error, std::abs(energy(state, joints, kinetic) - start_energy_));
    raise(maxima.kinetic, kinetic);
    for (size_t j = 0; j < system_.joints.size(); ++j) {
      const Joint& joint = system_.joints[j];
      const JointState& here = joints[static_cast<int>(j)];
      const Twist &parent = state.u[joint.parent], &child = state.u[joint.child];
      for (const Part& part : joint.constraints()) {
        raise(maxima.position, here.position(part));
        raise(maxima.velocity, here.velocity(part, parent, child) + here.drift(part));
        raise(maxima.acceleration,
              here.velocity(part, state.a[joint.parent], state.a[joint.child]) + here.gamma(part, parent, child));
      }
    }
    for (const PlacedMimic& mimic : plan_.mimics) watch(mimic, state, joints);
    for (int b = 0; b < system_.n(); ++b) {
      const Mat3& R = state.frames[b].R;
      raise(maxima.orthogonality, Mat3(R.transpose() * R - Mat3::Identity()));
    }
  }

  Maxima maxima;

 private:
  double energy(const State& state, const Constraints& joints, double& kinetic) const {
    double potential = 0;
    kinetic = 0;
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = system_.bodies[b];
      const Twist& u = state.u[b];
      const Vec3 L = angular_momentum(body, u.w);  // of the full angular velocity w + J^-1 spin
      kinetic += 0.5 * (body.mass * u.v.squaredNorm() + L.dot(body.inertia_inverse * L));
      potential -= body.mass * system_.gravity.dot(state.frames[b].x);
    }
    for (int k : plan_.rotors) {
      const double rate = joints.velocity(plan_.parts[k], state.u)[0];
      kinetic += 0.5 * rate * rate / plan_.part(k).compliance;
    }
    for (size_t k = 0; k < system_.forces.size(); ++k)
      potential += ForceState(system_.forces[k], state.frames, state.u, state.angles[k]).potential();
    return kinetic + potential;
  }

  void watch(const PlacedMimic& mimic, const State& state, const Constraints& joints) {
    raise(maxima.position, std::abs(gap(plan_, mimic, joints, state.angles)));
    raise(maxima.velocity, std::abs(mimic_rate(plan_, mimic, joints, state.u)));
    const auto gamma = [&](int k) { return joints.gamma(plan_.parts[k], state.u)[0]; };
    raise(maxima.acceleration, std::abs(mimic_rate(plan_, mimic, joints, state.a) + gamma(mimic.follower) -
                                        mimic.ratio * gamma(mimic.leader)));
  }

  const Plan& plan_;
  const System& system_;
  bool enabled_;
  double start_energy_ = 0;
};

// Checked at every sample, because a state that has overflowed may pass every test within a step.
inline bool is_finite(const State& state) {
  for (size_t b = 0; b + 1 < state.frames.size(); ++b) {
    const Frame& frame = state.frames[b];
    const Twist &u = state.u[b], &a = state.a[b];
    if (!(frame.x.allFinite() && frame.R.allFinite() && u.v.allFinite() && u.w.allFinite() && a.v.allFinite() &&
          a.w.allFinite()))
      return false;
  }
  return std::all_of(state.lam.begin(), state.lam.end(), [](double lam) { return std::isfinite(lam); });
}

// The outcome of a run that ends at the time reached.
template <class Stepper>
Outcome ended(Outcome outcome, Status status, double reached, const Monitor& monitor, const Stepper& stepper) {
  outcome.status = status;
  outcome.maxima = monitor.maxima;
  outcome.time_reached = reached;
  outcome.redundant_rows = stepper.redundant_rows();
  return outcome;
}

// Gives samples the least-norm multipliers of all rows, if the method solved only for those of independent rows.
class LeastNorm {
 public:
  explicit LeastNorm(const Plan& plan) : joints_(plan.system), shown_(plan.system) {
    if (plan.independent) rows_.emplace(plan);
  }

  const State& of(const State& state, int redundant_rows) {
    if (!rows_ || redundant_rows == 0) return state;
    shown_ = state;
    joints_.update(shown_.frames);
    rows_->make_least_norm(joints_, shown_.lam);
    return shown_;
  }

 private:
  Constraints joints_;
  State shown_;
  std::optional<IndependentRows> rows_;
};

// The state is checked for NaN every so many steps, so that a long interval ends soon after an overflow. The interval
// counts steps, not seconds, so that a repeated run ends at the same step.
inline constexpr std::int64_t kStepsBetweenLooks = 1024;

// Integrates over intervals of counts[k] steps of size steps[k], one sample at the end of each. The stepper supplies
// start(state, h), step(counters), cross(), which starts anew where accelerations jump at the end of that step,
// state(), joints() and redundant_rows().
template <class Stepper>
Outcome run(Stepper& stepper, const Plan& plan, const State& initial, const std::vector<double>& steps,
            const std::vector<std::int64_t>& counts, bool monitored, const Record& record,
            const Interrupted& interrupted) {
  const FlushDenormals flush;
  Outcome outcome;
  Monitor monitor(plan, monitored);
  double t = 0, h = 0;
  Watch watch(interrupted, plan.system);
  LeastNorm least_norm(plan);
  const auto end = [&](Status status) { return ended(outcome, status, t, monitor, stepper); };
  for (size_t k = 0; k < steps.size(); ++k) {
    if (steps[k] != h) {
      h = steps[k];
      if (const Status status = stepper.start(k == 0 ? initial : State(stepper.state()), h); status != Status::success)
        return end(status);
      if (k == 0) {
        if (!is_finite(stepper.state())) return end(Status::non_finite);
        monitor.start(stepper.state(), stepper.joints());
        record(outcome.samples++, least_norm.of(stepper.state(), stepper.redundant_rows()));
      }
    }
    const double begin = t;
    for (std::int64_t i = 0; i < counts[k]; ++i) {
      if (watch.ends()) return end(Status::interrupted);
      if (const Status status = stepper.step(outcome.counters); status != Status::success) return end(status);
      if (const Status status = stepper.cross(); status != Status::success) return end(status);
      if (monitored) monitor.watch(stepper.state(), stepper.joints());
      t = begin + (i + 1) * h;  // adding h 1e10 times would accumulate rounding
      if (i % kStepsBetweenLooks == kStepsBetweenLooks - 1 && !is_finite(stepper.state()))
        return end(Status::non_finite);
    }
    if (!is_finite(stepper.state())) return end(Status::non_finite);
    record(outcome.samples++, least_norm.of(stepper.state(), stepper.redundant_rows()));
  }
  return end(Status::success);
}

// Integrates from t_eval.front() and samples at t_eval; the steps do not depend on the samples. The stepper supplies
//
//   Status start(const State& initial, double t, double t_end, double rtol)
//   Status step(Counters&, Watch&)        one accepted step, the last one exactly to t_end; returns at once if the
//                                         watch ends the run
//   double time(), previous_time()        ends of that step
//   const State& state()                  at time(), on the constraints, with (a, lam) of the index-1 system; called
//                                         only when needed, so that a stepper may compute (a, lam) here
//   const Constraints& joints()           at state()
//   int redundant_rows()
//   Status dense(double t, State& out, Counters&, Watch&)
//                                         frames, u and the angles for unwrapping at t, within the last step
template <class Stepper>
Outcome run_adaptive(Stepper& stepper, const Plan& plan, const State& initial, const std::vector<double>& t_eval,
                     double rtol, bool monitored, const Record& record, const Interrupted& interrupted) {
  const FlushDenormals flush;
  const System& system = plan.system;
  Outcome outcome;
  Monitor monitor(plan, monitored);
  std::optional<Projection> projection;  // of samples between steps
  State sample(system);
  LeastNorm least_norm(plan);
  double reached = t_eval.front();
  const auto end = [&](Status status) { return ended(outcome, status, reached, monitor, stepper); };
  if (const Status status = stepper.start(initial, t_eval.front(), t_eval.back(), rtol); status != Status::success)
    return end(status);
  if (!is_finite(stepper.state())) return end(Status::non_finite);
  monitor.start(stepper.state(), stepper.joints());
  record(outcome.samples++, least_norm.of(stepper.state(), stepper.redundant_rows()));
  Watch watch(interrupted, system);
  for (size_t next = 1; next < t_eval.size();) {
    if (watch.ends()) return end(Status::interrupted);
    if (const Status status = stepper.step(outcome.counters, watch); status != Status::success) return end(status);
    reached = stepper.time();
    if (monitored) monitor.watch(stepper.state(), stepper.joints());
    for (; next < t_eval.size() && t_eval[next] <= reached; ++next) {
      if (watch.ends()) return end(Status::interrupted);  // a step may hold any number of samples
      if (t_eval[next] == reached) {
        if (!is_finite(stepper.state())) return end(Status::non_finite);
        record(outcome.samples++, least_norm.of(stepper.state(), stepper.redundant_rows()));
        continue;
      }
      Status status = Status::success;
      if (!projection) {
        projection.emplace(plan);
        status = projection->start(initial);
      }
      if (status == Status::success) status = stepper.dense(t_eval[next], sample, outcome.counters, watch);
      sample.frames.end_step();
      if (status == Status::success)
        status = projection->project(sample, Scales::of_motion(system, sample).length, outcome.counters);
      if (status == Status::success && !is_finite(sample)) status = Status::non_finite;
      if (status != Status::success) return end(status);
      record(outcome.samples++, least_norm.of(sample, stepper.redundant_rows()));
    }
  }
  return end(Status::success);
}

}  // namespace lieeuler
