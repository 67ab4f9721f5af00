// Implicit Lie group Euler methods for the Lagrangian equations, reconstructed from
// doi:10.1177/1687814019842406, (4.1) and (4.5) of docs/theory.md, all at n+1:
//
//   M (u - u_n) = h f(q, u) - G^T Lam,   Lam = h lam,   q = q_n * (h xi)
//
//   position      Phi(q) = 0, of slips as velocity              xi = u                    DAE3L_LE
//   velocity      G u = 0                                       xi = u                    DAE2L_LE
//   stabilised    Phi(q) = 0, G u = 0                           M xi = M u - G_n^T mu     DAE2L_LSE, DAE1L_LSE
//   acceleration  G a + gamma + 2 alpha G u + beta^2 Phi = 0    xi = u, a = (u - u_n)/h   INDEX1_LE, BAUMGARTE_LE
//
// Rows of slip, A u = 0 alone, have no mu, (18.1) of docs/theory.md. The correction of xi is weighted with the mass;
// the plain one, xi = u - G_n^T mu, is that of Gear, Gupta and Leimkuhler.
//
// And the stabilised generalized-alpha method, which has other numbers in the equations of the first and third column
// (methods/generalized_alpha.hpp).
//
// Unknowns: u of each body, Lam of each joint; when stabilised also xi and mu. Newton's matrix is (7.1), or (7.2) of
// docs/theory.md.
#pragma once

#include <optional>

#include "methods/euler.hpp"
#include "methods/generalized_alpha.hpp"
#include "solve/stabilised.hpp"

namespace lieeuler {

// The motion of a body since a start, summed separately from the state, so that rounding errors are relative to the
// motion: x, R^T R' - I and u.
struct Increment {
  Vec3 x = Vec3::Zero();
  Mat3 turn = Mat3::Zero();
  Twist u;
};

class Increments {
 public:
  explicit Increments(const System& system) : origin_(system) {}

  void keep() { sums_.resize(origin_.u.size() - 1); }
  bool kept() const { return !sums_.empty(); }
  const std::vector<Increment>& sums() const { return sums_; }
  const Twist& u(int b) const { return sums_[b].u; }

  void begin(const State& state) {
    std::fill(sums_.begin(), sums_.end(), Increment{});
    origin_ = state;
  }
  // To turn velocities relative to the start into velocities.
  const Twist& origin(int b) const { return origin_.u[b]; }
  // Adds a step of a body by x and I + turn; u are its velocities relative to the start. Returns its new frame.
  Frame add(int b, const Vec3& x, const Mat3& turn, const Twist& u) {
    Increment& sum = sums_[b];
    sum.x += x;
    sum.turn += turn + sum.turn * turn;
    sum.u = u;
    return {origin_.frames[b].x + sum.x, origin_.frames[b].R + origin_.frames[b].R * sum.turn};
  }

 private:
  std::vector<Increment> sums_;
  State origin_;
};

template <class Map>
class LagrangeEquations {
 public:
  EulerStep<Map> at;

  LagrangeEquations(const Plan& plan, Level level, bool index1_output, Gains gains,
                    Correction correction = Correction::mass)
      : LagrangeEquations(plan, level, index1_output, gains, correction, std::nullopt) {}
  // Generalized-alpha.
  LagrangeEquations(const Plan& plan, const GeneralizedAlpha& alpha, Correction correction = Correction::mass)
      : LagrangeEquations(plan, Level::stabilised, true, {}, correction, alpha) {}

  // The motion since start(), if it is to be kept.
  void keep_increments() { increments_.keep(); }
  const std::vector<Increment>& increments() const { return increments_.sums(); }

  static constexpr bool projects(Level) { return false; }
  bool exact_matrix() const {
    return at.level != Level::acceleration &&
           (!incomplete() || (at.to_rounding() && split_ && knows_left_out_ && split_->exact())) &&
           !(alpha_ && !at.plan.rotors.empty());
  }

  // Whether springs couple bodies so stiffly that iterations with a matrix without them converge slowly.
  bool couples_by_springs() const {
    constexpr double kStiff = 0.2;  // step over a spring's time; its square is the error that an iteration leaves
    return std::abs(at.h) * at.system.frequency > kStiff;
  }

