// The mechanical system, constant during a run, its configuration, and the sizes of both: (1.1) to (1.3) of
// docs/theory.md.
#pragma once

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <optional>
#include <span>
#include <vector>

#include "model/so3.hpp"
#include "model/time_function.hpp"

namespace lieeuler {

// Principal moments, the least first.
inline Vec3 principal_moments(const Mat3& inertia) {
  return Eigen::SelfAdjointEigenSolver<Mat3>(inertia, Eigen::EigenvaluesOnly).eigenvalues();
}

// J - s I, with s the middle principal moment of J. w x (J w) does not depend on s, and keeps its digits where large
// entries would cancel: for a needle or a disk.
inline Mat3 deviation(const Mat3& inertia) { return inertia - principal_moments(inertia)[1] * Mat3::Identity(); }

struct Body {
  double mass;
  Mat3 inertia, inertia_inverse;  // about the centre of mass, body axes
  Mat3 inertia_deviation;
  Vec3 moments;              // principal, the least first
  Vec3 spin = Vec3::Zero();  // constant angular momentum inside the body, body axes; its torque is -w x spin

  Body(double mass, const Mat3& inertia)
      : mass(mass),
        inertia(inertia),
        inertia_inverse(inertia.inverse()),
        inertia_deviation(deviation(inertia)),
        moments(principal_moments(inertia)) {}
};

// Position of the centre of mass (world) and attitude (body to world).
struct Frame {
  Vec3 x = Vec3::Zero();
  Mat3 R = Mat3::Identity();
};

// Where all bodies are, the ground last, and when.
struct Configuration : std::vector<Frame>, Moment {
  using std::vector<Frame>::vector;
  double lost = 0;  // rounding error of the time, s, which would accumulate over a million steps

  // Sets the time to h after `before`, in the same step.
  void follow(const Configuration& before, double h) {
    const double way = h - before.lost;
    time = before.time + way;
    lost = (time - before.time) - way;
    from = before.from, to = before.to;
  }
};

// Quasi-velocities of one body: v of the centre of mass (world), w (body axes). Also used for accelerations,
// forces and momenta.
struct Twist {
  Vec3 v = Vec3::Zero(), w = Vec3::Zero();

