// Symplectic Lie group Euler methods for the constrained Hamilton equations, reconstructed from
// doi:10.1177/1687814019842406, in Hamilton-Pontryagin form (doi:10.1007/s10208-008-9030-4), (4.4) of docs/theory.md,
// with Lam = h lam and D*, Ad* acting on the rotational part:
//
//   D*(h xi) M xi = p_n + h f_app(q_n, xi) - G_n^T Lam,   q = q_n * (h xi),   p = Ad*(h xi) D*(h xi) M xi
//
//   position      Phi(q) = 0                                                          DAE3H_LE
//   velocity      G M^-1 p = 0                                                        DAE2H_LE
//   stabilised    Phi(q) = 0, then p <- p - G^T mu with G M^-1 p = 0                  DAE2H_LSE, DAE1H_LSE
//
// Rows of slip, A u = 0 alone, are A M^-1 p = 0 at every level.
//
// RATTLE, equation (9.1) of docs/theory.md, replaces h before f_app (and in Lam) by h/2, and adds
// p <- p + h/2 f_app(q, xi) before the projection. It is symmetric and of second order. For the rows of slip it takes
// (A(q_n) + A(q)) xi = 0, and A M^-1 p = 0 after the projection.
//
// Unknowns: xi of each body, Lam of each joint. Newton's matrix is (7.3) of docs/theory.md.
#pragma once

#include "linalg/compensated.hpp"
#include "methods/euler.hpp"

namespace lieeuler {

template <class Map>
class HamiltonEquations {
 public:
  EulerStep<Map> at;
  enum class Kind { euler, rattle };

  HamiltonEquations(const Plan& plan, Level level, bool index1_output, Kind kind = Kind::euler)
      : at(plan, level, index1_output,
           {.solves_velocities = level == Level::velocity,
            .second_order = level == Level::velocity,
            .eliminates = eliminates(plan, level)}),
        rattle_(kind == Kind::rattle),
        rotations_(at.system.n() + 1),
        slopes_(at.system.n()),
        tangents_(slopes_),
        velocity_slopes_(level == Level::velocity || (!rattle_ && !plan.slips.empty()) ? at.system.n() : 0),
        momentum_(at.system.n() + 1),
        impulse_(at.system.n() + 1),
        change_(rattle_ ? at.system.n() + 1 : 0),
        mu_(at.system.rows() + at.system.others(), 0.0),
        rates_(plan.rotors.size(), 0.0),
        rotor_momenta_(rates_) {}

  static constexpr bool projects(Level level) { return level == Level::stabilised; }
  static constexpr bool exact_matrix() { return true; }
  static constexpr bool fall_back() { return false; }
  static constexpr bool couples_by_springs() { return false; }

  Status begin() {
    for (int b = 0; b < at.system.n(); ++b) momentum_[b] = canonical_momentum(at.system.bodies[b], at.state.u[b]);
    if (rattle_) carried_.assign(at.system.n(), {});
    for (size_t i = 0; i < rates_.size(); ++i)
      rotor_momenta_[i] = at.joints.velocity(at.plan.parts[at.plan.rotors[i]], at.state.u)[0] /
                          at.plan.part(at.plan.rotors[i]).compliance;
    return Status::success;
  }
  void guess(std::vector<double>& z) const {
    for (int b = 0; b < at.system.n(); ++b) store(at.state.u[b], &z[3 * at.nodes.v(b)]);
    at.guess_multipliers(impulse_time(), z);
  }
  Status residual(const std::vector<double>& z, std::vector<double>& r) {
    if (!configure(z)) return Status::map_domain;
    at.joints.update(at.state.frames);
    for (int b = 0; b < at.system.n(); ++b) {
      const Body& body = at.system.bodies[b];
      const Vec3 y = at.maps[b].momentum(angular_momentum(body, at.xi[b].w));
      store(Twist{body.mass * at.xi[b].v - impulse_[b].v, y - impulse_[b].w}, &r[3 * at.nodes.v(b)]);
      if (!velocity_slopes_.empty())
        at.state.u[b] = {at.xi[b].v, times(body.inertia_inverse, transposed_times(rotations_[b], y) - body.spin)};
    }
    for (int k = 0; k < at.nodes.parts(); ++k)
      store(by_velocity() ? at.velocity_rows(k, at.state) : Vec3(at.here(k).position(at.plan.part(k)) / at.h),
            &r[3 * at.nodes.lam(k)]);
    if (at.has_others) complete_others(z, r);
    return Status::success;
  }

