// Runs of one system or an ensemble, and what they return to Python.
#pragma once

#include <atomic>
#include <chrono>
#include <future>

#include "python/levels.hpp"
#include "python/run.hpp"

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

// Whether Ctrl-C was pressed; takes the interpreter's lock.
inline bool ctrl_c() {
  nb::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() == 0) return false;
  if (!PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) nb::raise_python_error();  // from the user's signal handler
  PyErr_Clear();
  return true;
}

// Runs the problem that stands for `whole` from a state, and writes the samples of `whole` and its multipliers, lam
// (T, m). The status also says whether levels of `whole` that the method holds
// are open at the end: of all steps with maxima, or else of the last sample.
inline Outcome fill(const Plan& whole, const Plan& plan, const Run& method, const State& initial, const Motion& motion,
                    double* lam, const Interrupted& interrupted) {
  const System &system = plan.system, &all = whole.system;
  const std::vector<double>& t = method.t;
  const size_t T = t.size(), m = all.rows(), springs = system.forces.size();
  std::vector<double> angles(T * springs), own_lam(method.fewer_rows ? T * system.rows() : 0);
  require(all.forces.size() == springs && (method.fewer_rows || system.rows() == all.rows()),
          "the forces of the whole system, and multipliers of all rows");
  // A motion for the problem of every reduction, and that of the whole.
  std::vector<std::vector<double>> kept;
  std::vector<Motion> motions{motion};
  for (const Reduction& reduction : method.reductions) {
    size_t fewer = 0;
    for (const auto& body : reduction.bodies) fewer = std::max(fewer, static_cast<size_t>(body.carrier) + 1);
    require(reduction.bodies.size() == motions.back().n && reduction.angles.size() <= springs,
            "a carrier of every body, and an angle of every force");
    kept.emplace_back(24 * T * fewer);
    motions.push_back({fewer, T, kept.back().data(), kept.back().data() + 15 * T * fewer});
  }
  require(motions.back().n == static_cast<size_t>(system.n()), "carriers of all bodies");
  const Samples found{motions.back(), static_cast<size_t>(system.rows()), springs,
                      method.fewer_rows ? own_lam.data() : lam, angles.data()};
  const Samples samples{motion, m, springs, lam, angles.data()};
  std::array<bool, 3> open{};
  bool judged = method.monitored || all.joints.empty();
  const auto judge_end = [&](const State& state) {
    const auto [position, velocity] = constraint_levels(whole, state, method.duration);
    open = {!(position <= kOpen), !(velocity <= kOpen), false}, judged = true;
  };
  const Record record = [&](int sample, const State& state) {
    found.put(sample, state);
    if (!judged && method.reductions.empty() && static_cast<size_t>(sample) + 1 == T) judge_end(state);
  };
  Outcome outcome = method(plan, initial, record, interrupted);
  outcome.time_reached += t.front();
  const size_t count = outcome.samples;
  for (size_t k = method.reductions.size(); k-- > 0;) {
    const Reduction& reduction = method.reductions[k];
    reduction.restore(t.data(), count, motions[k + 1], motions[k]);
    for (size_t each = 0; each < count; ++each)
      for (size_t f = 0; f < reduction.angles.size(); ++f) angles[each * springs + f] += reduction.angles[f];
  }
  if (method.fewer_rows) {
    const auto given = [&](size_t k) {
      State state = samples.get(all, k, t[k]);
      std::copy_n(angles.data() + k * springs, springs, state.angles.data());
      return state;
    };
    const auto [redundant, known] = solve_index1(
        whole, count, given, [&](const State& state, size_t k) { std::copy_n(state.lam.begin(), m, lam + k * m); });
    outcome.redundant_rows = redundant;
    // At a singular position it ends as an integration of the whole would.
    if (known < count)
      outcome.status = Status::singular_matrix, outcome.samples = static_cast<int>(known),
      outcome.time_reached = t[known];
  }
  if (outcome.status != Status::success || all.joints.empty()) return outcome;
  const auto row = [&](size_t which) { return motion.row(which, 0); };
  if (method.monitored)
    open = open_levels(whole, {row(0), row(1), row(2), row(3), row(4), lam, T}, outcome.maxima, method.duration);
  else if (!judged)
    judge_end(samples.get(all, T - 1, t[T - 1]));
  for (size_t level = 0; level < open.size(); ++level)
    if (open[level] && (method.held >> level & 1)) outcome.status = Status::constraints_open;
  return outcome;
}

inline double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// One run, from the run's own state or a given one; v (5, T, n, 3) gets x, v, w, a and alpha. Returns None, without a
// run, if the given state is not admissible; or the status; samples filled, time reached and wall time (s); counters,
// and maxima.
using Counted = std::tuple<long, long, long, long, long, long, int>;
using Ended =
    std::tuple<const char*, int, double, double, Counted, std::tuple<double, double, double, double, double, double>>;