  Twist& operator+=(const Twist& other) { return v += other.v, w += other.w, *this; }
  Twist& operator-=(const Twist& other) { return v -= other.v, w -= other.w, *this; }
};
inline Twist operator+(const Twist& a, const Twist& b) { return {a.v + b.v, a.w + b.w}; }
inline Twist operator-(const Twist& a, const Twist& b) { return {a.v - b.v, a.w - b.w}; }
inline Twist operator*(double s, const Twist& a) { return {s * a.v, s * a.w}; }
inline Twist operator/(const Twist& a, double s) { return {a.v / s, a.w / s}; }

// Six values a body.
inline double* flat(std::vector<Twist>& twists) {
  static_assert(sizeof(Twist) == 6 * sizeof(double));
  return twists.data()->v.data();
}

// A vector in the world that moves with the two bodies of a joint: an axis fixed in one of them, or the difference d
// of the two anchors. Every constraint is the product of two of these (or, for the spherical joint, d itself).
enum class Carrier { difference, parent_axis, child_axis };

// One scalar constraint  scale * A . B - constant = 0  (dot-1, dot-2 and distance after Haug).
struct DotRow {
  Carrier a, b;
  Vec3 a_local = Vec3::Zero(), b_local = Vec3::Zero();  // axes, in the frame of their body
  double constant = 0, scale = 1;
};

// The angle of a joint about its axis, which is given in both bodies and kept together by the joint's other rows. It is
// the child's rotation relative to the parent: zero when `pointer`, fixed in the child, lies on the parent's normal.
struct Turn {
  Vec3 parent_axis, child_axis, normal, second_normal, pointer;
};

// Where a body touches a plane of the ground: a blade's point, the lowest of a disk's rim, or that of a sphere.
struct Contact {
  enum class Kind { edge, disk, sphere } kind;
  Vec3 normal, axis;  // of the plane, world; of the blade or the disk, in the body
  double radius;      // 0 of a blade
};

// Up to three rows of a joint that are evaluated and solved for together: a spherical constraint, dot rows, or a single
// row for an angle or a slide. That single row is coordinate - drive(t) = 0, or the row of a rotor. A contact has a
// part for its height and one for its slip, whose rows hold velocities only: A(q) u = 0. A rotor is a row with the
// compliance 1 / I, equation (17.2) of docs/theory.md.
struct Part {
  bool spherical;
  std::vector<DotRow> dots;  // for a turn, one row that is not used
  int row;                   // index of the first row in lam
  std::optional<Turn> turn = {};
  std::optional<TimeFunction> drive = {};
  double compliance = 0;                // 1 / I of a rotor, 0 of a constraint
  std::optional<Contact> contact = {};  // a_local of its dots are the directions of its rows
  bool slips = false;                   // Phi says nothing about them
  int mimic = -1;                       // among those of the system, of a follower and its leader
  int rows() const { return spherical ? 3 : static_cast<int>(dots.size()); }
  // Whether a row, or any row, depends on the positions of the bodies and not only on their attitudes.
  bool translational(int row) const {
    return spherical || dots[row].a == Carrier::difference || dots[row].b == Carrier::difference;
  }
  bool translational() const {
    for (int r = 0; r < rows(); ++r)
      if (translational(r)) return true;
    return false;
  }
};

// One coordinate follows another: row of the follower - ratio row of the leader - offset = 0. A part has two bodies, so
// that a mimic takes two parts, with the leader's rate as one more unknown: equation (19.2) of docs/theory.md.
struct Mimic {
  double ratio, offset;
  bool turns;      // the follower does
  int angle = -1;  // force without stiffness whose angle is the leader's, unwrapped; none of a slide
};

struct Joint {
  int parent, child;  // parent == number of bodies: the ground
  Vec3 parent_anchor, child_anchor;
  std::vector<Part> parts;
  bool driven = false;   // its last constraint has a drive
  int others = 0;        // followers, leaders and rotors among its parts, the last ones
  bool follows = false;  // one of these is a follower, whose row is the last of the joint

  std::span<const Part> constraints() const { return {parts.data(), parts.size() - others}; }
};

// A part of a joint. Parts are numbered through all joints.
struct PlacedPart {
  int joint, bodies[2];  // parent and child
  const Part* part;
};

// A spring-damper or a load. parent == number of bodies: the ground.
struct Force {
  enum class Kind {
    linear_spring,
    torsional_spring,
    load,
    slide_force,
    own
  };  // own: couples two bodies of an OwnForce
  Kind kind;
  int parent, child;
  // Linear spring, slide force, load: from the centres of mass.
  Vec3 parent_point = Vec3::Zero(), child_point = Vec3::Zero();
  double stiffness = 0, rest = 0, damping = 0;  // rest: free length, slide at rest (m) or rest angle (rad)
  // Torsional spring: axis and two normals in the parent; pointer is the first normal in the child at angle zero.
  Vec3 axis = Vec3::Zero(), normal = Vec3::Zero(), second_normal = Vec3::Zero(), pointer = Vec3::Zero();
  // Load on the child: constant in the world or in the body.
  Vec3 force = Vec3::Zero(), torque = Vec3::Zero();
  bool in_world = true;
  // The factor of a load, the torque of a torsional spring on the child, or the size of a slide force along the axis.
  std::optional<TimeFunction> drive = {};
};

// A force of the user's own on all n bodies: writes force (world) and torque (body axes) of each, (n, 6), for their
// x (n, 3), R (n, 3, 3) by rows, v (n, 3) and w (n, 3) at a time, s.
struct OwnForce {
  using Function = void (*)(double t, int n, const double* x, const double* R, const double* v, const double* w,
                            double* out, void* user);
  Function function;
  void* user;
};

struct System {
  std::vector<Body> bodies;
  std::vector<Joint> joints;
  std::vector<Force> forces;
  Vec3 gravity;
  std::vector<Mimic> mimics = {};
  std::vector<OwnForce> own = {};
  // Sizes, computed by `measure` from bodies, joints and forces.
  double length = 0;                                  // m
  double acceleration = 0, angular_acceleration = 0;  // by loads
  double frequency = 0;                               // of the fastest spring or damper, 1/s

