// Runs of one system or an ensemble, and what they return to Python.
#pragma once

#include <chrono>

#include "python/levels.hpp"
#include "python/run.hpp"
#include "run/threads.hpp"

namespace lieeuler {

// Where samples are written: `states`, lam (T, m) and angles (T, forces). A run that ends early leaves the rest as it
// is.
struct Samples {
  Motion states;
  size_t m, springs;
  double *lam, *angles;

  void put(size_t sample, const State& state) const {
    for (size_t b = 0; b < states.n; ++b) {
      const Frame& frame = state.frames[b];
      const Vec3* const given[5] = {&frame.x, &state.u[b].v, &state.u[b].w, &state.a[b].v, &state.a[b].w};
      for (size_t k = 0; k < 5; ++k) states.vector(k, sample, b) = *given[k];
      states.attitude(sample, b) = frame.R;
    }
    std::copy_n(state.lam.begin(), m, lam + sample * m);
    std::copy_n(state.angles.begin(), springs, angles + sample * springs);
  }
  State get(const System& system, size_t sample, double t) const {
    State state = load_state(system, states.row(0, sample), states.R + 9 * sample * states.n, states.row(1, sample),
                             states.row(2, sample));
    state.frames.time = t;
    return state;
  }
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

// The first of N states at a time from which no run may start, else N.
inline size_t first_refused(const Plan& plan, double time, const Array& x, const Array& R, const Array& v,
                            const Array& w) {
  const size_t N = x.size() / (3 * plan.system.n());
  for (size_t k = 0; k < N; ++k) {
    State state = make_state(plan.system, x, R, v, w, k);
    state.frames.time = time;
    if (!is_admissible(plan, state)) return k;
  }
  return N;
}

// Whether Ctrl-C was pressed; takes the interpreter's lock.
inline bool ctrl_c() {
  nb::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() == 0) return false;
  if (!PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) nb::raise_python_error();  // from the user's signal handler
  PyErr_Clear();
  return true;
}

// Runs the problem that stands for `whole` from a state at the time of `method`, and writes the samples of `whole` at
// times t (T,): v (5, T, n, 3) holds x, v, w, a and alpha. checks: returns None, without a run, if the state is not
// admissible. Returns the status; samples filled, time reached and wall time (s); counters, maxima, and which levels of
// `whole` are open at the end, of all steps with maxima or else of the last sample: 1, 2 and 4.
using Counted = std::tuple<long, long, long, long, long, long, int>;
using Ended = std::tuple<const char*, int, double, double, Counted,
                         std::tuple<double, double, double, double, double, double>, int>;
inline std::optional<Ended> integrate(const Plan& whole, const Plan& plan, const Run& method, const Array& x,
                                      const Array& R, const Array& v, const Array& w, bool checks, const Array& t,
                                      const Output& vectors, const Output& attitudes, const Output& lam) {
  const System &system = plan.system, &all = whole.system;
  const size_t T = method.samples, n = all.n(), m = all.rows(), springs = system.forces.size();
  require(t.size() == T && vectors.size() == 15 * T * n && attitudes.size() == 9 * T * n && lam.size() == T * m &&
              all.forces.size() == springs,
          "arrays for all samples of the system");
  State initial = make_state(system, x, R, v, w);
  initial.frames.time = method.begin;
  if (checks && !is_admissible(plan, initial)) return std::nullopt;
  std::vector<double> angles(T * springs), own_lam(method.fewer_rows ? T * system.rows() : 0);
  require(method.fewer_rows || system.rows() == all.rows(), "multipliers of all rows");
  // A motion for the problem of every reduction, and that of the whole.
  std::vector<std::vector<double>> kept;
  std::vector<Motion> motions{{n, T, vectors.data(), attitudes.data()}};
  for (size_t k = 0; k < method.reductions.size(); ++k) {
    const auto& bodies = method.reductions[k].bodies;
    size_t fewer = 0;
    for (const auto& body : bodies) fewer = std::max(fewer, static_cast<size_t>(body.carrier) + 1);
    require(bodies.size() == motions.back().n && method.reductions[k].angles.size() <= springs,
            "a carrier of every body, and an angle of every force");
    kept.emplace_back(24 * T * fewer);
    motions.push_back({fewer, T, kept.back().data(), kept.back().data() + 15 * T * fewer});
  }
  require(motions.back().n == static_cast<size_t>(system.n()), "carriers of all bodies");
  const Samples found{motions.back(), static_cast<size_t>(system.rows()), springs,
                      method.fewer_rows ? own_lam.data() : lam.data(), angles.data()};
  const Samples samples{motions.front(), m, springs, lam.data(), angles.data()};
  Outcome outcome;
  double seconds;
  std::array<bool, 3> open{};
  {
    nb::gil_scoped_release release;
    const auto start = std::chrono::steady_clock::now();
    bool judged = method.monitored || all.joints.empty();
    const auto judge_end = [&](const State& state) {
      const auto [position, velocity] = constraint_levels(whole, state, method.duration);
      open = {!(position <= kOpen), !(velocity <= kOpen), false}, judged = true;
    };
    const Record record = [&](int sample, const State& state) {
      found.put(sample, state);
      if (!judged && method.reductions.empty() && static_cast<size_t>(sample) + 1 == T) judge_end(state);
    };
    outcome = method(plan, initial, record, ctrl_c);
    outcome.time_reached += method.begin;
    const size_t count = outcome.samples;
    for (size_t k = method.reductions.size(); k-- > 0;) {
      const Reduction& reduction = method.reductions[k];
      reduction.restore(t.data(), count, motions[k + 1], motions[k]);
      for (size_t each = 0; each < count; ++each)
        for (size_t f = 0; f < reduction.angles.size(); ++f) angles[each * springs + f] += reduction.angles[f];
    }
    if (method.fewer_rows) {
      const auto given = [&](size_t k) {
        State state = samples.get(all, k, t.data()[k]);
        std::copy_n(angles.data() + k * springs, springs, state.angles.data());
        return state;
      };
      const auto [redundant, known] = solve_index1(whole, count, given, [&](const State& state, size_t k) {
        std::copy_n(state.lam.begin(), m, lam.data() + k * m);
      });
      outcome.redundant_rows = redundant;
      // At a singular position it ends as an integration of the whole would.
      if (known < count)
        outcome.status = Status::singular_matrix, outcome.samples = static_cast<int>(known),
        outcome.time_reached = t.data()[known];
    }
    if (outcome.status == Status::success && !all.joints.empty()) {
      const auto row = [&](size_t which) { return motions.front().row(which, 0); };
      if (method.monitored)
        open = open_levels(whole, {row(0), row(1), row(2), row(3), row(4), lam.data(), T}, outcome.maxima,
                           method.duration);
      else if (!judged)
        judge_end(samples.get(all, T - 1, t.data()[T - 1]));
    }
    seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  const Counters& done = outcome.counters;
  const Maxima& most = outcome.maxima;
  return Ended{name_of(outcome.status),
               outcome.samples,
               outcome.time_reached,
               seconds,
               {done.steps, done.rejected_steps, done.force_evaluations, done.newton_iterations, done.factorizations,
                done.most_iterations, outcome.redundant_rows},
               {most.energy_error, most.kinetic, most.position, most.velocity, most.acceleration, most.orthogonality},
               open[0] + 2 * open[1] + 4 * open[2]};
}

// Runs all members; returns their samples at times t (T,) and how each ended. `plans` holds one plan for all members,
// or one for each; `spins` (N, n, 3) are those of the frames of their bodies, or nothing.
inline Parts integrate_ensemble(const std::vector<const Plan*>& plans, const Run& method, const Array& t,
                                const Array& x, const Array& R, const Array& v, const Array& w, const Array& spins,
                                int threads) {
  require(!plans.empty() && threads > 0, "an ensemble needs a system and a thread");
  const size_t T = method.samples, n = plans[0]->system.n(), N = x.size() / (3 * n);
  require(plans.size() == 1 || plans.size() == N, "one system, or one for each member");
  require(t.size() == T && (spins.size() == 0 || spins.size() == 3 * N * n), "a time a sample, and a spin a body");
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
        auto [x_b, R_b] = state.frames[b];
        Vec3 w_b = state.u[b].w, alpha_b = state.a[b].w;
        const Vec3 spin = spins.size() == 0 ? Vec3(Vec3::Zero()) : load3(spins.data() + 3 * (k * n + b));
        if (!spin.isZero(0)) turn_with(spin, t.data()[sample] - t.data()[0], R_b, w_b, alpha_b);
        put(xs, 3 * at, x_b), put(Rs, 9 * at, R_b), put(vs, 3 * at, state.u[b].v), put(ws, 3 * at, w_b);
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