  // Replaces a split solve that does not converge by one matrix for all unknowns; false if it is in use already.
  bool fall_back() {
    if (!split_) return false;
    take_whole_matrix(at.start_joints);
    return true;
  }
  // For steps of any length from here: the matrix that long ones of damped springs need is laid out before the first.
  void take_long_steps(const State& state) {
    if (!split_ || !damped_ || at.system.frequency == 0) return;
    at.joints.update(state.frames);
    take_whole_matrix(at.joints);
  }
  void take_whole_matrix(const Constraints& joints) {
    split_.reset();
    at.take_whole_matrix(at.nodes.doubled(), joints);
    find_blocks();
  }

  // Replaces a change of the velocities by what remains of it after an implicit step with the matrix factored last:
  // stiff forces make it decay within the step. False if the solve fails.
  bool filter(std::vector<Twist>& change) {
    filtered_.assign(at.z.size(), 0.0);
    for (int b = 0; b < at.system.n(); ++b)
      store(momentum(at.system.bodies[b], change[b]), &filtered_[3 * at.nodes.v(b)]);
    for (int k : at.plan.rotors) filtered_[3 * at.nodes.lam(k)] = at.joints.velocity(at.plan.parts[k], change)[0];
    if (!solve_linear(filtered_)) return false;
    for (int b = 0; b < at.system.n(); ++b) change[b] = load(&filtered_[3 * at.nodes.v(b)]);
    return true;
  }

  // The step, in this order: a guess, Newton with residual, matrix and solve, and the end.
  Status begin() {
    if (split_ && damped_ && couples_by_springs()) take_whole_matrix(at.joints);  // sweeps would not converge
    if (split_) split_->forget();
    if (increments_.kept()) increments_.begin(at.state);
    return alpha_ ? begin_alpha() : Status::success;
  }
  void guess(std::vector<double>& z) const {
    for (int b = 0; b < at.system.n(); ++b) {
      const Twist& u = increments_.kept() ? increments_.u(b) : at.state.u[b];
      store(u, &z[3 * at.nodes.v(b)]);
      store(u, &z[3 * at.nodes.xi_v(b)]);
    }
    at.guess_multipliers(force_time(), z);
  }

  Status residual(const std::vector<double>& z, std::vector<double>& r) {
    if (!configure(z)) return Status::map_domain;
    at.joints.update(at.state.frames);
    generalized_forces(at.system, at.state.frames, at.state.u, at.start.angles, at.force);
    for (int b = 0; b < at.system.n(); ++b) {
      const Body& body = at.system.bodies[b];
      const Twist &f = at.force[b], gain = gain_of(b, z);
      balance_[b] = {body.mass * gain.v - force_time() * f.v, times(body.inertia, gain.w) - force_time() * f.w};
      if (stabilised()) drift_[b] = plain_ ? drift_of(b) : momentum(body, drift_of(b));
    }
    for (int k = 0; k < at.nodes.parts(); ++k) {
      at.joints.subtract_reaction(at.plan.parts[k], -load3(&z[3 * at.nodes.lam(k)]), balance_);
      if (stabilised()) at.start_joints.subtract_reaction(at.plan.parts[k], -load3(&z[3 * at.nodes.mu(k)]), drift_);
      store(constraint_residual(k), &r[3 * at.nodes.lam(k)]);
      if (stabilised()) store(Vec3(at.here(k).position(at.plan.part(k)) / at.h), &r[3 * at.nodes.mu(k)]);
    }
    for (int b = 0; b < at.system.n(); ++b) {
      store(balance_[b], &r[3 * at.nodes.v(b)]);
      if (stabilised()) store(drift_[b], &r[3 * at.nodes.xi_v(b)]);
    }
    if (at.has_others) complete_others(z, r);
    return Status::success;
  }