  bool solve_linear(std::vector<double>& r) { return at.solve_linear(r); }

  void take_whole_matrix(const Constraints& joints) { at.take_whole_matrix(false, joints); }

  bool factor() {
    for (int b = 0; b < at.system.n(); ++b) {
      const Body& body = at.system.bodies[b];
      slopes_[b] = at.maps[b].momentum_slope(at.xi[b].w, angular_momentum(body, at.xi[b].w), body.inertia, at.h);
      tangents_[b] = at.maps[b].left_tangent();
      if (!velocity_slopes_.empty()) velocity_slopes_[b] = velocity_slope(b);
    }
    return (at.core ? fill_core() : fill_matrix()) && at.factor_matrix();
  }
  Status finish() {
    if (!configure(at.z)) return Status::map_domain;
    if (rattle_)
      carry_on();
    else
      turn_impulses();
    at.store_multipliers(impulse_time());
    for (size_t i = 0; i < rates_.size(); ++i) {
      const int k = at.plan.rotors[i];
      rotor_momenta_[i] += at.z[3 * at.nodes.lam(k)];
      rates_[i] = at.plan.part(k).compliance * rotor_momenta_[i];
    }
    if (at.level == Level::stabilised) {
      if (!at.saddle.factor(at.joints)) return Status::singular_matrix;
      if (rattle_)
        end_with_projection();
      else
        at.saddle.project(at.joints, momentum_, at.state.u, mu_.data(), momentum_, rates_);
      for (size_t i = 0; i < rates_.size(); ++i) rotor_momenta_[i] += mu_[at.plan.part(at.plan.rotors[i]).row];
      for (size_t r = 0; r < mu_.size(); ++r) at.state.lam[r] += mu_[r] / at.h;
    }
    at.owes_output = at.index1_output || !rattle_;  // factored above: index-1 output comes with stabilised
    return Status::success;
  }
  // a = M^-1 (f - G^T lam). Multipliers of the step act at q_n. Around a loop large ones cancel at thin bodies there,
  // but no more at q: with redundant rows those are taken that come nearest at q to the impulse of the joints, p less
  // p_n and its forces.
  void output() {
    if (at.index1_output) return at.saddle.accelerate(at.joints, at.state);
    std::vector<Twist>& a = at.state.a;
    if (at.level == Level::stabilised && at.saddle.redundant() > 0 && !at.has_others) {
      std::vector<Vec3> rows(at.plan.count(), Vec3::Zero());
      for (int b = 0; b < at.system.n(); ++b) {
        const Twist pushed = canonical_momentum(at.system.bodies[b], at.start.u[b]) + at.h * at.force[b];
        a[b] = {pushed.v - momentum_[b].v, transposed_times(rotations_[b], pushed.w) - momentum_[b].w};
      }
      at.saddle.solve(a, rows, true);
      for (int k = 0; k < at.plan.count(); ++k) store(rows[k], &at.z[3 * at.nodes.lam(k)]);
      at.store_multipliers(at.h);
    }
    generalized_forces(at.system, at.state.frames, at.state.u, at.state.angles, a);
    for (const PlacedPart& placed : at.plan.parts) {
      Vec3 lam = Vec3::Zero();
      std::copy_n(&at.state.lam[placed.part->row], placed.part->rows(), lam.data());
      at.joints.subtract_reaction(placed, lam, a);
    }
    for (int b = 0; b < at.system.n(); ++b) a[b] = velocity(at.system.bodies[b], a[b]);
    a[at.system.n()] = Twist{};
  }