using Given = std::optional<std::tuple<Array, Array, Array, Array>>;
inline std::optional<Ended> integrate(const Plan& whole, const Plan& plan, const Run& method, const Given& start,
                                      const Output& vectors, const Output& attitudes, const Output& lam) {
  const size_t T = method.t.size(), n = whole.system.n();
  require(method.initial && method.initial->u.size() == static_cast<size_t>(plan.system.n()) + 1 &&
              vectors.size() == 15 * T * n && attitudes.size() == 9 * T * n && lam.size() == T * whole.system.rows(),
          "a state to start from, and arrays for all samples of the system");
  std::optional<State> given;
  if (start) {
    const auto& [x, R, v, w] = *start;
    given = make_state(plan.system, x, R, v, w);
    given->frames.time = method.t.front();
    if (!is_admissible(plan, *given)) return std::nullopt;
  }
  Outcome outcome;
  double seconds;
  {
    nb::gil_scoped_release release;
    const auto begin = std::chrono::steady_clock::now();
    outcome = fill(whole, plan, method, given ? *given : *method.initial, {n, T, vectors.data(), attitudes.data()},
                   lam.data(), ctrl_c);
    seconds = seconds_since(begin);
  }
  const Counters& done = outcome.counters;
  const Maxima& most = outcome.maxima;
  return Ended{name_of(outcome.status),
               outcome.samples,
               outcome.time_reached,
               seconds,
               {done.steps, done.rejected_steps, done.force_evaluations, done.newton_iterations, done.factorizations,
                done.most_iterations, outcome.redundant_rows},
               {most.energy_error, most.kinetic, most.position, most.velocity, most.acceleration, most.orthogonality}};
}

// Runs of N members on threads, from states (N, n, ...); `vectors` (N, 5, T, n, 3) and `attitudes` get their samples.
// wholes, plans, methods: as integrate() takes them, of all members or of each. Returns their statuses, times reached,
// steps and rejected steps; the first member whose state is not admissible, else N; whether Ctrl-C ended the runs; and
// the wall time (s). Members share nothing, so that results do not depend on the number of threads.
using EnsembleEnded = std::tuple<std::vector<std::string>, std::vector<double>, std::vector<long>, std::vector<long>,
                                 size_t, bool, double>;
inline EnsembleEnded integrate_ensemble(const std::vector<const Plan*>& wholes, const std::vector<const Plan*>& plans,
                                        const std::vector<const Run*>& methods, const Array& x, const Array& R,
                                        const Array& v, const Array& w, int threads, const Output& vectors,
                                        const Output& attitudes) {
  const size_t kinds = plans.size(), n = wholes.at(0)->system.n(), N = x.size() / (3 * n);
  require(threads > 0 && (kinds == 1 || kinds == N) && wholes.size() == kinds && methods.size() == kinds,
          "threads, and one system, or one for each member");
  const size_t T = methods[0]->t.size();
  for (size_t k = 0; k < kinds; ++k)
    require(T > 0 && methods[k]->t.size() == T && wholes[k]->system.n() == static_cast<int>(n) &&
                plans[k]->system.n() == static_cast<int>(n),
            "systems of equal size, and a time a sample");
  require(vectors.size() == 15 * N * T * n && attitudes.size() == 9 * N * T * n, "arrays for all samples");
  EnsembleEnded ended;
  auto& [statuses, times, steps, rejected, refused, interrupted, seconds] = ended;
  statuses.assign(N, name_of(Status::interrupted)), times.assign(N, 0), steps.assign(N, 0), rejected.assign(N, 0);
  refused = N;
  std::mutex guard;  // of `refused`
  std::atomic<size_t> next{0};
  std::atomic<bool> stop{false};
  const Interrupted stopped = [&] { return stop.load(); };
  const auto run_member = [&](size_t k) {
    const size_t kind = kinds == 1 ? 0 : k;
    State initial = make_state(plans[kind]->system, x, R, v, w, k);
    initial.frames.time = methods[kind]->t.front();
    if (!is_admissible(*plans[kind], initial)) {
      const std::lock_guard lock(guard);
      refused = std::min(refused, k), stop = true;
      return;
    }
    std::vector<double> lam(T * wholes[kind]->system.rows());
    const Motion motion{n, T, vectors.data() + 15 * k * T * n, attitudes.data() + 9 * k * T * n};
    const Outcome outcome = fill(*wholes[kind], *plans[kind], *methods[kind], initial, motion, lam.data(), stopped);
    statuses[k] = name_of(outcome.status), times[k] = outcome.time_reached;
    steps[k] = outcome.counters.steps, rejected[k] = outcome.counters.rejected_steps;
  };
  const auto work = [&] {
    try {
      for (size_t k; !stop && (k = next++) < N;) run_member(k);
    } catch (...) {
      stop = true;
      throw;
    }
  };
  nb::gil_scoped_release release;
  const auto start = std::chrono::steady_clock::now();
  std::vector<std::future<void>> crew;
  const struct End {  // of all threads, however this one leaves: the futures wait for them
    std::atomic<bool>& stop;
    ~End() { stop = true; }
  } end{stop};
  for (int k = 0; k < threads; ++k) crew.push_back(std::async(std::launch::async, work));
  for (std::future<void>& each : crew)
    while (each.wait_for(std::chrono::milliseconds(50)) != std::future_status::ready)
      if (ctrl_c()) stop = interrupted = true;
  for (std::future<void>& each : crew) each.get();  // throws what a member threw
  seconds = seconds_since(start);
  return ended;
}

}  // namespace lieeuler