  bool factor() {
    for (int b = 0; b < at.system.n(); ++b) tangents_[b] = at.maps[b].left_tangent();
    if (split_) split_->linearise(at.joints, at.start_joints, at.state.u, tangents_, at.h);
    return (at.core ? fill_core() : fill_matrix()) && at.factor_matrix();
  }
  bool solve_linear(std::vector<double>& r) {
    if (!split_) return at.solve_linear(r);
    const auto core = [this](double* x) { at.solve_matrix(x); };
    const auto left_out = [this](const std::vector<Twist>& xi, std::vector<Twist>& balance) {
      subtract_left_out(xi, balance);
    };
    const auto damping = [this](const std::vector<Twist>& u, std::vector<Twist>& balance) {
      if (damped_) add_slopes(-force_time(), u, balance, &ForceState::by_velocity);
      return damped_;
    };
    return split_->solve(r, at.nodes, core, damping, left_out, incomplete() && knows_left_out_, at.length,
                         at.target() / std::abs(at.h));
  }
  Status finish() {
    if (!configure(at.z)) return Status::map_domain;
    for (int b = 0; increments_.kept() && b < at.system.n(); ++b)
      at.state.frames[b] = increments_.add(b, at.h * at.xi[b].v, at.maps[b].turn(), load(&at.z[3 * at.nodes.v(b)]));
    at.settle();
    if (alpha_) {
      alpha_->advance(at.start.u, at.state.u, at.h);
      alpha_->prepare(at.state.u, at.h);
    }
    if (at.index1_output) return at.owe_index1();
    if (split_ && !at.saddle.factor(at.joints)) return Status::singular_matrix;
    at.store_multipliers(at.h);
    for (int b = 0; b < at.system.n(); ++b) at.state.a[b] = (at.state.u[b] - at.start.u[b]) / at.h;
    return Status::success;
  }
  void output() { at.saddle.accelerate(at.joints, at.state); }

 private:
  LagrangeEquations(const Plan& plan, Level level, bool index1_output, Gains gains, Correction correction,
                    const std::optional<GeneralizedAlpha>& alpha)
      : at(plan, level, index1_output, layout(plan, level, correction == Correction::plain)),
        plain_(correction == Correction::plain),
        gains_(gains),
        alpha_(alpha),
        damped_(plan.system.damped()),
        force_share_(alpha ? alpha->force_share() : 1),
        velocity_share_(alpha ? alpha->velocity_share() : 1),
        increments_(at.system),
        turned_(at.system.n() + 1),
        tangents_(at.system.n() + 1),
        stiffness_of_(at.system.n() + 1),
        balance_(at.system.n() + 1),
        drift_(at.system.n() + 1) {
    if (!plain_ && splits(plan, level)) split_.emplace(plan, at.saddle.delassus(), force_share_, velocity_share_);
    if (!at.core) find_blocks();
    for (int k = 0; k < at.nodes.parts(); ++k) {
      const Part& part = at.plan.part(k);
      knows_left_out_ = knows_left_out_ && !part.contact;
      if (part.spherical || part.turn) continue;
      const bool grounded = at.plan.body(k, kParent) == at.system.n() || at.plan.body(k, kChild) == at.system.n();
      if (!grounded || !AxisRows::suits(part)) coupled_.push_back(k);
    }
  }
  // whole: StabilisedSolve does not know these equations.
  static Layout layout(const Plan& plan, Level level, bool whole) {
    const bool stabilised = level == Level::stabilised;
    return {.solves_velocities = level != Level::position,
            .doubled_unknowns = stabilised,
            .doubled_matrix = stabilised && (whole || !splits(plan, level)),
            .second_order = true,
            .eliminates = !whole && eliminates(plan, level)};
  }

  static bool splits(const Plan& plan, Level level) {
    return level == Level::stabilised && StabilisedSolve::suits(plan);
  }
  bool stabilised() const { return at.level == Level::stabilised; }
  // theta: the time for which a force acts in a step.
  double force_time() const { return force_share_ * at.h; }
  // What a slope along xi is multiplied by: rho h in the split matrix.
  double slope_time() const { return split_ ? velocity_share_ * at.h : at.h; }