  int n() const { return static_cast<int>(bodies.size()); }
  // Number of constraint rows; the multipliers of rotors and leaders come after theirs.
  int rows() const {
    int total = 0;
    for (const Joint& joint : joints) {
      total += joint.follows;
      for (const Part& part : joint.constraints()) total += part.rows();
    }
    return total;
  }
  int others() const {
    int total = 0;
    for (const Joint& joint : joints) total += joint.others - joint.follows;
    return total;
  }
  int parts() const {
    int total = 0;
    for (const Joint& joint : joints) total += static_cast<int>(joint.parts.size());
    return total;
  }
  // Whether a body turns `ratio` times more easily than it translates at a joint, or about one axis than about another,
  // like a needle, a wire or a point mass. G M^-1 G^T then loses twice as many digits.
  bool thin(double ratio = 1e3) const {
    const auto stretched = [&](const Body& body, double most) { return most > ratio * body.moments[0]; };
    const auto turns_easily = [&](int b, const Vec3& arm) {
      return b != n() && stretched(bodies[b], bodies[b].mass * arm.squaredNorm());
    };
    return std::any_of(bodies.begin(), bodies.end(),
                       [&](const Body& body) { return stretched(body, body.moments[2]); }) ||
           std::any_of(joints.begin(), joints.end(), [&](const Joint& joint) {
             return turns_easily(joint.parent, joint.parent_anchor) || turns_easily(joint.child, joint.child_anchor);
           });
  }
  bool damped() const {
    return std::any_of(forces.begin(), forces.end(), [](const Force& force) { return force.damping != 0; });
  }
  // Where a step that begins at t has to end: series and error estimates are not valid across a break.
  double next_break(double t, double end) const {
    for (const Force& force : forces)
      if (force.drive) end = force.drive->next_break(t, end);
    for (const Joint& joint : joints)
      if (joint.driven) end = joint.constraints().back().drive->next_break(t, end);
    return end;
  }
  // Where accelerations jump, sorted: forces do, or up to the second derivatives of what drives joints.
  std::vector<double> jumps() const {
    std::vector<double> all;
    for (const Force& force : forces)
      if (force.drive) force.drive->append_jumps(0, all);
    for (const Joint& joint : joints)
      if (joint.driven) joint.constraints().back().drive->append_jumps(2, all);
    std::sort(all.begin(), all.end());
    return all;
  }
  // Whether a light body may carry a heavy one, whose part of G M^-1 G^T then loses three digits or more.
  bool graded(double ratio = 1e3) const {
    const auto [least, most] =
        std::minmax_element(bodies.begin(), bodies.end(), [](const Body& a, const Body& b) { return a.mass < b.mass; });
    return least != bodies.end() && most->mass > ratio * least->mass;
  }
};

// (m, J) times a twist, and its inverse.
inline Twist momentum(const Body& body, const Twist& u) { return {body.mass * u.v, times(body.inertia, u.w)}; }
inline Twist velocity(const Body& body, const Twist& p) { return {p.v / body.mass, times(body.inertia_inverse, p.w)}; }

// J w + spin, body axes.
inline Vec3 angular_momentum(const Body& body, const Vec3& w) { return times(body.inertia, w) + body.spin; }

// -w x (J w + spin)
inline Vec3 gyroscopic_torque(const Body& body, const Vec3& w) {
  return (times(body.inertia_deviation, w) + body.spin).cross(w);
}

// p = M u with the spin included, and its inverse.
inline Twist canonical_momentum(const Body& body, const Twist& u) {
  return {body.mass * u.v, angular_momentum(body, u.w)};
}
inline Twist velocity_of(const Body& body, const Twist& p) {
  return {p.v / body.mass, times(body.inertia_inverse, p.w - body.spin)};
}

enum Side { kParent = 0, kChild = 1 };
inline constexpr Side kSides[2] = {kParent, kChild};
constexpr Side opposite(Side side) { return side == kChild ? kParent : kChild; }

// Three rows with respect to the quasi-velocities of one body.
struct Rows {
  Mat3 v = Mat3::Zero(), w = Mat3::Zero();
};
// A block of second derivatives: rows (v, w) of one body, columns of another.
struct Stiffness {
  Mat3 vv = Mat3::Zero(), vw = Mat3::Zero(), wv = Mat3::Zero(), ww = Mat3::Zero();
};

// A point of the trajectory. The last entry of frames, u and a, after the bodies, is the ground at rest.
struct State {
  Configuration frames;
  std::vector<Twist> u, a;
  std::vector<double> lam;     // of the constraints, then of rotors and leaders
  std::vector<double> angles;  // of the torsional springs, one place per force

