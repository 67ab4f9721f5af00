// How far states violate the constraints, which levels a run has left open, the multipliers at given states, and states
// put onto the constraints.
#pragma once

#include <array>
#include <tuple>

#include "model/mimic.hpp"
#include "model/system.hpp"
#include "python/arrays.hpp"
#include "run/loop.hpp"

namespace lieeuler {

// How far a level may be open, as a part of the lengths, speeds and accelerations of the system; the same as at the
// start of a problem. Runs that hold a level stay below 1e-12; constraints opened by rounding, redundant rows or very
// different masses are far above 1e-8.
inline constexpr double kOpen = 1e-8;
// How far the acceleration level may be open as a part of the accelerations that the multipliers alone would give: what
// rounding leaves where they cancel. With very different masses these exceed the accelerations of the motion by so much
// that a bound of kOpen times them would accept anything.
inline constexpr double kCancelled = 1e-13;

// The rate (1/s) of a system at rest in a run of `duration`: the positions do not feel it, to rounding. Zero without
// one.
inline double resting_rate(double duration) {
  return duration > 0 ? std::numeric_limits<double>::epsilon() / (kOpen * duration) : 0;
}

// Largest entries of Phi and of G u, relative to the length and the rate of the system, after a run of `duration`; zero
// at a start.
//
// A state after the start does not say how many turns the leader of a mimic has made; the position row of the mimic is
// skipped if they make a difference.
inline std::pair<double, double> constraint_levels(const Plan& plan, const State& state, double duration) {
  const System& system = plan.system;
  const Scales scales = Scales::of_motion(system, state);
  const double rate = std::max({scales.rate, scales.natural(system), resting_rate(duration)});
  double position = 0, velocity = 0;
  for (const Joint& joint : system.joints) {
    JointState here;
    here.update(joint, state.frames);
    for (const Part& part : joint.constraints()) {
      Vec3 gap = here.position(part), speed = here.velocity(part, state.u[joint.parent], state.u[joint.child]);
      speed += here.drift(part);
      for (int r = 0; r < part.rows(); ++r)
        if (part.translational(r)) gap[r] /= system.length, speed[r] /= system.length;
      raise(position, gap), raise(velocity, speed);
    }
  }
  if (!plan.mimics.empty()) {
    Constraints joints(system);
    joints.update(state.frames);
    for (const PlacedMimic& mimic : plan.mimics) {
      const double size = mimic.turns ? 1 : 1 / system.length;
      const bool any_turn = mimic.angle < 0 || (mimic.turns && mimic.ratio == std::round(mimic.ratio));
      if (any_turn || duration == 0) raise(position, size * std::abs(gap(plan, mimic, joints, state.angles)));
      raise(velocity, size * std::abs(mimic_rate(plan, mimic, joints, state.u)));
    }
  }
  return {position, rate > 0 ? velocity / rate : velocity};  // without a rate nothing moves
}

// The two levels (N, 2) of N states at a time.
inline Made levels_of_states(const Plan& plan, const Array& x, const Array& R, const Array& v, const Array& w,
                             double time, double duration) {
  const System& system = plan.system;
  const size_t n = system.n(), N = x.size() / (3 * n);
  std::vector<double> levels;
  for (size_t k = 0; k < N; ++k) {
    State state = make_state(system, x, R, v, w, k);
    state.frames.time = time;
    const auto [position, velocity] = constraint_levels(plan, state, duration);
    levels.insert(levels.end(), {position, velocity});
  }
  return make_array(std::move(levels), {N, 2});
}

// A run at its samples, rows of `count` states.
struct Trajectory {
  const double *x, *v, *w, *a, *alpha, *lam;
  size_t count;
};

// Which levels - position, velocity, acceleration - a run over `duration` leaves open, by the largest values of all its
// steps. Bodies may be faster between two samples than at them, so the kinetic energy of every step counts too. A
// system at rest counts with the speed that its weight and loads would give it.
inline std::array<bool, 3> open_levels(const Plan& plan, const Trajectory& run, const Maxima& maxima, double duration) {
  const System& system = plan.system;
  const auto largest = [](const double* values, size_t count) {
    return count == 0 ? 0.0
                      : Eigen::Map<const Eigen::ArrayXd>(values, static_cast<Eigen::Index>(count))
                            .abs()
                            .maxCoeff<Eigen::PropagateNaN>();
  };
  const size_t numbers = 3 * system.n() * run.count;
  double length = largest(run.x, numbers), most = 0, least = std::numeric_limits<double>::infinity();
  for (const Joint& joint : system.joints)
    for (Side side : kSides)
      if ((side == kChild ? joint.child : joint.parent) != system.n())
        length = std::max(length, (side == kChild ? joint.child_anchor : joint.parent_anchor).cwiseAbs().maxCoeff());
  if (length == 0) length = 1;
  for (const Body& body : system.bodies) most = std::max(most, body.mass), least = std::min(least, body.mass);
  const double speed =
      std::max(largest(run.v, numbers) + length * largest(run.w, numbers), std::sqrt(2 * maxima.kinetic / most));
  const double acceleration = largest(run.a, numbers) + length * largest(run.alpha, numbers) + speed * speed / length +
                              system.gravity.cwiseAbs().maxCoeff();
  const double carried = largest(run.lam, system.rows() * run.count) / least, rest = resting_rate(duration);
  const double slowest = length * std::max(Scales{length}.natural(system), rest);
  const auto open = [](double level, double bound) { return !(level <= bound); };
  return {open(maxima.position, kOpen * length), open(maxima.velocity, kOpen * std::max(speed, slowest)),
          open(maxima.acceleration, kOpen * std::max(acceleration, length * rest / duration) + kCancelled * carried)};
}

// The same of arrays (T, ...), as booleans, by three maxima over all steps and the largest kinetic energy.
inline std::tuple<bool, bool, bool> open_levels_of(const Plan& plan, const Array& x, const Array& v, const Array& w,
                                                   const Array& a, const Array& alpha, const Array& lam,
                                                   double position, double velocity, double acceleration,
                                                   double kinetic, double duration) {
  const size_t count = x.size() / (3 * plan.system.n());
  for (const Array* each : {&x, &v, &w, &a, &alpha})
    require(each->size() == 3 * plan.system.n() * count, "x, v, w, a and alpha must be those of the system's bodies");
  require(lam.size() == plan.system.rows() * count, "lam must be that of the system's rows");
  Maxima maxima;
  maxima.position = position, maxima.velocity = velocity, maxima.acceleration = acceleration, maxima.kinetic = kinetic;
  const auto open =
      open_levels(plan, {x.data(), v.data(), w.data(), a.data(), alpha.data(), lam.data(), count}, maxima, duration);
  return {open[0], open[1], open[2]};
}

// Solves the index-1 system at N states, given(k), with multipliers of least norm if rows are redundant; take(state, k)
// gets each. Returns the number of redundant rows at the first state, and the first state without a solution, else N.
template <class Given, class Take>
std::pair<int, size_t> solve_index1(const Plan& plan, size_t N, const Given& given, const Take& take) {
  const auto solve = [](Projection& by, State& state, bool first) {
    if (first && by.start(state) != Status::success) return false;
    if (by.accelerate(state) != Status::success) return false;
    by.make_least_norm(state);
    return true;
  };
  Projection projection(plan);
  size_t unknown = N;
  for (size_t k = 0; k < N; ++k) {
    State state = given(k);
    if (!solve(projection, state, k == 0)) {
      Projection there(plan);  // at a singular position more rows depend on others: count them again
      if (!solve(there, state, true)) {
        unknown = std::min(unknown, k);
        continue;
      }
    }
    take(state, k);
  }
  return {projection.redundant_rows(), unknown};
}

// The same of arrays: accelerations a and alpha (N, n, 3), multipliers (N, m), what each joint exerts on its child (N,
// joints, 6), force in the world and torque about the centre of mass in body axes; and what solve_index1() returns.
// `angles` (N, forces) are those of torsional springs, unwrapped.
inline std::tuple<Made, Made, Made, Made, int, size_t> index1(const Plan& plan, const Array& times, const Array& x,
                                                              const Array& R, const Array& v, const Array& w,
                                                              const Array& angles) {
  const System& system = plan.system;
  const size_t n = system.n(), N = x.size() / (3 * n), m = system.rows(), springs = system.forces.size();
  const size_t joints = system.joints.size();
  require(times.size() == N && angles.size() == N * springs, "every state needs a time and an angle a force");
  const double nothing = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> as(3 * N * n, nothing), alphas(as), lam(N * m, nothing), exerted(6 * N * joints, nothing);
  Constraints rows(system);
  std::vector<Twist> f(n + 1);
  const auto given = [&](size_t k) {
    State state = make_state(system, x, R, v, w, k);
    state.frames.time = times.data()[k];
    std::copy_n(angles.data() + k * springs, springs, state.angles.data());
    return state;
  };
  const auto [redundant, unknown] = solve_index1(plan, N, given, [&](const State& state, size_t k) {
    for (size_t b = 0; b < n; ++b) put(as, 3 * (k * n + b), state.a[b].v), put(alphas, 3 * (k * n + b), state.a[b].w);
    std::copy_n(state.lam.begin(), m, &lam[k * m]);  // not those of rotors and leaders
    rows.update(state.frames);
    for (size_t j = 0; j < joints; ++j) {
      const int child = system.joints[j].child;
      f[child] = {};
      for (const PlacedPart& placed : plan.parts) {
        if (placed.joint != static_cast<int>(j)) continue;
        Vec3 own = Vec3::Zero();
        std::copy_n(&state.lam[placed.part->row], placed.part->rows(), own.data());
        rows.subtract_reaction(placed, own, f);
      }
      store(f[child], &exerted[6 * (k * joints + j)]);
    }
  });
  return {make_array(std::move(as), {N, n, 3}),
          make_array(std::move(alphas), {N, n, 3}),
          make_array(std::move(lam), {N, m}),
          make_array(std::move(exerted), {N, joints, 6}),
          redundant,
          unknown};
}

// A state projected onto Phi = 0 and G u = 0 at a time, with a matrix of its own and the number of redundant rows at
// `home`: how that ended, and x, R, v, w.
inline std::tuple<const char*, Made, Made, Made, Made> project(const Plan& plan, double time, const Array& home_x,
                                                               const Array& home_R, const Array& x, const Array& R,
                                                               const Array& v, const Array& w) {
  const System& system = plan.system;
  const auto at_time = [&](State state) {
    state.frames.time = time;
    update_angles(system, state.frames, state.u, state.angles);
    return state;
  };
  State state = at_time(make_state(system, x, R, v, w));
  const State home = at_time(make_state(system, home_x, home_R, v, w));
  Projection projection(plan);
  Counters counters;
  Status status = projection.start(home);
  if (status == Status::success) status = projection.project(state, Scales::of_motion(system, home).length, counters);
  const size_t n = system.n();
  std::vector<double> xs(3 * n), Rs(9 * n), vs(3 * n), ws(3 * n);
  for (size_t b = 0; b < n; ++b) {
    put(xs, 3 * b, state.frames[b].x), put(Rs, 9 * b, state.frames[b].R);
    put(vs, 3 * b, state.u[b].v), put(ws, 3 * b, state.u[b].w);
  }
  return {name_of(status), make_array(std::move(xs), {n, 3}), make_array(std::move(Rs), {n, 3, 3}),
          make_array(std::move(vs), {n, 3}), make_array(std::move(ws), {n, 3})};
}

}  // namespace lieeuler