  // The rows that belong to Lam; positions are divided by h.
  Vec3 constraint_residual(int k) const {
    const Part& part = at.plan.part(k);
    if (at.level == Level::position && !part.slips) return at.here(k).position(part) / at.h;
    const Vec3 rate = at.velocity_rows(k, at.state);
    if (at.level != Level::acceleration) return rate;
    const Vec3 before = at.velocity_rows(k, at.start);
    return (rate - before) + at.h * (at.joints.gamma(at.plan.parts[k], at.state.u) + 2 * gains_.alpha * rate +
                                     gains_.beta * gains_.beta * at.here(k).position(part));
  }
  // Derivative of the velocity or acceleration rows with respect to xi, without G itself. At the acceleration level the
  // third derivatives of Phi are left out: they are O(h^2), and the iteration still solves the exact equations.
  Rows rate_slope(int k, Side side, const Rows& G, const Mat3& T) const {
    const int i = at.plan.body(k, kParent), j = at.plan.body(k, kChild);
    const JointState& joint = at.here(k);
    const Part& part = at.plan.part(k);
    if (at.level != Level::acceleration) {
      const Rows N = joint.velocity_slope(part, side, at.state.u[i], at.state.u[j], false);
      return {slope_time() * N.v, slope_time() * N.w * T};
    }
    const double feedback = 2 * gains_.alpha + at.h * gains_.beta * gains_.beta;
    auto change = [&](int b) { return at.state.u[b] - at.start.u[b]; };
    if (part.spherical) {  // only the body's own turn changes its side
      const int b = side == kChild ? j : i;
      const Mat3 N = joint.anchor_rate_slope(side, at.state.u[b].w - at.start.u[b].w) +
                     joint.anchor_second_slope(side, at.state.u[b].w);
      return {at.h * (feedback * G.v), at.h * (N + feedback * G.w)};
    }
    const Rows first = joint.velocity_slope(part, side, change(i), change(j), false);  // d(G h a)/dq
    const Rows second = joint.velocity_slope(part, side, at.state.u[i], at.state.u[j], true);
    return {at.h * (first.v + second.v + feedback * G.v), at.h * (first.w + second.w + feedback * G.w)};
  }

  // Completes the rows of mimics, rotors and slip. Not inlined: systems without them would pay for it.
  [[gnu::noinline, gnu::cold]] void complete_others(const std::vector<double>& z, std::vector<double>& r) const {
    if (!at.plan.mimics.empty()) unite(z, r);
    for (int k : at.plan.rotors) {
      r[3 * at.nodes.lam(k)] = rotor_gain(k) - at.plan.part(k).compliance * z[3 * at.nodes.lam(k)];
      if (stabilised()) r[3 * at.nodes.mu(k)] = z[3 * at.nodes.mu(k)];
    }
    for (int k : at.plan.slips)
      if (stabilised()) store(load3(&z[3 * at.nodes.mu(k)]), &r[3 * at.nodes.mu(k)]);
  }
  // Combines the rows of followers and leaders. Angles differ by whole turns, which beta must not feel.
  void unite(const std::vector<double>& z, std::vector<double>& r) const {
    const double restoring = at.level == Level::acceleration ? at.h * gains_.beta * gains_.beta : 0;
    for (const PlacedMimic& mimic : at.plan.mimics) {
      const auto coordinate = [&](int k) { return at.here(k).position(at.plan.part(k))[0]; };
      r[3 * at.nodes.lam(mimic.follower)] +=
          restoring * (gap(at.plan, mimic, at.joints, at.start.angles) - coordinate(mimic.follower) +
                       mimic.ratio * coordinate(mimic.leader));
    }
    at.unite_rows(&z[3 * at.nodes.lam(0)], &r[3 * at.nodes.lam(0)], at.level == Level::position);
    if (stabilised()) at.unite_rows(&z[3 * at.nodes.mu(0)], &r[3 * at.nodes.mu(0)], true);
  }

