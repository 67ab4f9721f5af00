// Runs of one system or an ensemble, and what they return to Python.
#pragma once

#include <chrono>

#include "python/levels.hpp"
#include "python/run.hpp"
#include "run/threads.hpp"

namespace lieeuler {

// Where samples are written: v (5, T, n, 3) holds x, v, w, a and alpha. T is what the run asks for; one that ends early
// leaves the rest as it is.
class Samples {
 public:
  Samples(size_t most, const System& s, const Output& vectors, const Output& R, const Output& lam, const Output& angles)
      : n_(s.n()), m_(s.rows()), springs_(s.forces.size()), R_(R.data()), lam_(lam.data()), angles_(angles.data()) {
    require(vectors.size() == 15 * most * n_ && R.size() == 9 * most * n_ && lam.size() == most * m_ &&
                angles.size() == most * springs_,
            "arrays for all samples of the system");
    for (size_t k = 0; k < 5; ++k) vectors_[k] = vectors.data() + 3 * most * n_ * k;
  }
  void put(size_t sample, const State& state) {
    for (size_t b = 0; b < n_; ++b) {
      const Frame& frame = state.frames[b];
      const Vec3* const given[5] = {&frame.x, &state.u[b].v, &state.u[b].w, &state.a[b].v, &state.a[b].w};
      const size_t at = sample * n_ + b;
      for (size_t k = 0; k < 5; ++k) std::copy_n(given[k]->data(), 3, vectors_[k] + 3 * at);
      Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R_ + 9 * at) = frame.R;
    }
    std::copy_n(state.lam.begin(), m_, lam_ + sample * m_);
    std::copy_n(state.angles.begin(), springs_, angles_ + sample * springs_);
  }
  Trajectory trajectory(size_t count) const {
    return {vectors_[0], vectors_[1], vectors_[2], vectors_[3], vectors_[4], lam_, count};
  }

 private:
  const size_t n_, m_, springs_;
  double *vectors_[5], *R_, *lam_, *angles_;
};

// Whether a run may start here: numbers in range, rotations, and joints that are closed.
inline bool is_admissible(const Plan& plan, const State& state) {
  static constexpr double kLargest = 1e100, kOrthogonal = 1e-10;
  const auto fine = [](const auto& values) { return (values.array().abs() <= kLargest).all(); };
  for (int b = 0; b < plan.system.n(); ++b) {
    const Frame& frame = state.frames[b];
    if (!fine(frame.x) || !fine(state.u[b].v) || !fine(state.u[b].w)) return false;
    const double off = (frame.R.transpose() * frame.R - Mat3::Identity()).cwiseAbs().maxCoeff<Eigen::PropagateNaN>();
    if (!(off <= kOrthogonal) || frame.R.determinant() < 0) return false;
  }
  const auto [position, velocity] = constraint_levels(plan, state, 0.0);
  return position <= kOpen && velocity <= kOpen;
}

// Whether Ctrl-C was pressed; takes the interpreter's lock.
inline bool ctrl_c() {
  nb::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() == 0) return false;
  if (!PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) nb::raise_python_error();  // from the user's signal handler
  PyErr_Clear();
  return true;
}

// Runs from a state at the time of `method` into the arrays of Samples. checks: returns None, without a run, if the
// state is not admissible. Returns the status; samples filled, time reached and wall time (s); counters, maxima, and
// which levels are open at the end, of all steps with maxima or else of the last sample.
using Counted = std::tuple<long, long, long, long, long, long, int>;
using Ended = std::tuple<std::string, int, double, double, Counted,
                         std::tuple<double, double, double, double, double, double>, std::tuple<bool, bool, bool>>;
inline std::optional<Ended> integrate(const Plan& plan, const Run& method, const Array& x, const Array& R,
                                      const Array& v, const Array& w, bool checks, const Output& vectors,
                                      const Output& attitudes, const Output& lam, const Output& angles) {
  const System& system = plan.system;
  State initial = make_state(system, x, R, v, w);
  initial.frames.time = method.begin;
  if (checks && !is_admissible(plan, initial)) return std::nullopt;
  Samples samples(method.samples, system, vectors, attitudes, lam, angles);
  std::array<bool, 3> open{};
  const Record record = [&](int sample, const State& state) {
    samples.put(sample, state);
    if (method.monitored || system.joints.empty() || static_cast<size_t>(sample) + 1 < method.samples) return;
    const auto [position, velocity] = constraint_levels(plan, state, method.duration);
    open = {!(position <= kOpen), !(velocity <= kOpen), false};
  };
  Outcome outcome;
  double seconds;
  {
    nb::gil_scoped_release release;
    const auto start = std::chrono::steady_clock::now();
    outcome = method(plan, initial, record, ctrl_c);
    seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  if (method.monitored && outcome.status == Status::success && !system.joints.empty())
    open = open_levels(plan, samples.trajectory(outcome.samples), outcome.maxima, method.duration);
  const Counters& done = outcome.counters;
  const Maxima& most = outcome.maxima;
  return Ended{name_of(outcome.status),
               outcome.samples,
               outcome.time_reached,
               seconds,
               {done.steps, done.rejected_steps, done.force_evaluations, done.newton_iterations, done.factorizations,
                done.most_iterations, outcome.redundant_rows},
               {most.energy_error, most.kinetic, most.position, most.velocity, most.acceleration, most.orthogonality},
               {open[0], open[1], open[2]}};
}

// Runs all members; returns their samples and how each ended. `plans` holds one plan for all members, or one for each.
inline Parts integrate_ensemble(const std::vector<const Plan*>& plans, const Run& method, const Array& x,
                                const Array& R, const Array& v, const Array& w, int threads) {
  require(!plans.empty() && threads > 0, "an ensemble needs a system and a thread");
  const size_t T = method.samples, n = plans[0]->system.n(), N = x.size() / (3 * n);
  require(plans.size() == 1 || plans.size() == N, "one system, or one for each member");
  for (const Plan* plan : plans) require(plan->system.n() == static_cast<int>(n), "systems of equal size");
  const double nothing = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> xs(N * T * n * 3, nothing), Rs(N * T * n * 9, nothing), vs(xs), ws(xs), times(N, 0.0);
  std::vector<Status> statuses(N, Status::interrupted);
  std::vector<std::int64_t> steps(N, 0), rejected(N, 0);
  const auto run_member = [&](size_t k, const Interrupted& stopped) {
    const Plan& plan = *plans[plans.size() == 1 ? 0 : k];
    State initial = make_state(plan.system, x, R, v, w, k);
    initial.frames.time = method.begin;
    const Record record = [&](int sample, const State& state) {
      for (size_t b = 0; b < n; ++b) {
        const size_t at = (k * T + sample) * n + b;
        put(xs, 3 * at, state.frames[b].x), put(Rs, 9 * at, state.frames[b].R);
        put(vs, 3 * at, state.u[b].v), put(ws, 3 * at, state.u[b].w);
      }
    };
    const Outcome outcome = method(plan, initial, record, stopped);
    statuses[k] = outcome.status, times[k] = outcome.time_reached;
    steps[k] = outcome.counters.steps, rejected[k] = outcome.counters.rejected_steps;
  };
  bool interrupted;
  double seconds;
  {
    nb::gil_scoped_release release;
    const auto start = std::chrono::steady_clock::now();
    interrupted = on_threads(N, threads, ctrl_c, run_member);
    seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  Parts result;
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
  result["interrupted"] = interrupted;
  result["wall_time"] = seconds;
  return result;
}

}  // namespace lieeuler