 private:
  bool by_velocity() const { return at.level == Level::velocity; }
  double impulse_time() const { return rattle_ ? 0.5 * at.h : at.h; }

  // q = q_n * (h xi) and the impulse p_n + h f_app(q_n, xi) - G_n^T Lam.
  bool configure(const std::vector<double>& z) {
    for (int b = 0; b < at.system.n(); ++b) {
      at.xi[b] = load(&z[3 * at.nodes.v(b)]);
      if (!at.move(b)) return false;
      rotations_[b] = at.maps[b].rotation();
    }
    applied_forces(at.system, at.start.frames, at.xi, at.start.angles, at.force);
    for (int b = 0; b < at.system.n(); ++b) impulse_[b] = momentum_[b] + impulse_time() * at.force[b];
    for (int k = 0; k < at.nodes.parts(); ++k)
      at.start_joints.subtract_reaction(at.plan.parts[k], load3(&z[3 * at.nodes.lam(k)]), impulse_);
    return true;
  }

  // Rows of slip where others are those of position: of the velocity after the step; of RATTLE in the mean of the two
  // configurations of the step, by the velocity that leads from one to the other, which is symmetric in them.
  Vec3 slip_rows(int k) const {
    if (!rattle_) return at.velocity_rows(k, at.state);
    const PlacedPart& part = at.plan.parts[k];
    return 0.5 * (at.start_joints.velocity(part, at.xi) + at.joints.velocity(part, at.xi));
  }

  // Completes the rows of slip, mimics and rotors. Not inlined: systems without them would pay for it.
  [[gnu::noinline, gnu::cold]] void complete_others(const std::vector<double>& z, std::vector<double>& r) const {
    for (int k : at.plan.slips)
      if (!by_velocity()) store(slip_rows(k), &r[3 * at.nodes.lam(k)]);
    at.unite_rows(&z[3 * at.nodes.lam(0)], &r[3 * at.nodes.lam(0)], !by_velocity());
    for (size_t i = 0; i < rates_.size(); ++i) {
      const int row = 3 * at.nodes.lam(at.plan.rotors[i]);
      r[row] = (by_velocity() ? r[row] : way_of(at.plan.rotors[i]) / at.h) -
               at.plan.part(at.plan.rotors[i]).compliance * (rotor_momenta_[i] + z[row]);
    }
  }

  // How far a rotor turns, or slides, in the step; the joint's angle alone gives it only up to whole turns.
  double way_of(int k) const {
    const Part& part = at.plan.part(k);
    const double way = at.here(k).position(part)[0] - at.before(k).position(part)[0];
    if (!part.turn) return way;
    const double about = at.h * at.start_joints.velocity(at.plan.parts[k], at.xi)[0];
    return about + std::remainder(way - about, 2 * std::numbers::pi);
  }

  // Adds - h df_app/dxi; dampers act on the discrete velocity.
  void add_damper_blocks(size_t k) {
    const Force& force = at.system.forces[k];
    if (force.damping == 0) return;
    const ForceState here(force, at.start.frames, at.xi, at.start.angles[k]);
    const bool own = force.kind == Force::Kind::own;  // what couples a body with itself comes with the ground
    for (Side row : kSides)
      for (Side column : kSides) {
        const PairBlocks& blocks = at.force_blocks[4 * k + 2 * row + column];
        if (!blocks.ww || (own && row == column && force.parent != at.system.n())) continue;
        const int to = row == kChild ? force.child : force.parent, from = column == kChild ? force.child : force.parent;
        const Stiffness K = own ? own_.by_velocity(to, from) : here.by_velocity(row, column);
        blocks.add(-impulse_time(), K, Mat3::Identity());
      }
  }

  // Whether only rows of joints couple bodies: there are no dampers, and no loops whose dependent rows must be kept.
  static bool eliminates(const Plan& plan, Level level) {
    return plan.plain() && (plan.forest || (level != Level::velocity && plan.independent)) && !plan.system.damped();
  }