  // A matrix with the bodies eliminated leaves out of K, the derivative of reactions and forces by positions, what
  // couples bodies or rotations with translations.
  //
  // balance -= rho h K T xi, with what is left out of K.
  void subtract_left_out(const std::vector<Twist>& xi, std::vector<Twist>& balance) {
    for (int b = 0; b < at.system.n(); ++b) turned_[b] = {xi[b].v, times(tangents_[b], xi[b].w)};
    for (int k : coupled_) {
      const int parent = at.plan.body(k, kParent), child = at.plan.body(k, kChild);
      const Vec3 impulse = slope_time() * load3(&at.z[3 * at.nodes.lam(k)]);
      for (Side side : kSides)
        balance[at.plan.body(k, side)] -=
            at.here(k).coupled_reaction(at.plan.part(k), side, impulse, turned_[parent], turned_[child]);
    }
    add_slopes(force_time() * slope_time(), turned_, balance, &ForceState::by_position);
    if (damped_) add_slopes(force_time(), xi, balance, &ForceState::by_velocity);
  }
  // balance += factor times the derivatives of the forces along a motion.
  void add_slopes(double factor, const std::vector<Twist>& motion, std::vector<Twist>& balance,
                  Stiffness (ForceState::*slope)(Side, Side) const) const {
    for (size_t k = 0; k < at.system.forces.size(); ++k) {
      const Force& force = at.system.forces[k];
      const ForceState here(force, at.state.frames, at.state.u, at.start.angles[k]);
      for (Side row : kSides)
        for (Side column : kSides) {
          const Stiffness K = (here.*slope)(row, column);
          const Twist& along = motion[column == kChild ? force.child : force.parent];
          Twist& own = balance[row == kChild ? force.child : force.parent];
          own.v += factor * (K.vv * along.v + K.vw * along.w), own.w += factor * (K.wv * along.v + K.ww * along.w);
        }
    }
  }

  // The change of a rotor's rate in the step: s (u - u_n) + h (ds/dt) u if the method takes accelerations at the new
  // state, else the difference of the rates at the two states.
  bool gains_by_derivative() const { return at.level == Level::acceleration || alpha_; }
  double rotor_gain(int k) const {
    const PlacedPart& part = at.plan.parts[k];
    const double rate = at.joints.velocity(part, at.state.u)[0];
    if (!gains_by_derivative()) return rate - at.start_joints.velocity(part, at.start.u)[0];
    const Twist parent = from(part.bodies[kParent]), child = from(part.bodies[kChild]);
    return rate - at.here(k).velocity(*part.part, parent, child)[0] +
           force_time() * at.joints.gamma(part, at.state.u)[0];
  }
  // The velocity from which u changes: u_n, or that of generalized-alpha; zero for the ground.
  Twist from(int b) const { return alpha_ ? (b == at.system.n() ? Twist{} : alpha_->from(b)) : at.start.u[b]; }
  // Derivatives of rotor_gain() with respect to u and xi; with accelerations, second derivatives of s are left out.
  std::pair<Rows, Rows> rotor_slopes(int k, Side side, const Mat3& T) const {
    const Twist &parent = at.state.u[at.plan.body(k, kParent)], &child = at.state.u[at.plan.body(k, kChild)];
    const JointState& joint = at.here(k);
    const Part& part = at.plan.part(k);
    Rows by_u = joint.jacobian(part, side), by_xi;
    const Rows N = joint.velocity_slope(part, side, parent, child, gains_by_derivative());
    if (gains_by_derivative())
      by_u.v += force_time() * N.v, by_u.w += force_time() * N.w;
    else
      by_xi = {at.h * N.v, at.h * N.w * T};
    return {by_u, by_xi};
  }

