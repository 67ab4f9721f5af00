// Stepping, sampling, watching every step, and ending with a status.
#pragma once

#include <functional>

#include "denormals.hpp"
#include "euler_lagrange.hpp"
#include "rattle.hpp"

namespace lieeuler {

// Largest values over all steps. energy_error is |E - E(0)|, to be divided by kinetic.
struct Maxima {
  double energy_error = 0, kinetic = 0, position = 0, velocity = 0, acceleration = 0, orthogonality = 0;
};

class Monitor {
 public:
  Monitor(const System& system, bool enabled) : system_(system), enabled_(enabled) {}

  void start(const State& state, const Constraints& joints) {
    double kinetic;
    start_energy_ = energy(state, kinetic);
    if (enabled_) watch(state, joints);
  }

  void watch(const State& state, const Constraints& joints) {
    if (!enabled_) return;
    double kinetic;
    maxima.energy_error = std::max(maxima.energy_error, std::abs(energy(state, kinetic) - start_energy_));
    maxima.kinetic = std::max(maxima.kinetic, kinetic);
    for (size_t j = 0; j < system_.joints.size(); ++j) {
      const Joint& joint = system_.joints[j];
      const JointState& here = joints[static_cast<int>(j)];
      const Twist &parent = state.u[joint.parent], &child = state.u[joint.child];
      for (const Part& part : joint.parts) {
        raise(maxima.position, here.position(part));
        raise(maxima.velocity, here.velocity(part, parent, child));
        raise(maxima.acceleration, here.velocity(part, state.a[joint.parent], state.a[joint.child]) +
                                       here.gamma(part, parent, child));
      }
    }
    for (int b = 0; b < system_.n(); ++b) {
      const Mat3& R = state.frames[b].R;
      raise(maxima.orthogonality, Mat3(R.transpose() * R - Mat3::Identity()));
    }
  }

  Maxima maxima;

 private:
  template <class Values>
  static void raise(double& maximum, const Values& values) {
    maximum = std::max(maximum, values.cwiseAbs().maxCoeff());
  }

  double energy(const State& state, double& kinetic) const {
    double potential = 0;
    kinetic = 0;
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = system_.bodies[b];
      const Twist& u = state.u[b];
      const Vec3 L = angular_momentum(body, u.w);  // of the body's own velocity w + J^-1 spin
      kinetic += 0.5 * (body.mass * u.v.squaredNorm() + L.dot(body.inertia_inverse * L));
      potential -= body.mass * system_.gravity.dot(state.frames[b].x);
    }
    for (size_t k = 0; k < system_.forces.size(); ++k)
      potential += ForceState(system_.forces[k], state.frames, state.u, state.angles[k]).potential();
    return kinetic + potential;
  }

  const System& system_;
  bool enabled_;
  double start_energy_ = 0;
};

struct Method {
  bool hamiltonian;
  Level level;
  bool index1_output;  // (a, lam) from the index-1 system at the new state
  Gains gains;
  std::vector<double> composition;  // weights of a composition of RATTLE; empty: the method itself
};

struct Outcome {
  Status status = Status::success;
  int samples = 0;  // filled, including the start
  int redundant_rows = 0;
  double time_of_failure = 0;
  Counters counters;
  Maxima maxima;
};

// Where the samples go; each call appends one.
using Record = std::function<void(int sample, const State&)>;
// Asked now and then; true ends the run.
using Interrupted = std::function<bool()>;

// Integrates over intervals of counts[k] steps of size steps[k], one sample at the end of each.
template <class Stepper>
Outcome run(Stepper& stepper, const System& system, const State& initial, const std::vector<double>& steps,
            const std::vector<int>& counts, bool monitored, const Record& record, const Interrupted& interrupted) {
  constexpr long kBodyStepsBetweenChecks = 20000;
  const FlushDenormals flush;
  Outcome outcome;
  Monitor monitor(system, monitored);
  double t = 0, h = 0;
  long since_check = 0;
  auto end = [&](Status status) {
    outcome.status = status;
    outcome.maxima = monitor.maxima;
    outcome.time_of_failure = t;
    outcome.redundant_rows = stepper.redundant_rows();
    return outcome;
  };
  for (size_t k = 0; k < steps.size(); ++k) {
    if (steps[k] != h) {
      h = steps[k];
      if (const Status status = stepper.start(k == 0 ? initial : State(stepper.state()), h); status != Status::success)
        return end(status);
      if (k == 0) {
        monitor.start(stepper.state(), stepper.joints());
        record(outcome.samples++, stepper.state());
      }
    }
    for (int i = 0; i < counts[k]; ++i) {
      if ((since_check += system.n()) > kBodyStepsBetweenChecks) {
        since_check = 0;
        if (interrupted()) return end(Status::interrupted);
      }
      if (const Status status = stepper.step(outcome.counters); status != Status::success) return end(status);
      monitor.watch(stepper.state(), stepper.joints());
      t += h;
    }
    record(outcome.samples++, stepper.state());
  }
  return end(Status::success);
}

template <class Map>
Outcome run_method(const System& system, const Method& method, const State& initial, const std::vector<double>& steps,
                   const std::vector<int>& counts, bool monitored, const Record& record,
                   const Interrupted& interrupted) {
  if (!method.composition.empty()) {
    CompositionStepper<Map> stepper(system, method.composition);
    return run(stepper, system, initial, steps, counts, monitored, record, interrupted);
  }
  if (method.hamiltonian) {
    HamiltonStepper<Map> stepper(system, method.level, method.index1_output);
    return run(stepper, system, initial, steps, counts, monitored, record, interrupted);
  }
  LagrangeStepper<Map> stepper(system, method.level, method.index1_output, method.gains);
  return run(stepper, system, initial, steps, counts, monitored, record, interrupted);
}

}  // namespace lieeuler
