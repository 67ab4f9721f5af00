// Runs of one system or an ensemble, and what they return to Python.
#pragma once

#include <chrono>

#include "python/arrays.hpp"
#include "run/ensemble.hpp"

namespace lieeuler {

// Memory for all samples is reserved, and filled sample by sample: a run that ends early returns only what it reached.
struct Samples {
  std::vector<double> x, R, v, w, a, alpha, lam, angles;
  Samples(size_t most, const System& s) : rows_(s.rows()) {
    for (auto* vectors : {&x, &v, &w, &a, &alpha}) vectors->reserve(3 * most * s.n());
    R.reserve(9 * most * s.n()), lam.reserve(most * s.rows()), angles.reserve(most * s.forces.size());
  }
  void append(const State& state) {
    auto add = [](std::vector<double>& out, const Vec3& vector) {
      out.insert(out.end(), vector.data(), vector.data() + 3);
    };
    for (size_t b = 0; b + 1 < state.frames.size(); ++b) {
      add(x, state.frames[b].x);
      for (int row = 0; row < 3; ++row) add(R, state.frames[b].R.row(row).transpose());
      add(v, state.u[b].v), add(w, state.u[b].w), add(a, state.a[b].v), add(alpha, state.a[b].w);
    }
    lam.insert(lam.end(), state.lam.begin(), state.lam.begin() + rows_);
    angles.insert(angles.end(), state.angles.begin(), state.angles.end());
  }

 private:
  const int rows_;
};

// Whether Ctrl-C was pressed; takes the interpreter's lock.
inline bool ctrl_c() {
  nb::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() == 0) return false;
  if (!PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) nb::raise_python_error();  // from the user's signal handler
  PyErr_Clear();
  return true;
}

inline nb::dict integrate(const Plan& plan, const Run& method, const Array& x, const Array& R, const Array& v,
                          const Array& w) {
  const System& system = plan.system;
  State initial = make_state(system, x, R, v, w);
  initial.frames.time = method.begin;
  Samples samples(method.samples, system);
  const Record record = [&](int, const State& state) { samples.append(state); };
  Outcome outcome;
  double seconds;
  {
    nb::gil_scoped_release release;
    const auto start = std::chrono::steady_clock::now();
    outcome = method(plan, initial, record, ctrl_c);
    seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  const size_t T = outcome.samples, n = system.n(), m = system.rows();
  nb::dict result, counters, maxima;
  result["status"] = name_of(outcome.status);
  result["samples"] = outcome.samples;
  result["time"] = outcome.time_reached;
  result["wall_time"] = seconds;
  result["x"] = make_array(std::move(samples.x), {T, n, 3});
  result["R"] = make_array(std::move(samples.R), {T, n, 3, 3});
  result["v"] = make_array(std::move(samples.v), {T, n, 3});
  result["w"] = make_array(std::move(samples.w), {T, n, 3});
  result["a"] = make_array(std::move(samples.a), {T, n, 3});
  result["alpha"] = make_array(std::move(samples.alpha), {T, n, 3});
  result["lam"] = make_array(std::move(samples.lam), {T, m});
  result["angles"] = make_array(std::move(samples.angles), {T, system.forces.size()});
  counters["steps"] = outcome.counters.steps;
  counters["rejected_steps"] = outcome.counters.rejected_steps;
  counters["force_evaluations"] = outcome.counters.force_evaluations;
  counters["newton_iterations"] = outcome.counters.newton_iterations;
  counters["factorizations"] = outcome.counters.factorizations;
  counters["redundant_rows"] = outcome.redundant_rows;
  counters["most_iterations"] = outcome.counters.most_iterations;
  maxima["energy_error"] = outcome.maxima.energy_error;
  maxima["kinetic"] = outcome.maxima.kinetic;
  maxima["constraint_position"] = outcome.maxima.position;
  maxima["constraint_velocity"] = outcome.maxima.velocity;
  maxima["constraint_acceleration"] = outcome.maxima.acceleration;
  maxima["orthogonality"] = outcome.maxima.orthogonality;
  result["counters"] = counters;
  result["maxima"] = maxima;
  return result;
}

// Runs all members; returns their samples and how each ended. `plans` holds one plan for all members, or one for each.
inline nb::dict integrate_ensemble(const std::vector<const Plan*>& plans, const Run& method, const Array& x,
                                   const Array& R, const Array& v, const Array& w, const std::string& lanes,
                                   int threads) {
  require(!plans.empty() && threads > 0, "an ensemble needs a system and a thread");
  const size_t T = method.samples, n = plans[0]->system.n(), N = x.size() / (3 * n);
  require(plans.size() == 1 || plans.size() == N, "one system, or one for each member");
  for (const Plan* plan : plans) require(plan->system.n() == static_cast<int>(n), "systems of equal size");
  const double nothing = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> xs(N * T * n * 3, nothing), Rs(N * T * n * 9, nothing), vs(xs), ws(xs), times(N, 0.0);
  std::vector<Status> statuses(N, Status::interrupted);
  std::vector<std::int64_t> steps(N, 0), rejected(N, 0);
  std::vector<int> in_lanes(N, 1);
  Members members;
  members.plan = [&](size_t k) -> const Plan& { return *plans[plans.size() == 1 ? 0 : k]; };
  members.initial = [&](size_t k) {
    State initial = make_state(members.plan(k).system, x, R, v, w, k);
    initial.frames.time = method.begin;
    return initial;
  };
  members.record = [&](size_t k, int sample, const State& state) {
    for (size_t b = 0; b < n; ++b) {
      const size_t at = (k * T + sample) * n + b;
      put(xs, 3 * at, state.frames[b].x), put(Rs, 9 * at, state.frames[b].R);
      put(vs, 3 * at, state.u[b].v), put(ws, 3 * at, state.u[b].w);
    }
  };
  members.end = [&](size_t k, const Outcome& outcome, int width) {
    statuses[k] = outcome.status, times[k] = outcome.time_reached, in_lanes[k] = width;
    steps[k] = outcome.counters.steps, rejected[k] = outcome.counters.rejected_steps;
  };
  members.alone = [&](size_t k, const Interrupted& stopped) {
    const Record record = [&](int sample, const State& state) { members.record(k, sample, state); };
    members.end(k, method(members.plan(k), members.initial(k), record, stopped), 1);
  };
  bool interrupted;
  double seconds;
  {
    nb::gil_scoped_release release;
    const auto start = std::chrono::steady_clock::now();
    interrupted = run_members(N, members, method, lanes, threads, ctrl_c);
    seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  nb::dict result;
  result["x"] = make_array(std::move(xs), {N, T, n, 3});
  result["R"] = make_array(std::move(Rs), {N, T, n, 3, 3});
  result["v"] = make_array(std::move(vs), {N, T, n, 3});
  result["w"] = make_array(std::move(ws), {N, T, n, 3});
  result["time"] = make_array(std::move(times), {N});
  std::vector<std::string> names;
  for (const Status status : statuses) names.emplace_back(name_of(status));
  result["status"] = names;
  result["steps"] = steps;
  result["rejected_steps"] = rejected;
  result["lanes"] = in_lanes;
  result["interrupted"] = interrupted;
  result["wall_time"] = seconds;
  return result;
}

}  // namespace lieeuler