  // u - u_n
  Twist gain_of(int b, const std::vector<double>& z) const {
    const Twist u = increments_.kept() ? load(&z[3 * at.nodes.v(b)]) : at.state.u[b];
    const Twist& from = increments_.kept() ? increments_.u(b) : alpha_ ? alpha_->from(b) : at.start.u[b];
    return u - from;
  }
  // xi - u without the part of the multipliers.
  Twist drift_of(int b) const {
    const Twist &xi = at.xi[b], &u = at.state.u[b];
    return alpha_ ? xi - velocity_share_ * u - alpha_->carry(b) : xi - u;
  }
  // Computes the accelerations at the start, and the auxiliary ones a little later or earlier.
  Status begin_alpha() {
    const double whole = std::exchange(at.h, alpha_->ahead(at.h));
    at.start = at.state;
    at.state.frames.follow(at.start.frames, at.h);
    bool inside = true;
    for (int b = 0; b < at.system.n(); ++b) {
      const Twist &u = at.start.u[b], &a = at.start.a[b];
      at.xi[b] = u + 0.5 * at.h * a;
      at.state.u[b] = u + at.h * a;
      inside = at.move(b) && inside;
    }
    at.h = whole;
    if (inside) {
      at.evaluate_joints();
      inside = at.solve_index1() == Status::success;
    }
    // If the step is too long to solve this, the step itself will fail and give the reason.
    alpha_->start(at.start.a, inside ? at.state.a : at.start.a);
    alpha_->prepare(at.start.u, at.h);
    at.state = at.start;
    at.joints.update(at.state.frames);
    return at.saddle.factor(at.joints) ? Status::success : Status::singular_matrix;
  }
  bool configure(const std::vector<double>& z) {
    for (int b = 0; b < at.system.n(); ++b) {
      at.state.u[b] = load(&z[3 * at.nodes.v(b)]);
      at.xi[b] = load(&z[3 * at.nodes.xi_v(b)]);
      if (increments_.kept()) at.state.u[b] += increments_.origin(b), at.xi[b] += increments_.origin(b);
      if (!at.move(b)) return false;
    }
    return true;
  }
  // Whether second derivatives of joints and forces act on one body each, so that bodies can be eliminated: trees of
  // spherical joints without forces, except for the rows of the acceleration level.
  static bool eliminates(const Plan& plan, Level level) {
    const System& system = plan.system;
    // With independent rows this is not exact; Newton's iteration corrects the coupling of bodies that is left out.
    if (plan.independent && level == Level::position) return StabilisedSolve::suits(plan) && !plan.system.damped();
    if (plan.independent) return splits(plan, level);
    return level != Level::acceleration && system.forces.empty() && plan.plain() && plan.forest &&
           std::all_of(system.joints.begin(), system.joints.end(), [](const Joint& joint) {
             return std::all_of(joint.parts.begin(), joint.parts.end(),
                                [](const Part& part) { return part.spherical; });
           });
  }

  // Whether the matrix with the bodies eliminated leaves out how forces and rows of dot products couple bodies.
  bool incomplete() const { return at.core && at.saddle.dropped(); }

  // The matrix with the bodies eliminated: a rotational block per body, and the rows of the parts.
  bool fill_core() {
    for (int b = 0; b < at.system.n(); ++b) stiffness_of_[b].setZero();
    for (int k = 0; k < at.nodes.parts(); ++k) {
      const Vec3 impulse = slope_time() * load3(&at.z[3 * at.nodes.lam(k)]);
      for (Side side : kSides) {
        Mat3& own = stiffness_of_[at.plan.body(k, side)];
        if (at.plan.part(k).spherical)
          own += at.here(k).anchor_stiffness(side, impulse);
        else if (at.plan.body(k, side) != at.system.n())
          own += dot_stiffness(k, side, impulse);
      }
    }
    for (int b = 0; b < at.system.n(); ++b)
      if (!at.core->set_rotational(b, inertia_block(b) + stiffness_of_[b] * tangents_[b])) return false;
    struct Derivatives {
      const LagrangeEquations& equations;
      Mat3 rotations(const Delassus::Place& place, const Mat3& G) const { return equations.anchor_rows(place, G); }
      Rows rows(const Delassus::Place& place, const Rows& G) const { return {G.v, rotations(place, G.w)}; }
    };
    at.core->assemble(Derivatives{*this}, Delassus::Jacobians{at.joints});
    return true;
  }
  // The stiffness of dot rows between a body and itself; also sets the slope of their velocity for the split solve.
  // Their coupling of two bodies is left to the iteration: it is O(h^2).
  [[gnu::noinline]] Mat3 dot_stiffness(int k, Side side, const Vec3& impulse) {
    const Part& part = at.plan.part(k);
    if (split_)
      split_->slope(k, side) = rate_slope(k, side, at.here(k).jacobian(part, side), tangents_[at.plan.body(k, side)]);
    return at.here(k).own_stiffness(part, side, impulse);
  }
  // Derivative of a spherical part's rows with respect to the rotational xi: position rows, or velocity rows at that
  // level.
  Mat3 anchor_rows(const Delassus::Place& place, const Mat3& G) const {
    if (at.level != Level::velocity) return G * tangents_[place.body];
    const Mat3 slope = at.joints[place.joint].anchor_rate_slope(place.side, at.state.u[place.body].w);
    return G + at.h * slope * tangents_[place.body];
  }