  bool fill_core() {
    for (int b = 0; b < at.system.n(); ++b)
      if (!at.core->set_rotational(b, slopes_[b])) return false;
    struct Derivatives {
      const HamiltonEquations& equations;
      Mat3 rotations(const Delassus::Place& place, const Mat3&) const { return equations.anchor_rows(place); }
      Rows rows(const Delassus::Place& place, const Rows&) const { return equations.row_slope(place.part, place.side); }
    };
    at.core->assemble(Derivatives{*this}, Delassus::Jacobians{at.start_joints});
    return true;
  }
  bool fill_matrix() {
    at.lu.set_zero();
    for (int b = 0; b < at.system.n(); ++b) {
      put_diagonal(at.bodies[b].v, at.system.bodies[b].mass);
      put(at.bodies[b].w, slopes_[b]);
    }
    if (!at.system.own.empty()) own_.find(at.system, at.start.frames, at.xi, false);
    for (size_t k = 0; k < at.system.forces.size(); ++k) add_damper_blocks(k);
    for (int k = 0; k < at.nodes.parts(); ++k) {
      at.pad(k);
      for (Side side : kSides) {
        if (at.plan.body(k, side) == at.system.n()) continue;
        const SideBlocks& blocks = at.blocks[2 * k + side];
        const Rows slope = row_slope(k, side);
        blocks.put_columns(at.before(k).jacobian(at.plan.part(k), side));
        blocks.put_rows(slope.v, slope.w);
      }
    }
    at.pad_others();
    return true;
  }

  // Derivative of the rows with respect to xi.
  Rows row_slope(int k, Side side) const {
    const Part& part = at.plan.part(k);
    const Rows G = at.here(k).jacobian(part, side);
    if (by_velocity() || part.slips) return rate_slope(k, side, G);
    return {G.v, G.w * tangents_[at.plan.body(k, side)]};
  }
  // That of rows of velocity: G M^-1 p depends on xi by p_w = E^T y, by E, and by G. Not inlined: methods at position
  // level would pay for it.
  [[gnu::noinline]] Rows rate_slope(int k, Side side, const Rows& G) const {
    const Part& part = at.plan.part(k);
    const int b = at.plan.body(k, side);
    const Mat3& T = tangents_[b];
    const std::vector<Twist>& u = part.slips && rattle_ ? at.xi : at.state.u;
    const Rows N =
        at.here(k).velocity_slope(part, side, u[at.plan.body(k, kParent)], u[at.plan.body(k, kChild)], false);
    if (part.slips && rattle_) {
      const Rows G_n = at.before(k).jacobian(part, side);
      return {0.5 * (G.v + G_n.v + at.h * N.v), 0.5 * (G.w + G_n.w + at.h * N.w * T)};
    }
    return {G.v + at.h * N.v, G.w * velocity_slopes_[b] + at.h * N.w * T};
  }
  // The same for a spherical part, with respect to rotations.
  Mat3 anchor_rows(const Delassus::Place& place) const {
    const JointState& joint = at.joints[place.joint];
    const Mat3 G = joint.anchor_jacobian(place.side), &T = tangents_[place.body];
    if (!by_velocity()) return G * T;
    return G * velocity_slopes_[place.body] + at.h * joint.anchor_rate_slope(place.side, at.state.u[place.body].w) * T;
  }
  // d(w)/dxi, w = J^-1 (E^T y - spin).
  Mat3 velocity_slope(int b) const {
    const Body& body = at.system.bodies[b];
    return body.inertia_inverse * (rotations_[b].transpose() * slopes_[b] +
                                   at.h * hat(angular_momentum(body, at.state.u[b].w)) * tangents_[b]);
  }

  void turn_impulses() {
    for (int b = 0; b < at.system.n(); ++b) {
      Twist& p = momentum_[b];
      p = {impulse_[b].v, transposed_times(rotations_[b], impulse_[b].w)};
      at.state.u[b] = velocity_of(at.system.bodies[b], p);
    }
    at.settle();
  }

