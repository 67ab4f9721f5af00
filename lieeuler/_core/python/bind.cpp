// Python bindings; no mathematics.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <chrono>

#include "methods/extrapolation.hpp"
#include "methods/rkmk.hpp"
#include "methods/taylor.hpp"
#include "model/sizes.hpp"
#include "python/arrays.hpp"
#include "python/levels.hpp"
#include "python/multipliers.hpp"
#include "python/probes.hpp"
#include "run/adaptive.hpp"
#include "run/ensemble.hpp"

using namespace lieeuler;

namespace {

// The parent's index in the kernel, where the ground comes after the bodies.
int parent_of(const System& system, int parent, int child) {
  const int n = system.n();
  require(0 <= child && child < n && -1 <= parent && parent < n && parent != child, "there are no such two bodies");
  return parent < 0 ? n : parent;
}

// Dot rows are given flat: two carriers and two axes each.
void add_joint(System& system, int parent, int child, const Vec3& parent_anchor, const Vec3& child_anchor,
               bool spherical, const std::vector<Carrier>& carriers, const std::vector<Vec3>& axes,
               const std::vector<double>& constants, const std::vector<double>& scales) {
  const size_t dots = constants.size();
  require(axes.size() == 2 * dots && carriers.size() == 2 * dots && scales.size() == dots,
          "dot rows need two carriers, two axes, a constant and a scale each");
  Joint joint{parent_of(system, parent, child), child, parent_anchor, child_anchor, {}};
  int row = system.rows();
  auto add_part = [&](bool point) {
    joint.parts.push_back({point, {}, row});
    if (point) row += 3;
  };
  if (spherical) add_part(true);
  for (size_t k = 0; k < dots; ++k, ++row) {
    if (k % 3 == 0) add_part(false);
    joint.parts.back().dots.push_back(
        {carriers[2 * k], carriers[2 * k + 1], axes[2 * k], axes[2 * k + 1], constants[k], scales[k]});
  }
  system.joints.push_back(joint);
  measure(system, joint);
}

// A joint's angle about its axis, or its slide along it, as a row of its own.
Part coordinate_part(bool turns, const Vec3& parent_axis, const Vec3& child_axis, const Vec3& normal,
                     const Vec3& second_normal, const Vec3& pointer, int row) {
  const DotRow slide{Carrier::parent_axis, Carrier::difference, parent_axis};
  const DotRow unused{Carrier::parent_axis, Carrier::child_axis, parent_axis, child_axis};
  Part part{false, {turns ? unused : slide}, row};
  if (turns) part.turn = Turn{parent_axis, child_axis, normal, second_normal, pointer};
  return part;
}

// Adds a row to the last joint: its angle about the axis, or its slide along it, is a function of time.
void drive_joint(System& system, bool turns, const Vec3& parent_axis, const Vec3& child_axis, const Vec3& normal,
                 const Vec3& second_normal, const Vec3& pointer, const TimeFunction& drive) {
  require(!system.joints.empty() && !system.joints.back().driven, "there is no joint to drive");
  Joint& joint = system.joints.back();
  Part part = coordinate_part(turns, parent_axis, child_axis, normal, second_normal, pointer, system.rows());
  part.drive = drive;
  joint.parts.push_back(part), joint.driven = true;
}

// The height and the slip of a contact with a plane of the ground, for the joint added last.
void add_contact(System& system, Contact::Kind kind, const Vec3& normal, const Vec3& axis, double radius,
                 const std::vector<Vec3>& across) {
  require(!system.joints.empty() && system.joints.back().parent == system.n(), "a contact is one with the ground");
  require(!across.empty() && across.size() <= 3, "a contact needs directions of slip");
  Joint& joint = system.joints.back();
  for (const std::vector<Vec3>& directions : {std::vector<Vec3>{normal}, across}) {
    Part part{false, {}, system.rows()};
    for (const Vec3& direction : directions)
      part.dots.push_back({Carrier::parent_axis, Carrier::difference, direction});
    part.contact = Contact{kind, normal, axis, radius};
    part.slips = !joint.parts.empty();
    joint.parts.push_back(part);
  }
  measure(system, joint);
}

// Makes the angle or the slide of the joint added last follow that of another joint, which add_leader() names.
void follow(System& system, bool turns, const Vec3& parent_axis, const Vec3& child_axis, const Vec3& normal,
            const Vec3& second_normal, const Vec3& pointer, double ratio, double offset) {
  require(!system.joints.empty() && !system.joints.back().follows, "there is no joint to follow another");
  Joint& joint = system.joints.back();
  Part part = coordinate_part(turns, parent_axis, child_axis, normal, second_normal, pointer, system.rows());
  part.mimic = static_cast<int>(system.mimics.size());
  system.mimics.push_back({ratio, offset, turns});
  joint.parts.push_back(part), ++joint.others, joint.follows = true;
}

// Names the angle or slide that the mimic follows; call it after all joints and forces are added.
void add_leader(System& system, int mimic, int joint, bool turns, const Vec3& parent_axis, const Vec3& child_axis,
                const Vec3& normal, const Vec3& second_normal, const Vec3& pointer) {
  require(0 <= mimic && mimic < static_cast<int>(system.mimics.size()) && 0 <= joint &&
              joint < static_cast<int>(system.joints.size()),
          "a leader needs a joint and a follower");
  Part part =
      coordinate_part(turns, parent_axis, child_axis, normal, second_normal, pointer, system.rows() + system.others());
  part.mimic = mimic;
  Joint& leader = system.joints[joint];
  leader.parts.push_back(part), ++leader.others;
  if (!turns) return;
  Force watched{Force::Kind::torsional_spring, leader.parent, leader.child};
  watched.axis = parent_axis, watched.normal = normal, watched.second_normal = second_normal;
  watched.pointer = pointer;
  system.mimics[mimic].angle = static_cast<int>(system.forces.size());
  system.forces.push_back(watched);
}

// Adds a rotor on a joint's angle or slide; call it after all joints are added.
void add_rotor(System& system, int joint, double inertia, bool turns, const Vec3& parent_axis, const Vec3& child_axis,
               const Vec3& normal, const Vec3& second_normal, const Vec3& pointer) {
  require(0 <= joint && joint < static_cast<int>(system.joints.size()) && inertia > 0,
          "a rotor needs a joint and mass");
  Part part =
      coordinate_part(turns, parent_axis, child_axis, normal, second_normal, pointer, system.rows() + system.others());
  part.compliance = 1 / inertia;
  system.joints[joint].parts.push_back(part), ++system.joints[joint].others;
}

void add_force(System& system, const Force& force) {
  system.forces.push_back(force);
  measure(system, force);
}

void add_linear_spring(System& system, int parent, int child, const Vec3& parent_point, const Vec3& child_point,
                       double stiffness, double free_length, double damping) {
  Force force{Force::Kind::linear_spring, parent_of(system, parent, child), child};
  force.parent_point = parent_point, force.child_point = child_point;
  force.stiffness = stiffness, force.rest = free_length, force.damping = damping;
  add_force(system, force);
}

// axis, normal, second_normal: right-handed, in the parent; pointer: the normal in the child at angle zero.
void add_torsional_spring(System& system, int parent, int child, const Vec3& axis, const Vec3& normal,
                          const Vec3& second_normal, const Vec3& pointer, double stiffness, double rest_angle,
                          double damping, const std::optional<TimeFunction>& torque) {
  Force force{Force::Kind::torsional_spring, parent_of(system, parent, child), child};
  force.axis = axis, force.normal = normal, force.second_normal = second_normal, force.pointer = pointer;
  force.stiffness = stiffness, force.rest = rest_angle, force.damping = damping, force.drive = torque;
  add_force(system, force);
}

void add_slide_force(System& system, int parent, int child, const Vec3& parent_anchor, const Vec3& child_anchor,
                     const Vec3& axis, const TimeFunction& size) {
  Force force{Force::Kind::slide_force, parent_of(system, parent, child), child};
  force.parent_point = parent_anchor, force.child_point = child_anchor, force.axis = axis, force.drive = size;
  add_force(system, force);
}

void add_load(System& system, int child, const Vec3& point, const Vec3& value, const Vec3& torque, bool in_world,
              const std::optional<TimeFunction>& factor) {
  Force force{Force::Kind::load, parent_of(system, -1, child), child};
  force.child_point = point, force.force = value, force.torque = torque, force.in_world = in_world;
  force.drive = factor;
  add_force(system, force);
}

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
bool ctrl_c() {
  nb::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() == 0) return false;
  if (!PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) nb::raise_python_error();  // from the user's signal handler
  PyErr_Clear();
  return true;
}