  void find_blocks() {
    stiffness_.clear(), springs_.clear(), rates_.clear(), drifts_.clear();
    for (int k = 0; k < at.nodes.parts(); ++k) {
      at.append_pairs(at.plan.body(k, kParent), at.plan.body(k, kChild), true, stiffness_);
      const bool single = at.plan.part(k).compliance > 0 || at.plan.part(k).slips;  // no second multiplier
      for (int b : at.plan.parts[k].bodies) {
        const int second = at.columns.doubled() ? b : at.system.n();
        rates_.push_back(at.side_blocks(at.columns.lam(k), second, true));
        drifts_.push_back(at.side_blocks(at.columns.mu(k), single ? at.system.n() : second, true));
      }
    }
    for (const Force& force : at.system.forces) at.append_pairs(force.parent, force.child, true, springs_);
  }

  bool fill_matrix() {
    at.lu.set_zero();
    for (int b = 0; b < at.system.n(); ++b) body_blocks(b);
    if (!at.system.own.empty()) own_.find(at.system, at.state.frames, at.state.u, true);
    for (size_t k = 0; k < at.system.forces.size(); ++k) add_force_blocks(k);
    for (int k = 0; k < at.nodes.parts(); ++k) {
      at.pad(k);
      for (Side row : kSides)
        for (Side column : kSides) stiffness_blocks(k, row, column);
      for (Side side : kSides)
        if (at.plan.body(k, side) != at.system.n()) constraint_blocks(k, side);
    }
    for (int k : at.plan.rotors)
      for (Side side : kSides)
        if (at.plan.body(k, side) != at.system.n()) rotor_blocks(k, side);
    at.pad_others();
    return true;
  }

  // J - theta df/du of the gyroscopic torque.
  Mat3 inertia_block(int b) const {
    const Body& body = at.system.bodies[b];
    const Vec3& w = at.state.u[b].w;
    return body.inertia + force_time() * gyroscopic_slope(w, angular_momentum(body, w), body.inertia);
  }
  // M - theta df/du, and below it M (xi - rho u), or xi - rho u.
  void body_blocks(int b) {
    const Body& body = at.system.bodies[b];
    const auto& blocks = at.bodies[b];
    put_diagonal(blocks.v, body.mass);
    put(blocks.w, inertia_block(b));
    if (!at.columns.doubled()) return;
    const double mass = plain_ ? 1 : body.mass;
    const Mat3 inertia = plain_ ? Mat3(Mat3::Identity()) : body.inertia;
    put_diagonal(blocks.xi_v, mass), put_diagonal(blocks.xi_v_v, -velocity_share_ * mass);
    put(blocks.xi_w, inertia), put(blocks.xi_w_w, -velocity_share_ * inertia);
  }

  // Adds h d(G^T Lam)/dq T to the columns of xi.
  void stiffness_blocks(int k, Side row, Side column) {
    const PairBlocks& blocks = stiffness_[4 * k + 2 * row + column];
    const Part& part = at.plan.part(k);
    if (!blocks.ww || (part.spherical && row != column)) return;
    const Vec3 impulse = slope_time() * load3(&at.z[3 * at.nodes.lam(k)]);
    const Mat3& T = tangents_[at.plan.body(k, column)];
    if (part.spherical) return add(blocks.ww, at.here(k).anchor_stiffness(row, impulse) * T);  // the only block
    blocks.add(1, at.here(k).geometric_stiffness(part, row, column, impulse), T);
  }

