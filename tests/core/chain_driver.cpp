// A chain of n pendulum bodies, or the four-bar linkage, stepped by one method without Python: counts heap allocations
// inside the step loop, and is the program that callgrind looks at.
//
//   chain_driver METHOD BODIES|four_bar STEPS H [COEFFICIENTS]   prints   "allocations N  x X Y Z  iterations K"
//
// COEFFICIENTS: a file of rows, each "length values...": the weights of a composition, or of a Runge-Kutta rule its
// order and five groups "rows row..." (benchmarks/driver.py writes it). Methods that choose their steps take H for
// their tolerance.
#define EIGEN_RUNTIME_NO_MALLOC
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <new>
#include <string>

static long allocations = 0;
void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

#include "methods/extrapolation.hpp"
#include "methods/rkmk.hpp"
#include "methods/taylor.hpp"
#include "run/loop.hpp"

using namespace lieeuler;

static System chain(int n) {
  System system{{}, {}, {}, {0, 0, -9.81}};
  const Mat3 J = Vec3(0.1, 0.2, 0.15).asDiagonal();
  for (int b = 0; b < n; ++b) {
    system.bodies.emplace_back(1.0, J);
    system.joints.push_back(
        {b == 0 ? n : b - 1, b, b == 0 ? Vec3::Zero() : Vec3(0, 0, -1), {0, 0, 1}, {Part{true, {}, 3 * b}}});
  }
  return system;
}

static State hanging_sideways(const System& system) {
  State state(system);
  Vec3 tip = Vec3::Zero();
  for (int b = 0; b < system.n(); ++b) {
    state.frames[b].R = Eigen::AngleAxisd(1.0 + 0.1 * b, Vec3::UnitY()).toRotationMatrix();
    const Vec3 half = state.frames[b].R * Vec3(0, 0, -1);
    state.frames[b].x = tip + half;
    tip += 2 * half;
  }
  return state;
}

// scenarios/four_bar.toml
static System four_bar() {
  System system{{}, {}, {}, {0, 0, -9.81}};
  const auto body = [&](double mass, const Vec3& moments) {
    system.bodies.emplace_back(mass, Mat3(moments.asDiagonal()));
  };
  body(2, {0.1, 0.15, 0.1}), body(1.5, {0.004, 0.18, 0.18}), body(1.75, {0.005, 0.28, 0.28});
  const auto hinge = [&](int parent, int child, double at_parent, double at_child) {
    const int row = system.rows();
    Joint joint{parent, child, {at_parent, 0, 0}, {at_child, 0, 0}, {Part{true, {}, row}, Part{false, {}, row + 3}}};
    for (const Vec3& normal : {Vec3(1, 0, 0), Vec3(0, 0, -1)})
      joint.parts[1].dots.push_back({Carrier::parent_axis, Carrier::child_axis, normal, {0, 1, 0}, 0, 1});
    system.joints.push_back(joint);
  };
  hinge(3, 0, 0, -0.2), hinge(0, 1, 0.2, -0.6), hinge(1, 2, 0.6, 0.7), hinge(3, 2, 1.8, -0.7);
  return system;
}

static State cranked(const System& system) {
  State state(system);
  const double halves[] = {-1, -1.0 / 3, -2}, rates[] = {4.375, -0.875, 1};
  const double from[] = {0.2, 0.6, -0.7}, to[] = {0.2, 0.6, -0.7};
  Vec3 pin = Vec3::Zero(), speed = Vec3::Zero();
  for (int b = 0; b < 3; ++b) {
    Frame& frame = state.frames[b];
    frame.R = Eigen::AngleAxisd(2 * std::atan(halves[b]), Vec3::UnitY()).toRotationMatrix();
    const Vec3 w(0, rates[b], 0), first = frame.R * Vec3(from[b], 0, 0), second = frame.R * Vec3(to[b], 0, 0);
    frame.x = pin + first;
    state.u[b] = {speed + w.cross(first), w};
    pin = frame.x + second, speed = state.u[b].v + w.cross(second);
  }
  return state;
}