nb::dict integrate(const Plan& plan, const Run& method, const Array& x, const Array& R, const Array& v,
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
    outcome = method.run(plan, initial, record, ctrl_c);
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
nb::dict integrate_ensemble(const std::vector<const Plan*>& plans, const Run& method, const Array& x, const Array& R,
                            const Array& v, const Array& w, int threads) {
  require(!plans.empty() && threads > 0, "an ensemble needs a system and a thread");
  const size_t T = method.samples, n = plans[0]->system.n(), N = x.size() / (3 * n);
  require(plans.size() == 1 || plans.size() == N, "one system, or one for each member");
  for (const Plan* plan : plans) require(plan->system.n() == static_cast<int>(n), "systems of equal size");
  const double nothing = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> xs(N * T * n * 3, nothing), Rs(N * T * n * 9, nothing), vs(xs), ws(xs), times(N, 0.0);
  std::vector<Status> statuses(N, Status::interrupted);
  std::vector<std::int64_t> steps(N, 0), rejected(N, 0);
  auto member = [&](size_t k, const Interrupted& stopped) {
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
    const Outcome outcome = method.run(plan, initial, record, stopped);
    statuses[k] = outcome.status, times[k] = outcome.time_reached;
    steps[k] = outcome.counters.steps, rejected[k] = outcome.counters.rejected_steps;
  };
  bool interrupted;
  double seconds;
  {
    nb::gil_scoped_release release;
    const auto start = std::chrono::steady_clock::now();
    interrupted = on_threads(N, threads, ctrl_c, member);
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
  result["interrupted"] = interrupted;
  result["wall_time"] = seconds;
  return result;
}

void require_steps(const std::vector<double>& steps, const std::vector<std::int64_t>& counts) {
  require(!steps.empty() && steps.size() == counts.size(), "every interval has a step and a count");
  for (size_t k = 0; k < steps.size(); ++k)
    require(std::isfinite(steps[k]) && steps[k] > 0 && counts[k] > 0, "every interval needs steps that advance");
}

Run implicit(CoordinateMap map, const Method& method, const std::vector<double>& steps,
             const std::vector<std::int64_t>& counts, bool monitored) {
  require_steps(steps, counts);
  return {[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            return run_method(map, plan, method, initial, steps, counts, monitored, record, interrupted);
          },
          steps.size() + 1};
}

Run runge_kutta(const Tableau& tableau, const std::vector<double>& steps, const std::vector<std::int64_t>& counts,
                bool monitored) {
  require_steps(steps, counts);
  return {[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            FixedMuntheKaas stepper(plan, tableau);
            return run(stepper, plan, initial, steps, counts, monitored, record, interrupted);
          },
          steps.size() + 1};
}

// t_eval starts at zero.
template <class Stepper, class... Arguments>
Run adaptive(const std::vector<double>& t_eval, double rtol, bool monitored, const Arguments&... arguments) {
  require(t_eval.size() > 1 && std::isfinite(t_eval.front()) && std::isfinite(t_eval.back()) && rtol > 0 && rtol < 1 &&
              std::adjacent_find(
                  t_eval.begin(), t_eval.end(), [](double a, double b) { return !(a < b); }) == t_eval.end(),
          "output times must increase, and the tolerance lie between 0 and 1");
  return {[=](const Plan& plan, const State& initial, const Record& record, const Interrupted& interrupted) {
            Stepper stepper(plan, arguments...);
            return run_adaptive(stepper, plan, initial, t_eval, rtol, monitored, record, interrupted);
          },
          t_eval.size()};
}

Run adaptive_runge_kutta(const Tableau& tableau, const std::vector<double>& t_eval, double rtol, bool monitored,
                         bool conserves) {
  return adaptive<AdaptiveMuntheKaas>(t_eval, rtol, monitored, tableau, conserves);
}

}  // namespace

NB_MODULE(_kernel, m) {
  // Objects that Python has not freed at exit are no leaks, such as the system of a cached Problem. Real leaks are the
  // subject of test_repeated_runs.py.
  nb::set_leak_warnings(false);
  nb::enum_<Carrier>(m, "Carrier")
      .value("difference", Carrier::difference)
      .value("parent", Carrier::parent_axis)
      .value("child", Carrier::child_axis);
  nb::enum_<Contact::Kind>(m, "ContactKind")
      .value("edge", Contact::Kind::edge)
      .value("disk", Contact::Kind::disk)
      .value("sphere", Contact::Kind::sphere);
  nb::enum_<CoordinateMap>(m, "CoordinateMap")
      .value("exp", CoordinateMap::exp)
      .value("cayley", CoordinateMap::cayley)
      .value("ccsk", CoordinateMap::ccsk);
  nb::enum_<Formulation>(m, "Formulation")
      .value("lagrange", Formulation::lagrange)
      .value("hamilton", Formulation::hamilton);
  nb::enum_<Level>(m, "Level")
      .value("position", Level::position)
      .value("velocity", Level::velocity)
      .value("stabilised", Level::stabilised)
      .value("acceleration", Level::acceleration);
  nb::class_<Method>(m, "Method")
      .def(
          "__init__",
          [](Method* self, Formulation formulation, Level level, bool index1_output, double alpha, double beta,
             const std::vector<double>& composition, std::optional<double> spectral_radius, bool polish) {
            require(!spectral_radius || (*spectral_radius >= 0 && *spectral_radius <= 1),
                    "the spectral radius lies between 0 and 1");
            new (self) Method{formulation, level, index1_output, {alpha, beta}, composition, spectral_radius, polish};
          },
          nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().none(), nb::arg());
  nb::class_<TimeFunction>(m, "TimeFunction")
      .def("__init__",
           [](TimeFunction* self, const std::vector<double>& breaks, const std::vector<std::vector<double>>& pieces,
              const std::vector<std::vector<double>>& terms) {
             require(!breaks.empty() && breaks.size() == pieces.size(), "every piece needs a break");
             new (self) TimeFunction{breaks, pieces, {}};
             for (const std::vector<double>& piece : pieces) require(!piece.empty(), "a piece needs a coefficient");
             for (const std::vector<double>& term : terms) {
               require(term.size() == 3, "a sine has an amplitude, a frequency and a phase");
               self->sines.push_back({term[0], term[1], term[2]});
             }
           })
      .def("expand", [](const TimeFunction& f, double t, int count) {
        require(count > 0, "a series has a coefficient");
        std::vector<double> coefficients(count);
        f.expand(t, count, coefficients.data());
        return coefficients;
      });
  nb::class_<System>(m, "System")
      .def("__init__",
           [](System* self, const std::vector<double>& masses, const std::vector<Mat3>& inertias, const Vec3& gravity) {
             require(masses.size() == inertias.size(), "every body needs a mass and an inertia");
             new (self) System{{}, {}, {}, gravity};
             for (size_t b = 0; b < masses.size(); ++b) {
               self->bodies.emplace_back(masses[b], inertias[b]);
               measure(*self, self->bodies.back());
             }
           })
      .def("set_spin",
           [](System& system, int body, const Vec3& spin) {
             parent_of(system, -1, body);
             system.bodies[body].spin = spin;
           })
      .def("add_joint", &add_joint)
      .def("drive_joint", &drive_joint)
      .def("add_contact", &add_contact)
      .def("follow", &follow)
      .def("add_leader", &add_leader)
      .def("add_rotor", &add_rotor)
      .def("add_linear_spring", &add_linear_spring)
      .def("add_torsional_spring", &add_torsional_spring, nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(),
           nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().none())
      .def("add_load", &add_load, nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().none())
      .def("add_slide_force", &add_slide_force);
  nb::class_<Plan>(m, "Plan")
      .def(nb::init<System>())
      .def_prop_ro("length", [](const Plan& plan) { return plan.system.length; })
      .def("natural_rate", [](const Plan& plan, double length) { return Scales{length}.natural(plan.system); });
  using TableauRows = std::vector<std::vector<double>>;
  nb::class_<Tableau>(m, "Tableau")
      .def("__init__", [](Tableau* self, const TableauRows& stages, const std::vector<double>& weights, int order,
                          const TableauRows& errors, const TableauRows& extra, const TableauRows& dense) {
        const size_t count = stages.size() + 1, inside = count + 1 + extra.size();
        auto at_most = [](const TableauRows& rows, size_t first, size_t growth) {
          for (size_t k = 0; k < rows.size(); ++k)
            require(rows[k].size() <= first + k * growth, "a row of the tableau weighs a stage it cannot know");
        };
        at_most(stages, 1, 1), at_most({weights}, count, 0), at_most(errors, count + 1, 0);
        at_most(extra, count + 1, 1), at_most(dense, inside, 0);
        new (self) Tableau{stages, weights, order, errors, extra, dense};
      });
  nb::class_<Run>(m, "Run").def_rw("begin", &Run::begin);
  m.def("implicit", &implicit);
  m.def("runge_kutta", &runge_kutta);
  m.def("adaptive_runge_kutta", &adaptive_runge_kutta);
  m.def("seulex", &adaptive<AdaptiveExtrapolation>);
  m.def("taylor", &adaptive<TaylorStepper, bool>);
  m.def("integrate", &integrate);
  m.def("integrate_ensemble", &integrate_ensemble);
  m.def("taylor_coefficients", &taylor_coefficients);
  m.def("project", &project);
  m.def("constraints", &constraints);
  m.def("constraint_levels", &levels_of_states);
  m.def("multipliers", &multipliers);
  m.def("forces", &forces);
  m.def("map_values", [](CoordinateMap map, const Vec3& xi, const Mat3& J, double h) {
    return map == CoordinateMap::exp      ? map_values<ExpMap>(xi, J, h)
           : map == CoordinateMap::cayley ? map_values<CayleyMap>(xi, J, h)
                                          : map_values<CcskMap>(xi, J, h);
  });
}