  // Adds - theta df/du to the columns of u, and - theta h df/dq T to those of xi.
  void add_force_blocks(size_t k) {
    const Force& force = at.system.forces[k];
    const ForceState here(force, at.state.frames, at.state.u, at.start.angles[k]);
    for (Side row : kSides)
      for (Side column : kSides) {
        const PairBlocks& by_position = springs_[4 * k + 2 * row + column];
        if (!by_position.ww) continue;  // the ground
        const Mat3& T = tangents_[column == kChild ? force.child : force.parent];
        if (force.kind == Force::Kind::own) {
          add_own_blocks(k, row, column, T);
          continue;
        }
        by_position.add(-force_time() * slope_time(), here.by_position(row, column), T);
        if (force.damping == 0) continue;
        at.force_blocks[4 * k + 2 * row + column].add(-force_time(), here.by_velocity(row, column), Mat3::Identity());
      }
  }

  // Those of the user's forces; what couples a body with itself comes with its pair with the ground.
  void add_own_blocks(size_t k, Side row, Side column, const Mat3& T) {
    const Force& force = at.system.forces[k];
    if (row == column && force.parent != at.system.n()) return;
    const int to = row == kChild ? force.child : force.parent, from = column == kChild ? force.child : force.parent;
    springs_[4 * k + 2 * row + column].add(-force_time() * slope_time(), own_.by_position(to, from), T);
    at.force_blocks[4 * k + 2 * row + column].add(-force_time(), own_.by_velocity(to, from), Mat3::Identity());
  }

  void constraint_blocks(int k, Side side) {
    const Mat3& T = tangents_[at.plan.body(k, side)];
    const SideBlocks& blocks = at.blocks[2 * k + side];
    const Rows G = at.here(k).jacobian(at.plan.part(k), side);
    blocks.put_columns(G);
    if ((at.level == Level::position && !at.plan.part(k).slips) || split_) {
      if (split_ && !at.plan.part(k).spherical) split_->slope(k, side) = rate_slope(k, side, G, T);
      return blocks.put_rows(G.v, G.w * T);
    }
    const Rows slope = rate_slope(k, side, G, T);
    if (!stabilised()) return blocks.put_rows(G.v + slope.v, G.w + slope.w);
    blocks.put_rows(G.v, G.w);
    rates_[2 * k + side].put_rows(slope.v, slope.w);
    drifts_[2 * k + side].put_rows(G.v, G.w * T);
    drifts_[2 * k + side].put_columns(at.before(k).jacobian(at.plan.part(k), side));
  }

  void rotor_blocks(int k, Side side) {
    const auto [by_u, by_xi] = rotor_slopes(k, side, tangents_[at.plan.body(k, side)]);
    const SideBlocks& blocks = at.blocks[2 * k + side];
    if (!at.columns.doubled()) return blocks.put_rows(by_u.v + by_xi.v, by_u.w + by_xi.w);
    blocks.put_rows(by_u.v, by_u.w);
    rates_[2 * k + side].put_rows(by_xi.v, by_xi.w);
  }

  const bool plain_;  // the correction of xi
  const Gains gains_;
  std::optional<GeneralizedAlpha> alpha_;
  const bool damped_;
  const double force_share_, velocity_share_;  // theta / h and rho; 1 for implicit Euler
  std::vector<int> coupled_;                   // parts of which the matrix with the bodies eliminated lacks something
  bool knows_left_out_ = true;                 // subtract_left_out() has all of it
  Increments increments_;                      // if kept, z holds u and xi minus their values at the start
  std::optional<StabilisedSolve> split_;
  OwnSlopes own_;
  std::vector<Twist> turned_;  // T xi
  std::vector<Mat3> tangents_, stiffness_of_;
  std::vector<Twist> balance_, drift_;  // residuals of the dynamics and of M xi = M u - G_n^T mu
  std::vector<double> filtered_;
  // Blocks of Newton's matrix that only Lagrangian steps have: columns of xi, per part or force, row side, column side;
  // those in velocity rows, and position rows and mu with xi, per part and side.
  std::vector<PairBlocks> stiffness_, springs_;
  std::vector<SideBlocks> rates_, drifts_;
};
template <class Map>
using LagrangeStepper = EulerStepper<LagrangeEquations<Map>>;

}  // namespace lieeuler