  explicit State(const System& system)
      : frames(system.n() + 1),
        u(system.n() + 1),
        a(system.n() + 1),
        lam(system.rows() + system.others(), 0.0),
        angles(system.forces.size(), 0.0) {}

  // Vector by vector: half the moves of std::swap.
  friend void swap(State& a, State& b) noexcept {
    std::swap(a.frames, b.frames), a.u.swap(b.u), a.a.swap(b.a), a.lam.swap(b.lam), a.angles.swap(b.angles);
  }
};

EIGEN_ALWAYS_INLINE Vec3 load3(const double* at) { return {at[0], at[1], at[2]}; }
EIGEN_ALWAYS_INLINE Twist load(const double* at) { return {load3(at), load3(at + 3)}; }
EIGEN_ALWAYS_INLINE void store(const Vec3& value, double* at) { at[0] = value[0], at[1] = value[1], at[2] = value[2]; }
EIGEN_ALWAYS_INLINE void store(const Twist& twist, double* at) { store(twist.v, at), store(twist.w, at + 3); }

// The sizes of a system, from its bodies, joints and forces, and in motion. They scale with the units: no absolute
// length or time enters.

inline void enlarge(double& size, double other) { size = std::max(size, other); }

inline double largest_mobility(const Mat3& inertia_inverse) { return inertia_inverse.diagonal().maxCoeff(); }

// A body: its polar radius of gyration, so that a body without joints has a length too.
inline void measure(System& system, const Body& body) {
  enlarge(system.length, std::sqrt(0.5 * body.inertia.trace() / body.mass));
}

// A joint: how far its anchors lie from the centres of mass, and how far apart it keeps them.
inline void measure(System& system, const Joint& joint) {
  for (const Vec3& anchor : {joint.parent_anchor, joint.child_anchor}) enlarge(system.length, anchor.norm());
  for (const Part& part : joint.parts) {
    if (part.contact) enlarge(system.length, part.contact->radius);
    for (const DotRow& dot : part.dots) {
      const int differences = (dot.a == Carrier::difference) + (dot.b == Carrier::difference);
      const double product = dot.scale == 0 ? 0 : std::abs(dot.constant / dot.scale);
      if (differences == 1) enlarge(system.length, product);
      if (differences == 2) enlarge(system.length, std::sqrt(product));
    }
  }
}

// A force: where it acts, and the rates and accelerations that it gives its bodies.
inline void measure(System& system, const Force& force) {
  enlarge(system.length, force.parent_point.norm()), enlarge(system.length, force.child_point.norm());
  if (force.kind == Force::Kind::linear_spring) enlarge(system.length, std::abs(force.rest));
  double translation = 0, rotation = 0;  // accelerations by a unit force and a unit torque
  for (int b : {force.parent, force.child}) {
    if (b == system.n()) continue;
    const Vec3& point = b == force.parent ? force.parent_point : force.child_point;
    const double turns = largest_mobility(system.bodies[b].inertia_inverse);
    rotation += turns;
    translation += 1 / system.bodies[b].mass + turns * point.squaredNorm();
  }
  const double drive = force.drive ? force.drive->size() : 1;
  if (force.kind == Force::Kind::load) {
    enlarge(system.acceleration, translation * drive * force.force.norm());
    enlarge(system.angular_acceleration, rotation * drive * force.torque.norm());
    return;
  }
  const bool slides = force.kind == Force::Kind::slide_force;
  if (force.drive)
    enlarge(slides ? system.acceleration : system.angular_acceleration, (slides ? translation : rotation) * drive);
  const double mobility = slides || force.kind == Force::Kind::linear_spring ? translation : rotation;
  enlarge(system.frequency, std::max(std::sqrt(force.stiffness * mobility), force.damping * mobility));
}

// A length (m) and a rate (1/s) that make errors of translations, rotations and their rates comparable. They scale with
// the units of length and time and do not depend on the unit of mass.
struct Scales {
  double length = 1, rate = 1;