// Steppers for `run`, and those for `run_adaptive`, which take as many steps as asked for in a time without end.
template <class Stepper>
static Status start(Stepper& stepper, const State& initial, double h) {
  if constexpr (requires { stepper.start(initial, h); })
    return stepper.start(initial, h);
  else
    return stepper.start(initial, 0, 1e6, h);
}
template <class Stepper>
static Status step(Stepper& stepper, Counters& counters, Watch& watch) {
  if constexpr (requires { stepper.step(counters); })
    return stepper.step(counters);
  else
    return stepper.step(counters, watch);
}

template <class Stepper>
static int drive(Stepper&& stepper, const System& system, int steps, double h) {
  const FlushDenormals flush;
  Counters counters;
  const Interrupted never = [] { return false; };
  Watch watch(never, system);
  const bool loop = system.joints.size() > system.bodies.size();
  if (start(stepper, loop ? cranked(system) : hanging_sideways(system), h) != Status::success) return 2;
  if (step(stepper, counters, watch) != Status::success) return 2;
  const long before = allocations;
  Eigen::internal::set_is_malloc_allowed(false);
  for (int k = 1; k < steps; ++k)
    if (step(stepper, counters, watch) != Status::success) return 2;
  if constexpr (!requires { stepper.step(counters); }) stepper.state();  // TaylorStepper leaves (a, lam) until then
  Eigen::internal::set_is_malloc_allowed(true);
  const long inside = allocations - before;
  const Vec3& x = stepper.state().frames[system.n() - 1].x;
  std::printf("allocations %ld  x %.17g %.17g %.17g  iterations %ld\n", inside, x.x(), x.y(), x.z(),
              counters.newton_iterations);
  return inside == 0 ? 0 : 1;
}

static std::vector<double> read_row(std::istream& file) {
  size_t length = 0;
  file >> length;
  std::vector<double> row(length);
  for (double& value : row) file >> value;
  return row;
}
static std::vector<std::vector<double>> read_rows(std::istream& file) {
  size_t count = 0;
  file >> count;
  std::vector<std::vector<double>> rows(count);
  for (auto& row : rows) row = read_row(file);
  return rows;
}
static Tableau read_tableau(std::istream& file) {
  Tableau rule;
  file >> rule.order;
  rule.stages = read_rows(file), rule.weights = read_rows(file).at(0);
  rule.errors = read_rows(file), rule.extra = read_rows(file), rule.dense = read_rows(file);
  return rule;
}

int main(int argc, char** argv) {
  if (argc < 5) return 64;
  const std::string method = argv[1], bodies = argv[2];
  const Plan plan(bodies == "four_bar" ? four_bar() : chain(std::stoi(bodies)));
  const int steps = std::atoi(argv[3]);
  const double h = std::atof(argv[4]);
  std::ifstream coefficients(argc > 5 ? argv[5] : "");
  if (method == "rkmk4")
    return drive(FixedMuntheKaas<BodyChart>(plan, read_tableau(coefficients)), plan.system, steps, h);
  if (method.starts_with("rkmk"))
    return drive(AdaptiveMuntheKaas<BodyChart>(plan, read_tableau(coefficients)), plan.system, steps, h);
  if (method == "taylor") return drive(TaylorStepper(plan), plan.system, steps, h);
  if (method == "seulex") return drive(AdaptiveExtrapolation(plan), plan.system, steps, h);
  if (method.starts_with("rattle"))
    return drive(CompositionStepper<ExpMap>(plan, read_row(coefficients)), plan.system, steps, h);
  if (method == "generalized_alpha")
    return drive(LagrangeStepper<ExpMap>(plan, GeneralizedAlpha(0.8)), plan.system, steps, h);
  if (method == "INDEX1_LE")
    return drive(LagrangeStepper<ExpMap>(plan, Level::acceleration, false, {}), plan.system, steps, h);
  if (method == "BAUMGARTE_LE")
    return drive(LagrangeStepper<ExpMap>(plan, Level::acceleration, false, {5, 5}), plan.system, steps, h);
  const Level level =
      method[3] == '3' ? Level::position : (method.ends_with("LSE") ? Level::stabilised : Level::velocity);
  const bool index1 = method[3] == '1';
  if (method[4] == 'H') return drive(HamiltonStepper<ExpMap>(plan, level, index1), plan.system, steps, h);
  return drive(LagrangeStepper<ExpMap>(plan, level, index1, {}), plan.system, steps, h);
}
