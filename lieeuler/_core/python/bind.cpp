// Python bindings; no mathematics.
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "python/building.hpp"
#include "python/run.hpp"

using namespace lieeuler;

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
  nb::enum_<Correction>(m, "Correction").value("mass", Correction::mass).value("plain", Correction::plain);
  nb::class_<Method>(m, "Method")
      .def(
          "__init__",
          [](Method* self, Formulation formulation, Level level, bool index1_output, double alpha, double beta,
             const std::vector<double>& composition, std::optional<double> spectral_radius, bool polish,
             Correction correction) {
            require(!spectral_radius || (*spectral_radius >= 0 && *spectral_radius <= 1),
                    "the spectral radius lies between 0 and 1");
            new (self) Method{formulation, level,           index1_output, {alpha, beta},
                              composition, spectral_radius, polish,        correction};
          },
          nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().none(), nb::arg(), nb::arg());
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
        f.expand({t}, count, coefficients.data());
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
      .def("add_slide_force", &add_slide_force)
      .def("add_own_force", &add_own_force);
  nb::class_<Plan>(m, "Plan")
      .def(nb::init<System>())
      .def_rw("turns_about_pins", &Plan::turns_about_pins)
      .def_prop_ro("length", [](const Plan& plan) { return plan.system.length; })
      .def("natural_rate", [](const Plan& plan, double length) { return Scales{length}.natural(plan.system); })
      .def_prop_ro("angles", [](const Plan& plan) { return plan.system.forces.size(); });
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
  nb::enum_<JointNode::Kind>(m, "JointNodeKind")
      .value("hinge", JointNode::Kind::hinge)
      .value("slide", JointNode::Kind::slide)
      .value("ball", JointNode::Kind::ball);
  nb::class_<Run>(m, "Run")
      .def("start_from",
           [](Run& run, const Plan& plan, const Array& t, const Array& x, const Array& R, const Array& v,
              const Array& w) {
             require(t.size() == run.samples, "a time for every sample");
             run.t.assign(t.data(), t.data() + t.size());
             run.initial = make_state(plan.system, x, R, v, w);
             run.initial->frames.time = run.t.front();
           })
      .def_prop_ro("knows_joints", [](const Run& run) { return bool(run.by_joints); })
      .def_rw("fewer_rows", &Run::fewer_rows)
      .def_rw("held", &Run::held)
      .def("add_reduction",
           [](Run& run, const Mat3& world, const std::vector<int>& carriers, const std::vector<Vec3>& centres,
              const std::vector<double>& heights, const std::vector<Mat3>& turns, const std::vector<Vec3>& spins,
              const std::vector<double>& angles) {
             const size_t n = carriers.size();
             require(centres.size() == n && heights.size() == n && turns.size() == n && spins.size() == n,
                     "every body needs a carrier, a centre, a height, a turn and a spin");
             Reduction made{world, {}, angles};
             for (size_t b = 0; b < n; ++b) {
               require(carriers[b] >= 0, "carriers are bodies");
               made.bodies.push_back({carriers[b], centres[b], heights[b], turns[b], spins[b]});
             }
             run.reductions.push_back(made);
           })
      .def("add_node", [](Run& run, JointNode::Kind kind, int parent, int joint, bool last, const Mat3& turn,
                          const Vec3& axis, double armature) {
        require(run.by_joints && parent < static_cast<int>(run.nodes.size()), "parents come before their children");
        run.nodes.push_back({kind, parent, joint, last, turn, axis, armature});
      });
  bind_implicit(m);
  bind_index1(m);
}
