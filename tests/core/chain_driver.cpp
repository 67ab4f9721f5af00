// A chain of n pendulum bodies stepped by one method, without Python: counts heap allocations inside the step loop,
// and is the program that callgrind and the sanitizers look at.
//
//   chain_driver METHOD BODIES STEPS H   prints   "allocations N  x X Y Z  iterations K"
#define EIGEN_RUNTIME_NO_MALLOC
#include <cstdio>
#include <cstdlib>
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

#include "run/loop.hpp"
#include "methods/rkmk.hpp"
#include "methods/taylor.hpp"

using namespace lieeuler;

static System chain(int n) {
  System system{{}, {}, {}, {0, 0, -9.81}};
  const Mat3 J = Vec3(0.1, 0.2, 0.15).asDiagonal();
  for (int b = 0; b < n; ++b) {
    system.bodies.push_back({1.0, J, J.inverse()});
    system.joints.push_back({b == 0 ? n : b - 1, b, b == 0 ? Vec3::Zero() : Vec3(0, 0, -1), {0, 0, 1}, {Part{true, {}, 3 * b}}});
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

template <class Stepper>
static Status start(Stepper& stepper, const State& initial, double h) {
  return stepper.start(initial, h);
}
// Its steps are its own: as many as asked for fit into the time.
static Status start(TaylorStepper& stepper, const State& initial, double) {
  return stepper.start(initial, 0, 1e6, 1e-12);
}

template <class Stepper>
static Status step(Stepper& stepper, Counters& counters, Watch&) {
  return stepper.step(counters);
}
static Status step(TaylorStepper& stepper, Counters& counters, Watch& watch) { return stepper.step(counters, watch); }

template <class Stepper>
static int drive(Stepper&& stepper, const System& system, int steps, double h) {
  const FlushDenormals flush;
  Counters counters;
  const Interrupted never = [] { return false; };
  Watch watch(never, system);
  if (start(stepper, hanging_sideways(system), h) != Status::success) return 2;
  if (step(stepper, counters, watch) != Status::success) return 2;
  const long before = allocations;
  Eigen::internal::set_is_malloc_allowed(false);
  for (int k = 1; k < steps; ++k)
    if (step(stepper, counters, watch) != Status::success) return 2;
  Eigen::internal::set_is_malloc_allowed(true);
  const long inside = allocations - before;
  const Vec3& x = stepper.state().frames[system.n() - 1].x;
  std::printf("allocations %ld  x %.17g %.17g %.17g  iterations %ld\n", inside, x.x(), x.y(), x.z(),
              counters.newton_iterations);
  return inside == 0 ? 0 : 1;
}

int main(int argc, char** argv) {
  if (argc != 5) return 64;
  const std::string method = argv[1];
  const System system = chain(std::atoi(argv[2]));
  const int steps = std::atoi(argv[3]);
  const double h = std::atof(argv[4]);
  if (method == "rkmk4") {
    const Tableau kutta{{{0.5}, {0, 0.5}, {0, 0, 1}}, {1. / 6, 1. / 3, 1. / 3, 1. / 6}, 4, {}, {}, {}};
    return drive(FixedMuntheKaas(system, kutta), system, steps, h);
  }
  if (method == "taylor") return drive(TaylorStepper(system), system, steps, h);
  if (method == "rattle4") {
    const double a = 1 / (4 - std::cbrt(4.0));
    return drive(CompositionStepper<ExpMap>(system, {a, a, 1 - 4 * a, a, a}), system, steps, h);
  }
  if (method == "INDEX1_LE") return drive(LagrangeStepper<ExpMap>(system, Level::acceleration, false, {}), system, steps, h);
  if (method == "BAUMGARTE_LE")
    return drive(LagrangeStepper<ExpMap>(system, Level::acceleration, false, {5, 5}), system, steps, h);
  const Level level = method[3] == '3' ? Level::position : (method.ends_with("LSE") ? Level::stabilised : Level::velocity);
  const bool index1 = method[3] == '1';
  if (method[4] == 'H') return drive(HamiltonStepper<ExpMap>(system, level, index1), system, steps, h);
  return drive(LagrangeStepper<ExpMap>(system, level, index1, {}), system, steps, h);
}
