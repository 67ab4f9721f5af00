// Python bindings; no mathematics.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <chrono>

#include "adaptive.hpp"
#include "extrapolation.hpp"
#include "rkmk.hpp"
#include "taylor.hpp"

namespace nb = nanobind;
using namespace lieeuler;

using Array = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;

namespace {

nb::object make_array(const std::vector<double>& data, std::initializer_list<size_t> shape) {
  auto* copy = new std::vector<double>(data);
  nb::capsule owner(copy, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
  return nb::cast(nb::ndarray<nb::numpy, double>(copy->data(), shape.size(), shape.begin(), owner));
}

Vec3 vec3(const double* p) { return {p[0], p[1], p[2]}; }
Mat3 mat3(const double* p) { return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(p); }
void put(std::vector<double>& out, size_t at, const Vec3& v) { std::copy_n(v.data(), 3, out.data() + at); }

State make_state(const System& system, const Array& x, const Array& R, const Array& v, const Array& w) {
  State state(system);
  for (int b = 0; b < system.n(); ++b) {
    state.frames[b] = {vec3(x.data() + 3 * b), mat3(R.data() + 9 * b)};
    state.u[b] = {vec3(v.data() + 3 * b), vec3(w.data() + 3 * b)};
  }
  return state;
}

Carrier carrier(const std::string& name) {
  return name == "difference" ? Carrier::difference : (name == "parent" ? Carrier::parent_axis : Carrier::child_axis);
}

// Dot rows are given flat: two carriers and two axes each.
void add_joint(System& system, int parent, int child, const Vec3& parent_anchor, const Vec3& child_anchor,
               bool spherical, const std::vector<std::string>& carriers, const std::vector<Vec3>& axes,
               const std::vector<double>& constants, const std::vector<double>& scales) {
  Joint joint{parent < 0 ? system.n() : parent, child, parent_anchor, child_anchor, {}};
  int row = system.rows();
  auto add_part = [&](bool point) {
    joint.parts.push_back({point, {}, row});
    if (point) row += 3;
  };
  if (spherical) add_part(true);
  for (size_t k = 0; k < constants.size(); ++k, ++row) {
    if (k % 3 == 0) add_part(false);
    joint.parts.back().dots.push_back({carrier(carriers[2 * k]), carrier(carriers[2 * k + 1]), axes[2 * k],
                                       axes[2 * k + 1], constants[k], scales[k]});
  }
  for (const Vec3& s : {parent_anchor, child_anchor}) system.length = std::max(system.length, s.norm());
  system.joints.push_back(joint);
}

void add_linear_spring(System& system, int parent, int child, const Vec3& parent_point, const Vec3& child_point,
                       double stiffness, double free_length, double damping) {
  Force force{Force::Kind::linear_spring, parent < 0 ? system.n() : parent, child};
  force.parent_point = parent_point, force.child_point = child_point;
  force.stiffness = stiffness, force.rest = free_length, force.damping = damping;
  system.forces.push_back(force);
}

// axis, normal, second_normal: right-handed, in the parent; pointer: the normal in the child at angle zero.
void add_torsional_spring(System& system, int parent, int child, const Vec3& axis, const Vec3& normal,
                          const Vec3& second_normal, const Vec3& pointer, double stiffness, double rest_angle,
                          double damping) {
  Force force{Force::Kind::torsional_spring, parent < 0 ? system.n() : parent, child};
  force.axis = axis, force.normal = normal, force.second_normal = second_normal, force.pointer = pointer;
  force.stiffness = stiffness, force.rest = rest_angle, force.damping = damping;
  system.forces.push_back(force);
}

void add_load(System& system, int child, const Vec3& point, const Vec3& value, const Vec3& torque, bool in_world) {
  Force force{Force::Kind::load, system.n(), child};
  force.child_point = point, force.force = value, force.torque = torque, force.in_world = in_world;
  system.forces.push_back(force);
}

const char* name_of(Status status) {
  switch (status) {
    case Status::success: return "success";
    case Status::newton_failed: return "newton_failed";
    case Status::singular_matrix: return "singular_matrix";
    case Status::map_domain: return "map_domain";
    case Status::non_finite: return "non_finite";
    case Status::step_too_small: return "step_too_small";
    case Status::interrupted: return "interrupted";
  }
  return "unknown";
}

struct Samples {
  std::vector<double> x, R, v, w, a, alpha, lam;
  Samples(size_t count, const System& s)
      : x(3 * count * s.n()), R(9 * count * s.n()), v(x), w(x), a(x), alpha(x), lam(count * s.rows()) {}
  void put_state(const System& system, int sample, const State& state) {
    const size_t n = system.n();
    for (size_t b = 0; b < n; ++b) {
      const size_t at = 3 * (sample * n + b);
      put(x, at, state.frames[b].x);
      Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R.data() + 3 * at) = state.frames[b].R;
      put(v, at, state.u[b].v), put(w, at, state.u[b].w), put(a, at, state.a[b].v), put(alpha, at, state.a[b].w);
    }
    std::copy(state.lam.begin(), state.lam.end(), lam.begin() + sample * state.lam.size());
  }
};

// run(record, interrupted) fills an Outcome; the interpreter is free meanwhile.
template <class Run>
nb::dict execute(const System& system, size_t T, const Run& run) {
  Samples samples(T, system);
  const Record record = [&](int k, const State& state) { samples.put_state(system, k, state); };
  const Interrupted interrupted = [] {
    nb::gil_scoped_acquire gil;
    if (PyErr_CheckSignals() == 0) return false;
    PyErr_Clear();
    return true;
  };
  Outcome outcome;
  double seconds;
  {
    nb::gil_scoped_release release;
    const auto start = std::chrono::steady_clock::now();
    outcome = run(record, interrupted);
    seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  const size_t n = system.n(), m = system.rows();
  nb::dict result, counters, maxima;
  result["status"] = name_of(outcome.status);
  result["samples"] = outcome.samples;
  result["time"] = outcome.time_of_failure;
  result["wall_time"] = seconds;
  result["x"] = make_array(samples.x, {T, n, 3});
  result["R"] = make_array(samples.R, {T, n, 3, 3});
  result["v"] = make_array(samples.v, {T, n, 3});
  result["w"] = make_array(samples.w, {T, n, 3});
  result["a"] = make_array(samples.a, {T, n, 3});
  result["alpha"] = make_array(samples.alpha, {T, n, 3});
  result["lam"] = make_array(samples.lam, {T, m});
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

nb::dict integrate(const System& system, const std::string& map, bool hamiltonian, const std::string& level,
                   bool index1_output, double alpha, double beta, const std::vector<double>& composition,
                   const Array& x, const Array& R, const Array& v, const Array& w, const std::vector<double>& steps,
                   const std::vector<int>& counts, bool monitored) {
  const Level levels = level == "position"     ? Level::position
                       : level == "velocity"   ? Level::velocity
                       : level == "stabilised" ? Level::stabilised
                                               : Level::acceleration;
  const Method method{hamiltonian, levels, index1_output, {alpha, beta}, composition};
  const State initial = make_state(system, x, R, v, w);
  return execute(system, steps.size() + 1, [&](const Record& record, const Interrupted& interrupted) {
    const auto run = map == "cayley" ? run_method<CayleyMap> : (map == "ccsk" ? run_method<CcskMap> : run_method<ExpMap>);
    return run(system, method, initial, steps, counts, monitored, record, interrupted);
  });
}

nb::dict integrate_runge_kutta(const System& system, const Tableau& tableau, const Array& x, const Array& R,
                               const Array& v, const Array& w, const std::vector<double>& steps,
                               const std::vector<int>& counts, bool monitored) {
  const State initial = make_state(system, x, R, v, w);
  FixedMuntheKaas stepper(system, tableau);
  return execute(system, steps.size() + 1, [&](const Record& record, const Interrupted& interrupted) {
    return run(stepper, system, initial, steps, counts, monitored, record, interrupted);
  });
}

// t_eval starts at zero.
template <class Stepper>
nb::dict integrate_adaptive(Stepper& stepper, const System& system, const Array& x, const Array& R, const Array& v,
                            const Array& w, const std::vector<double>& t_eval, double rtol, bool monitored) {
  const State initial = make_state(system, x, R, v, w);
  return execute(system, t_eval.size(), [&](const Record& record, const Interrupted& interrupted) {
    return run_adaptive(stepper, system, initial, t_eval, rtol, monitored, record, interrupted);
  });
}

nb::dict integrate_adaptive_runge_kutta(const System& system, const Tableau& tableau, const Array& x, const Array& R,
                                        const Array& v, const Array& w, const std::vector<double>& t_eval, double rtol,
                                        bool monitored) {
  AdaptiveMuntheKaas stepper(system, tableau);
  return integrate_adaptive(stepper, system, x, R, v, w, t_eval, rtol, monitored);
}

template <class Stepper>
nb::dict integrate_adaptive_by(const System& system, const Array& x, const Array& R, const Array& v, const Array& w,
                               const std::vector<double>& t_eval, double rtol, bool monitored) {
  Stepper stepper(system);
  return integrate_adaptive(stepper, system, x, R, v, w, t_eval, rtol, monitored);
}

// Taylor coefficients of x, R and w about a state, order by order, from a stepper's expansion. For tests.
nb::dict taylor_coefficients(const System& system, const Array& x, const Array& R, const Array& v, const Array& w,
                             int order) {
  TaylorStepper stepper(system);
  const Status status = stepper.expand_at(make_state(system, x, R, v, w), order);
  const size_t n = system.n(), count = order + 1;
  std::vector<double> xs(3 * n * count), Rs(9 * n * count), ws(3 * n * count);
  for (size_t k = 0; k < count; ++k)
    for (size_t b = 0; b < n; ++b) {
      const size_t at = k * n + b;
      const auto [position, attitude, rate] = stepper.series().coefficient(static_cast<int>(b), static_cast<int>(k));
      put(xs, 3 * at, position), put(ws, 3 * at, rate);
      Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(Rs.data() + 9 * at) = attitude;
    }
  nb::dict result;
  result["status"] = name_of(status);
  result["x"] = make_array(xs, {count, n, 3});
  result["R"] = make_array(Rs, {count, n, 3, 3});
  result["w"] = make_array(ws, {count, n, 3});
  return result;
}

// Largest entries of Phi and of G u.
std::pair<double, double> constraint_levels(const System& system, const Array& x, const Array& R, const Array& v,
                                            const Array& w) {
  const State state = make_state(system, x, R, v, w);
  double position = 0, velocity = 0;
  for (const Joint& joint : system.joints) {
    JointState here;
    here.update(joint, state.frames);
    for (const Part& part : joint.parts) {
      position = std::max(position, here.position(part).cwiseAbs().maxCoeff());
      velocity = std::max(velocity, here.velocity(part, state.u[joint.parent], state.u[joint.child]).cwiseAbs().maxCoeff());
    }
  }
  return {position, velocity};
}

// Phi, G, gamma, d(G u)/dq and d(gamma)/du of a state, dense; and d(G^T lam)/dq. For tests.
nb::dict constraints(const System& system, const Array& x, const Array& R, const Array& v, const Array& w,
                     const Array& lam) {
  const State state = make_state(system, x, R, v, w);
  const size_t m = system.rows(), columns = 6 * system.n();
  std::vector<double> phi(m), gamma(m), G(m * columns), slope(m * columns), gamma_slope(m * columns),
      K(columns * columns);
  auto put_rows = [&](std::vector<double>& out, const Part& part, int body, const Rows& rows) {
    for (int r = 0; r < part.rows(); ++r)
      for (int c = 0; c < 3; ++c) {
        const size_t at = (part.row + r) * columns + 6 * body + c;
        out[at] = rows.v(r, c), out[at + 3] = rows.w(r, c);
      }
  };
  auto add_block = [&](int row, int column, const Mat3& block) {
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) K[(row + r) * columns + column + c] += block(r, c);
  };
  for (const Joint& joint : system.joints) {
    JointState here;
    here.update(joint, state.frames);
    const Twist &parent = state.u[joint.parent], &child = state.u[joint.child];
    for (const Part& part : joint.parts) {
      const Vec3 position = here.position(part), bias = here.gamma(part, parent, child);
      std::copy_n(position.data(), part.rows(), phi.data() + part.row);
      std::copy_n(bias.data(), part.rows(), gamma.data() + part.row);
      Vec3 multipliers = Vec3::Zero();
      std::copy_n(lam.data() + part.row, part.rows(), multipliers.data());
      for (Side side : kSides) {
        const int body = side == kChild ? joint.child : joint.parent;
        if (body == system.n()) continue;
        put_rows(G, part, body, here.jacobian(part, side));
        put_rows(slope, part, body, here.velocity_slope(part, side, parent, child, false));
        put_rows(gamma_slope, part, body, here.velocity_slope(part, side, parent, child, true));
        for (Side other : kSides) {
          const int column = other == kChild ? joint.child : joint.parent;
          if (column == system.n()) continue;
          const Stiffness block = here.geometric_stiffness(part, side, other, multipliers);
          add_block(6 * body, 6 * column, block.vv), add_block(6 * body, 6 * column + 3, block.vw);
          add_block(6 * body + 3, 6 * column, block.wv), add_block(6 * body + 3, 6 * column + 3, block.ww);
        }
      }
    }
  }
  nb::dict result;
  result["phi"] = make_array(phi, {m});
  result["gamma"] = make_array(gamma, {m});
  result["G"] = make_array(G, {m, columns});
  result["velocity_slope"] = make_array(slope, {m, columns});
  result["gamma_velocity_slope"] = make_array(gamma_slope, {m, columns});
  result["geometric_stiffness"] = make_array(K, {columns, columns});
  return result;
}

// f without -w x J w, its derivatives with respect to q and u, and the energy of springs. For tests.
nb::dict forces(const System& system, const Array& x, const Array& R, const Array& v, const Array& w) {
  const State state = make_state(system, x, R, v, w);
  const size_t columns = 6 * system.n();
  std::vector<double> f(columns), by_q(columns * columns), by_u(columns * columns);
  double potential = 0;
  std::vector<Twist> twists(system.n() + 1);
  applied_forces(system, state.frames, state.u, state.angles, twists);
  for (int b = 0; b < system.n(); ++b) put(f, 6 * b, twists[b].v), put(f, 6 * b + 3, twists[b].w);
  auto add_blocks = [&](std::vector<double>& out, int row, int column, const Stiffness& K) {
    if (row == system.n() || column == system.n()) return;
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) {
        double* at = out.data() + (6 * row + r) * columns + 6 * column + c;
        at[0] += K.vv(r, c), at[3] += K.vw(r, c), at[3 * columns] += K.wv(r, c), at[3 * columns + 3] += K.ww(r, c);
      }
  };
  for (const Force& force : system.forces) {
    const ForceState here(force, state.frames, state.u, 0.0);
    const Linearised slopes = here.linearised();
    potential += here.potential();
    const int bodies[2] = {force.parent, force.child};
    for (Side row : kSides)
      for (Side column : kSides) {
        add_blocks(by_q, bodies[row], bodies[column], slopes.q[row][column]);
        add_blocks(by_u, bodies[row], bodies[column], slopes.u[row][column]);
      }
  }
  nb::dict result;
  result["f"] = make_array(f, {columns});
  result["by_q"] = make_array(by_q, {columns, columns});
  result["by_u"] = make_array(by_u, {columns, columns});
  result["potential"] = potential;
  return result;
}

template <class Map>
nb::dict map_values(const Vec3& xi, const Mat3& J, double h) {
  Map map;
  nb::dict result;
  result["inside"] = map.set(h * xi);
  result["rotation"] = Mat3(map.rotation());
  result["left_tangent"] = Mat3(map.left_tangent());
  result["momentum"] = Vec3(map.momentum(J * xi));
  result["momentum_slope"] = Mat3(map.momentum_slope(xi, J * xi, J, h));
  return result;
}

}  // namespace