  // The rate is at least the one that weight and loads produce, and at least `slowest`: a system at rest for a moment
  // need not be followed to the last digit of its speed.
  static Scales of(const System& system, const State& state, double slowest) {
    Scales scales = of_motion(system, state);
    scales.rate = std::max({scales.rate, scales.falling(system), slowest});
    return scales;
  }
  // From the present motion alone.
  static Scales of_motion(const System& system, const State& state) { return of_motion(system, state.frames, state.u); }
  static Scales of_motion(const System& system, const Configuration& frames, const std::vector<Twist>& u) {
    Scales scales{system.length, 0};
    for (int b = 0; b < system.n(); ++b) scales.length = std::max(scales.length, frames[b].x.cwiseAbs().maxCoeff());
    for (int b = 0; b < system.n(); ++b) scales.rate = std::max(scales.rate, scales.rate_of(u[b]));
    return scales;
  }
  // The rate of a system that does not move yet, 1/s: that of a fall over `length`, or a small part of the springs'
  // frequency.
  double natural(const System& system) const { return std::max(falling(system), kSlow * system.frequency); }

  // The larger of a body's two rates, 1/s.
  double rate_of(const Twist& u) const {
    return std::max(u.v.cwiseAbs().maxCoeff() / length, u.w.cwiseAbs().maxCoeff());
  }

  // The largest of position / length, angle, and their rates, over twelve numbers a body: x, theta, v, w.
  double norm(const std::vector<double>& y) const {
    double most = 0, sum = 0;
    for (size_t at = 0; at < y.size(); at += 12) {
      const double x = load3(&y[at]).norm() / length, theta = load3(&y[at + 3]).norm();
      const double v = load3(&y[at + 6]).norm() / (length * rate), w = load3(&y[at + 9]).norm() / rate;
      most = std::max({most, x, theta, v, w});
      sum += x + theta + v + w;
    }
    return std::isfinite(sum) ? most : sum;  // max() would hide a NaN
  }

 private:
  static constexpr double kFall = 0.3;   // part of sqrt(g / length); gives 1 rad/s for one metre on the Earth
  static constexpr double kSlow = 1e-3;  // part of a spring's frequency

  double falling(const System& system) const {
    const double fall = std::max(system.gravity.norm(), system.acceleration) / length;
    return kFall * std::sqrt(std::max(fall, system.angular_acceleration));
  }
};

}  // namespace lieeuler
