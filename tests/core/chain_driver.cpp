// A system stepped by one method without Python: the program that callgrind looks at.
//
//   chain_driver METHOD SYSTEM STEPS H [COEFFICIENTS]   prints   "x X Y Z  iterations K"
//
// SYSTEM: a file of numbers (read_system). COEFFICIENTS: a file of rows, each "length values...": the weights of a
// composition, or of a Runge-Kutta rule its order and five groups "rows row...". benchmarks/driver.py writes both.
// Methods that choose their steps take H for their tolerance.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include "methods/extrapolation.hpp"
#include "methods/rkmk.hpp"
#include "methods/taylor.hpp"
#include "model/system.hpp"
#include "run/implicit.hpp"

using namespace lieeuler;

static double number(std::istream& file) {
  double value = 0;
  file >> value;
  return value;
}
static int whole(std::istream& file) { return static_cast<int>(number(file)); }
static Vec3 three(std::istream& file) { return Vec3{number(file), number(file), number(file)}; }
static Mat3 nine(std::istream& file) {
  Mat3 m;
  for (int i = 0; i < 3; ++i) m.row(i) = three(file);
  return m;
}

// A system with the frames and velocities of its bodies, as benchmarks/driver.py writes it.
static System read_system(std::istream& file, std::vector<Frame>& frames, std::vector<Twist>& u) {
  const int bodies = whole(file);
  System system{{}, {}, {}, three(file)};
  for (int b = 0; b < bodies; ++b) {
    const double mass = number(file);
    measure(system, system.bodies.emplace_back(mass, nine(file)));
    frames.push_back({three(file), nine(file)}), u.push_back({three(file), three(file)});
  }
  for (int joints = whole(file); joints > 0; --joints) {
    Joint joint{whole(file), whole(file), three(file), three(file), {}};
    int row = system.rows();
    if (whole(file)) joint.parts.push_back({true, {}, row}), row += 3;
    for (int k = 0, dots = whole(file); k < dots; ++k, ++row) {
      if (k % 3 == 0) joint.parts.push_back({false, {}, row});
      joint.parts.back().dots.push_back({static_cast<Carrier>(whole(file)), static_cast<Carrier>(whole(file)),
                                         three(file), three(file), number(file), number(file)});
    }
    system.joints.push_back(joint);
    measure(system, joint);
  }
  for (int forces = whole(file); forces > 0; --forces) {
    Force force{static_cast<Force::Kind>(whole(file)), whole(file), whole(file), three(file), three(file)};
    force.stiffness = number(file), force.rest = number(file), force.damping = number(file);
    force.force = three(file), force.torque = three(file);
    system.forces.push_back(force);
    measure(system, force);
  }
  return system;
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
static int drive(Stepper&& stepper, const State& initial, const System& system, int steps, double h) {
  const FlushDenormals flush;
  Counters counters;
  const Interrupted never = [] { return false; };
  Watch watch(never, system);
  if (start(stepper, initial, h) != Status::success) return 2;
  if (step(stepper, counters, watch) != Status::success) return 2;
  for (int k = 1; k < steps; ++k)
    if (step(stepper, counters, watch) != Status::success) return 2;
  if constexpr (!requires { stepper.step(counters); }) stepper.state();  // TaylorStepper leaves (a, lam) until then
  const Vec3& x = stepper.state().frames[system.n() - 1].x;
  std::printf("x %.17g %.17g %.17g  iterations %ld\n", x.x(), x.y(), x.z(), counters.newton_iterations);
  return 0;
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
  const std::string method = argv[1];
  std::ifstream given(argv[2]);
  std::vector<Frame> frames;
  std::vector<Twist> u;
  const Plan plan(read_system(given, frames, u));
  State initial(plan.system);
  std::copy(frames.begin(), frames.end(), initial.frames.begin()), std::copy(u.begin(), u.end(), initial.u.begin());
  const auto run = [&](auto&& stepper, int steps, double h) { return drive(stepper, initial, plan.system, steps, h); };
  const int steps = std::atoi(argv[3]);
  const double h = std::atof(argv[4]);
  std::ifstream coefficients(argc > 5 ? argv[5] : "");
  if (method == "rkmk4") return run(FixedMuntheKaas<BodyChart>(plan, read_tableau(coefficients)), steps, h);
  if (method.starts_with("rkmk")) return run(AdaptiveMuntheKaas<BodyChart>(plan, read_tableau(coefficients)), steps, h);
  if (method == "taylor") return run(TaylorStepper(plan), steps, h);
  if (method == "seulex") return run(AdaptiveExtrapolation(plan), steps, h);
  if (method.starts_with("rattle"))
    return run(CompositionStepper(plan, CoordinateMap::exp, read_row(coefficients)), steps, h);
  Method rule{method[4] == 'H' ? Formulation::hamilton : Formulation::lagrange, Level::velocity, method[3] == '1'};
  if (method[3] == '3') rule.level = Level::position;
  if (method.ends_with("LSE")) rule.level = Level::stabilised;
  if (method == "INDEX1_LE" || method == "BAUMGARTE_LE") rule = {Formulation::lagrange, Level::acceleration, false};
  if (method == "BAUMGARTE_LE") rule.gains = {5, 5};
  if (method == "generalized_alpha") rule.spectral_radius = 0.8;
  return run(NewtonStepper(equations_of(plan, CoordinateMap::exp, rule)), steps, h);
}