NB_MODULE(_kernel, m) {
  nb::class_<System>(m, "System")
      .def("__init__",
           [](System* self, const std::vector<double>& masses, const std::vector<Mat3>& inertias, const Vec3& gravity) {
             new (self) System{{}, {}, {}, gravity};
             for (size_t b = 0; b < masses.size(); ++b)
               self->bodies.push_back({masses[b], inertias[b], inertias[b].inverse()});
           })
      .def("set_spin", [](System& system, int body, const Vec3& spin) { system.bodies[body].spin = spin; })
      .def("add_joint", &add_joint)
      .def("add_linear_spring", &add_linear_spring)
      .def("add_torsional_spring", &add_torsional_spring)
      .def("add_load", &add_load)
      .def_prop_ro("rows", &System::rows);
  using TableauRows = std::vector<std::vector<double>>;
  nb::class_<Tableau>(m, "Tableau")
      .def("__init__", [](Tableau* self, const TableauRows& stages, const std::vector<double>& weights, int order,
                          const TableauRows& errors, const TableauRows& extra, const TableauRows& dense) {
        new (self) Tableau{stages, weights, order, errors, extra, dense};
      });
  m.def("integrate", &integrate);
  m.def("integrate_runge_kutta", &integrate_runge_kutta);
  m.def("integrate_adaptive_runge_kutta", &integrate_adaptive_runge_kutta);
  m.def("integrate_seulex", &integrate_adaptive_by<AdaptiveExtrapolation>);
  m.def("integrate_taylor", &integrate_adaptive_by<TaylorStepper>);
  m.def("taylor_coefficients", &taylor_coefficients);
  m.def("constraints", &constraints);
  m.def("constraint_levels", &constraint_levels);
  m.def("forces", &forces);
  m.def("map_values", [](const std::string& map, const Vec3& xi, const Mat3& J, double h) {
    return map == "cayley" ? map_values<CayleyMap>(xi, J, h)
                           : (map == "ccsk" ? map_values<CcskMap>(xi, J, h) : map_values<ExpMap>(xi, J, h));
  });
}