  // The end of a RATTLE step. A composition has up to fifteen of them, so frames and momenta are added with compensated
  // sums. Computes the change of the momentum before the projection, and the momentum to be projected.
  void carry_on() {
    std::fill(change_.begin(), change_.end(), Twist{});
    for (int k = 0; k < at.nodes.parts(); ++k)
      at.start_joints.subtract_reaction(at.plan.parts[k], load3(&at.z[3 * at.nodes.lam(k)]), change_);
    for (int b = 0; b < at.system.n(); ++b) {
      const Mat3 turn = at.maps[b].turn();
      at.state.frames[b] = at.start.frames[b];
      carried_[b].frame.move(at.state.frames[b], at.h * at.xi[b].v, turn);
      Vec3& lost = carried_[b].momentum.w;
      lost += transposed_times(turn, lost);
      change_[b].v += impulse_time() * at.force[b].v;
      change_[b].w += impulse_time() * at.force[b].w + transposed_times(turn, impulse_[b].w);
    }
    applied_forces(at.system, at.state.frames, at.xi, at.start.angles, at.force);
    for (int b = 0; b < at.system.n(); ++b) {
      change_[b] += impulse_time() * at.force[b];
      impulse_[b] = momentum_[b] + change_[b];
      at.state.u[b] = velocity_of(at.system.bodies[b], impulse_[b]);
    }
    at.evaluate_joints();
  }
  void end_with_projection() {
    at.saddle.project(at.joints, impulse_, at.state.u, mu_.data(), change_, rates_);
    for (int b = 0; b < at.system.n(); ++b) add_compensated(momentum_[b], change_[b], carried_[b].momentum);
  }

  const bool rattle_;
  OwnSlopes own_;
  std::vector<Mat3> rotations_, slopes_, tangents_, velocity_slopes_;  // E, d(D* L)/dxi, T, dw/dxi
  // p is kept from step to step: M (M^-1 p) would make the same rounding error every time, a drift that grows with n.
  std::vector<Twist> momentum_, impulse_, change_;
  // The rounding errors of a body's position, attitude and momentum.
  struct Carried {
    CompensatedFrame frame;
    Twist momentum;
  };
  std::vector<Carried> carried_;
  std::vector<double> mu_;
  std::vector<double> rates_, rotor_momenta_;  // r and I r of the rotors
};
template <class Map>
using HamiltonStepper = EulerStepper<HamiltonEquations<Map>>;

// Symmetric compositions of RATTLE, (9.2) of docs/theory.md: successive steps of weights[0] h, weights[1] h, ...
template <class Map>
class CompositionStepper : public HamiltonStepper<Map> {
  using Rattle = HamiltonStepper<Map>;

 public:
  CompositionStepper(const Plan& plan, std::vector<double> weights)
      : Rattle(plan, Level::stabilised, true, HamiltonEquations<Map>::Kind::rattle),
        weights_(std::move(weights)),
        predictors_(weights_.size()) {}

  Status start(const State& state, double h) {
    whole_step_ = h;
    const Status status = Rattle::start(state, h);
    // Each stage is guessed from the same stage of earlier steps: from one stage to the next nothing is smooth.
    for (Predictor& predictor : predictors_) predictor.reset(this->unknowns());
    return status;
  }

  Status step(Counters& counters) {
    this->equations_.at.state.frames.begin_step(whole_step_);
    for (size_t i = 0; i < weights_.size(); ++i) {
      this->equations_.at.index1_output = i + 1 == weights_.size();  // (a, lam) only at the end of the step
      const Status status = this->advance(weights_[i] * whole_step_, predictors_[i], counters);
      if (status != Status::success) return status;
    }
    ++counters.steps;
    return Status::success;
  }
  Status cross() { return this->at_jump() ? start(State(this->state()), whole_step_) : Status::success; }

 private:
  std::vector<double> weights_;
  std::vector<Predictor> predictors_;
  double whole_step_ = 0;
};

}  // namespace lieeuler
