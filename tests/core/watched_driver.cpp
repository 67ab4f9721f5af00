// Every family of steppers on systems that reach every part of the kernel, without Python: for the sanitizers.
//
//   watched_driver SYSTEM METHOD [STEP]   prints   "status S  steps N  sum X", X of all sampled positions
#include <cstdio>
#include <string>

#include "methods/extrapolation.hpp"
#include "methods/rkmk.hpp"
#include "run/loop.hpp"

using namespace lieeuler;

namespace {

const Vec3 kX = Vec3::UnitX(), kY = Vec3::UnitY(), kZ = Vec3::UnitZ();

struct Machine {
  System system{{}, {}, {}, {0, -9.81, 0}};
  std::vector<Vec3> x, v, w;

  int add_body(const Vec3& position, const Vec3& velocity = Vec3::Zero(), const Vec3& rate = Vec3::Zero()) {
    const Mat3 J = Vec3(0.1, 0.2, 0.15).asDiagonal();
    system.bodies.emplace_back(1.0, J);
    x.push_back(position), v.push_back(velocity), w.push_back(rate);
    return system.n() - 1;
  }
  // All attitudes are the identity at the start, so axes of parent and child are the same numbers. Ground: -1.
  void add_joint(int parent, int child, const Vec3& at, bool spherical, const std::vector<DotRow>& dots) {
    const int ground = system.n();
    Joint joint{parent < 0 ? ground : parent, child, parent < 0 ? at : Vec3(at - x[parent]), at - x[child], {}};
    int row = system.rows();
    if (spherical) joint.parts.push_back({true, {}, row}), row += 3;
    for (size_t k = 0; k < dots.size(); ++k, ++row) {
      if (k % 3 == 0) joint.parts.push_back({false, {}, row});
      joint.parts.back().dots.push_back(dots[k]);
    }
    system.joints.push_back(joint);
  }
  State start() const {
    State state(system);
    for (int b = 0; b < system.n(); ++b) state.frames[b].x = x[b], state.u[b] = {v[b], w[b]};
    return state;
  }
};

DotRow normal(const Vec3& a, const Vec3& b) { return {Carrier::parent_axis, Carrier::child_axis, a, b}; }
DotRow across(const Vec3& a) { return {Carrier::parent_axis, Carrier::difference, a}; }

// A chain of n bodies on ball joints, laid out sideways.
Machine pendulum(int n) {
  Machine m;
  for (int b = 0; b < n; ++b) m.add_body({0.5 + b, 0, 0});
  for (int b = 0; b < n; ++b) m.add_joint(b - 1, b, {static_cast<double>(b), 0, 0}, true, {});
  return m;
}

// A parallelogram of hinges, one degree of freedom and three rows too many.
Machine parallelogram() {
  Machine m;
  const int crank = m.add_body({0, 0.5, 0}, {-0.5, 0, 0}, kZ), coupler = m.add_body({1, 1, 0}, {-1, 0, 0}),
            rocker = m.add_body({2, 0.5, 0}, {-0.5, 0, 0}, kZ);
  const std::vector<DotRow> hinge{normal(kX, kZ), normal(kY, kZ)};
  m.add_joint(-1, crank, {0, 0, 0}, true, hinge), m.add_joint(crank, coupler, {0, 1, 0}, true, hinge);
  m.add_joint(coupler, rocker, {2, 1, 0}, true, hinge), m.add_joint(-1, rocker, {2, 0, 0}, true, hinge);
  return m;
}

// The same with a spring that is stiff for steps of a millisecond.
Machine stiff_parallelogram() {
  Machine m = parallelogram();
  Force spring{Force::Kind::linear_spring, m.system.n(), 1};
  spring.parent_point = 0.2 * kY, spring.stiffness = 1e5, spring.rest = 1.25;
  m.system.forces = {spring};
  return m;
}

// Bricard's mechanism on the edges of a cube, with a damped spring: one row depends on the others, and only where the
// joints are closed.
Machine bricard() {
  Machine m;
  for (const Vec3& x : {Vec3(0.5, 0, 0), Vec3(1, -0.5, 0), Vec3(1, -1, 0.5), Vec3(0.5, -1, 1), Vec3(0, -0.5, 1)})
    m.add_body(x);
  const auto hinge = [&](int parent, int child, const Vec3& at, const Vec3& axis) {
    std::vector<DotRow> rows;
    for (const Vec3& other : {kX, kY, kZ})
      if (other != axis) rows.push_back(normal(other, axis));
    m.add_joint(parent, child, at, true, rows);
  };
  hinge(-1, 0, {0, 0, 0}, kY), hinge(0, 1, {1, 0, 0}, kZ), hinge(1, 2, {1, -1, 0}, kX);
  hinge(2, 3, {1, -1, 1}, kY), hinge(3, 4, {0, -1, 1}, kZ), hinge(-1, 4, {0, 0, 1}, kX);
  Force spring{Force::Kind::linear_spring, m.system.n(), 2};
  spring.parent_point = {-1, 1, 2}, spring.stiffness = 1e4, spring.rest = 2, spring.damping = 5;
  m.system.forces = {spring};
  return m;
}

// A hinge, a slide that turns, a rod; springs, dampers and loads of every kind.
Machine sprung() {
  Machine m;
  const int arm = m.add_body({0.5, 0, 0}), slider = m.add_body({1.5, 0, 0}), bob = m.add_body({2.5, -1, 0});
  m.add_joint(-1, arm, {0, 0, 0}, true, {normal(kX, kZ), normal(kY, kZ)});
  m.add_joint(arm, slider, {1, 0, 0}, false, {normal(kY, kX), normal(kZ, kX), across(kY), across(kZ)});
  m.add_joint(slider, bob, {2.5, 0, 0}, false, {});
  Joint& rod = m.system.joints.back();
  rod.child_anchor = Vec3::Zero();
  rod.parts.push_back({false, {{Carrier::difference, Carrier::difference, Vec3::Zero(), Vec3::Zero(), 0.5, 0.5}}, 9});
  Force spring{Force::Kind::linear_spring, arm, slider};
  spring.child_point = 0.1 * kY, spring.stiffness = 40, spring.rest = 0.9, spring.damping = 0.3;
  Force torsion{Force::Kind::torsional_spring, m.system.n(), arm};
  torsion.axis = kZ, torsion.normal = kX, torsion.second_normal = kY, torsion.pointer = kX;
  torsion.stiffness = 5, torsion.rest = 0.4, torsion.damping = 0.1;
  Force load{Force::Kind::load, m.system.n(), bob};
  load.child_point = 0.1 * kX, load.force = kZ, load.torque = 0.2 * kY;
  Force follower = load;
  follower.in_world = false;
  m.system.forces = {spring, torsion, load, follower};
  return m;
}

// A hinge, a slide and a ball behind each other, and these as nodes.
Machine tree() {
  Machine m;
  const int arm = m.add_body({0.5, 0, 0}), slider = m.add_body({1.5, 0, 0}), bob = m.add_body({2.5, 0, 0});
  m.add_joint(-1, arm, {0, 0, 0}, true, {normal(kX, kZ), normal(kY, kZ)});
  m.add_joint(arm, slider, {1, 0, 0}, false, {normal(kY, kX), normal(kZ, kX), normal(kZ, kY), across(kY), across(kZ)});
  m.add_joint(slider, bob, {2, 0, 0}, true, {});
  m.system.forces = {sprung().system.forces[0]};
  return m;
}
const std::vector<JointNode> kNodes{{JointNode::Kind::hinge, -1, 0, true, Mat3::Identity(), kZ, 0},
                                    {JointNode::Kind::slide, 0, 1, true, Mat3::Identity(), kX, 0},
                                    {JointNode::Kind::ball, 1, 2, true, Mat3::Identity(), Vec3::Zero(), 0}};

// Two bodies on pins, tied by a spring that twists, under loads.
Machine pins() {
  Machine m;
  const int left = m.add_body({0.5, 0, 0}), right = m.add_body({2.5, 0, 0});
  m.add_joint(-1, left, {0, 0, 0}, true, {}), m.add_joint(-1, right, {2, 0, 0}, true, {});
  Force torsion = sprung().system.forces[1], load{Force::Kind::load, m.system.n(), right};
  torsion.parent = left, torsion.child = right, load.force = kX, load.torque = 0.2 * kZ;
  m.system.forces = {torsion, load};
  return m;
}

// `step`: of the methods with a fixed one, s.
Outcome drive(const Machine& m, const std::string& method, double step, const Record& record) {
  System measured = m.system;
  for (const Body& body : m.system.bodies) measure(measured, body);
  for (const Joint& joint : m.system.joints) measure(measured, joint);
  for (const Force& force : m.system.forces) measure(measured, force);
  Plan plan(measured);
  plan.turns_about_pins = method == "turning";
  const System& system = plan.system;
  const State start = m.start();
  const std::vector<double> steps{step, 2 * step}, t_eval{0, 0.007, 0.013, 0.05};
  const std::vector<std::int64_t> counts{10, 5};
  const Interrupted interrupted = [] { return false; };
  if (method == "seulex") {
    AdaptiveExtrapolation stepper(plan);
    return run_adaptive(stepper, plan, start, t_eval, 1e-6, true, record, interrupted);
  }
  if (method == "taylor" || method == "turning") {
    TaylorStepper stepper(plan);
    return run_adaptive(stepper, plan, start, t_eval, 1e-6, true, record, interrupted);
  }
  // Bogacki and Shampine, doi:10.1016/0893-9659(89)90079-7
  const Tableau rule{{{0.5}, {0, 0.75}}, {2. / 9, 1. / 3, 4. / 9}, 3, {{-5. / 72, 1. / 12, 1. / 9, -1. / 8}}, {}, {}};
  if (method == "rkmk_adaptive") {
    AdaptiveMuntheKaas<BodyChart> stepper(plan, rule);
    return run_adaptive(stepper, plan, start, t_eval, 1e-6, true, record, interrupted);
  }
  if (method == "rkmk_joints_adaptive") {
    AdaptiveMuntheKaas<JointChart> stepper(plan, rule, kNodes);
    return run_adaptive(stepper, plan, start, t_eval, 1e-6, true, record, interrupted);
  }
  if (method == "rkmk_joints_fixed") {
    FixedMuntheKaas<JointChart> stepper(plan, rule, kNodes);
    return run(stepper, plan, start, steps, counts, true, record, interrupted);
  }
  if (method == "rkmk_fixed") {
    FixedMuntheKaas<BodyChart> stepper(plan, rule);
    return run(stepper, plan, start, steps, counts, true, record, interrupted);
  }
  if (method == "generalized_alpha") {
    LagrangeStepper<ExpMap> stepper(plan, GeneralizedAlpha(0.8));
    return run(stepper, plan, start, steps, counts, true, record, interrupted);
  }
  Method euler{method[4] == 'H' ? Formulation::hamilton : Formulation::lagrange, Level::velocity, method[3] == '1'};
  const double a = 1 / (4 - std::cbrt(4.0));
  if (method == "rattle4") euler.composition = {a, a, 1 - 4 * a, a, a};
  if (method[3] == '3') euler.level = Level::position;
  if (method.ends_with("LSE")) euler.level = Level::stabilised;
  if (method == "INDEX1_LE" || method == "BAUMGARTE_LE") euler.level = Level::acceleration;
  if (method == "BAUMGARTE_LE") euler.gains = {5, 5};
  return run_method<ExpMap>(plan, euler, start, steps, counts, true, record, interrupted);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3 || argc > 4) return 1;
  const std::string system = argv[1], method = argv[2];
  const Machine machine = system == "parallelogram"         ? parallelogram()
                          : system == "stiff_parallelogram" ? stiff_parallelogram()
                          : system == "bricard"             ? bricard()
                          : system == "sprung"              ? sprung()
                          : system == "tree"                ? tree()
                          : system == "pins"                ? pins()
                                                            : pendulum(std::stoi(system));
  double sum = 0;
  const Record record = [&](int, const State& state) {
    for (const Frame& frame : state.frames) sum += frame.x.sum();
  };
  const Outcome outcome = drive(machine, method, argc == 4 ? std::stod(argv[3]) : 1e-3, record);
  std::printf("status %d  steps %ld  sum %.9g\n", static_cast<int>(outcome.status), outcome.counters.steps, sum);
}
