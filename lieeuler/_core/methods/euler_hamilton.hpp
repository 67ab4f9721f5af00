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
// Unknowns: xi of each body, Lam of each joint. Newton's matrix is (7.3) of docs/theory.md.
#pragma once

#include "methods/newton.hpp"

namespace lieeuler {

class HamiltonEquations : public StepEquations {
 public:
  // The share is the part of the step for which impulses at its start act.
  HamiltonEquations(const Plan& plan, CoordinateMap map, Level level, bool index1_output, double share = 1)
      : StepEquations(plan, map, level, index1_output,
                      {.solves_velocities = level == Level::velocity,
                       .second_order = level == Level::velocity,
                       .eliminates = eliminates(plan, level)}),
        share_(share) {}

  Status begin() override {
    for (int b = 0; b < system.n(); ++b) momentum_[b] = canonical_momentum(system.bodies[b], state.u[b]);
    for (size_t i = 0; i < rates_.size(); ++i)
      rotor_momenta_[i] =
          joints.velocity(plan.parts[plan.rotors[i]], state.u)[0] / plan.part(plan.rotors[i]).compliance;
    return Status::success;
  }
  void guess() override {
    for (int b = 0; b < system.n(); ++b) store(state.u[b], &z[3 * nodes.v(b)]);
    guess_multipliers(impulse_time());
  }
  Status residual(std::vector<double>& r) override {
    if (!configure()) return Status::map_domain;
    joints.update(state.frames);
    for (int b = 0; b < system.n(); ++b) {
      const Body& body = system.bodies[b];
      const Vec3 y = maps[b].momentum(angular_momentum(body, xi[b].w));
      store(Twist{body.mass * xi[b].v - impulse_[b].v, y - impulse_[b].w}, &r[3 * nodes.v(b)]);
      if (slopes_of_rates_)
        state.u[b] = {xi[b].v, times(body.inertia_inverse, transposed_times(rotations[b], y) - body.spin)};
    }
    for (int k = 0; k < nodes.parts(); ++k)
      store(by_velocity() ? velocity_rows(k, state) : Vec3(here(k).position(plan.part(k)) / h), &r[3 * nodes.lam(k)]);
    if (has_others) put_others(r);
    return Status::success;
  }

  bool factor() override {
    for (int b = 0; b < system.n(); ++b) {
      const Body& body = system.bodies[b];
      slopes_[b] = maps[b].momentum_slope(xi[b].w, angular_momentum(body, xi[b].w), body.inertia, h);
      tangents[b] = maps[b].left_tangent();
      if (slopes_of_rates_) velocity_slopes_[b] = angular_slope(b);
    }
    return (core ? fill_core() : fill_matrix()) && factor_matrix();
  }
  Status finish() override {
    if (!configure()) return Status::map_domain;
    complete();
    store_multipliers(impulse_time());
    for (size_t i = 0; i < rates_.size(); ++i) {
      const int k = plan.rotors[i];
      rotor_momenta_[i] += z[3 * nodes.lam(k)];
      rates_[i] = plan.part(k).compliance * rotor_momenta_[i];
    }
    if (level == Level::stabilised) {
      if (!saddle.factor(joints)) return Status::singular_matrix;
      project();
      for (size_t i = 0; i < rates_.size(); ++i) rotor_momenta_[i] += mu_[plan.part(plan.rotors[i]).row];
      for (size_t r = 0; r < mu_.size(); ++r) state.lam[r] += mu_[r] / h;
    }
    owes_output = true;  // factored above: index-1 output comes with stabilised
    return Status::success;
  }
  bool projects() const override { return level == Level::stabilised; }
  // a = M^-1 (f - G^T lam). Multipliers of the step act at q_n. Around a loop large ones cancel at thin bodies there,
  // but no more at q: with redundant rows those are taken that come nearest at q to the impulse of the joints, p less
  // p_n and its forces.
  void output() override {
    if (index1_output) return saddle.accelerate(joints, state);
    std::vector<Twist>& a = state.a;
    if (level == Level::stabilised && saddle.redundant() > 0 && !has_others) {
      std::vector<Vec3> rows(plan.count(), Vec3::Zero());
      for (int b = 0; b < system.n(); ++b) {
        const Twist pushed = canonical_momentum(system.bodies[b], start.u[b]) + h * force[b];
        a[b] = {pushed.v - momentum_[b].v, transposed_times(rotations[b], pushed.w) - momentum_[b].w};
      }
      saddle.solve(a, rows, true);
      for (int k = 0; k < plan.count(); ++k) store(rows[k], &z[3 * nodes.lam(k)]);
      store_multipliers(h);
    }
    generalized_forces(system, state.frames, state.u, state.angles, a);
    for (const PlacedPart& placed : plan.parts) {
      Vec3 lam = Vec3::Zero();
      std::copy_n(&state.lam[placed.part->row], placed.part->rows(), lam.data());
      joints.subtract_reaction(placed, lam, a);
    }
    for (int b = 0; b < system.n(); ++b) a[b] = velocity(system.bodies[b], a[b]);
    a[system.n()] = Twist{};
  }

 protected:
  double impulse_time() const { return share_ * h; }

  // Rows of slip where others are those of position, and their derivative with respect to xi: of the velocity after the
  // step.
  virtual Vec3 slip_rows(int k) const { return velocity_rows(k, state); }
  virtual Rows slip_slope(int k, Side side, const Rows& G) const { return rate_slope(k, side, G); }
  // The new state, and its momentum before the projection.
  virtual void complete() {
    for (int b = 0; b < system.n(); ++b) {
      Twist& p = momentum_[b];
      p = {impulse_[b].v, transposed_times(rotations[b], impulse_[b].w)};
      state.u[b] = velocity_of(system.bodies[b], p);
    }
    settle();
  }
  virtual void project() { saddle.project(joints, momentum_, state.u, mu_.data(), momentum_, rates_); }

  // p is kept from step to step: M (M^-1 p) would make the same rounding error every time, a drift that grows with n.
  std::vector<Twist> momentum_ = xi, impulse_ = xi;
  std::vector<double> mu_ = std::vector<double>(system.rows() + system.others());
  std::vector<double> rates_ = std::vector<double>(plan.rotors.size());  // of the rotors

 private:
  bool by_velocity() const { return level == Level::velocity; }

  // q = q_n * (h xi) and the impulse p_n + h f_app(q_n, xi) - G_n^T Lam.
  bool configure() {
    for (int b = 0; b < system.n(); ++b) {
      xi[b] = load(&z[3 * nodes.v(b)]);
      if (!move(b)) return false;
    }
    applied_forces(system, start.frames, xi, start.angles, force);
    for (int b = 0; b < system.n(); ++b) impulse_[b] = momentum_[b] + impulse_time() * force[b];
    for (int k = 0; k < nodes.parts(); ++k)
      start_joints.subtract_reaction(plan.parts[k], load3(&z[3 * nodes.lam(k)]), impulse_);
    return true;
  }

  // Completes the rows of slip, mimics and rotors. Not inlined: systems without them would pay for it.
  [[gnu::noinline, gnu::cold]] void put_others(std::vector<double>& r) const {
    for (int k : plan.slips)
      if (!by_velocity()) store(slip_rows(k), &r[3 * nodes.lam(k)]);
    unite_rows(&z[3 * nodes.lam(0)], &r[3 * nodes.lam(0)], !by_velocity());
    for (size_t i = 0; i < rates_.size(); ++i) {
      const int row = 3 * nodes.lam(plan.rotors[i]);
      r[row] = (by_velocity() ? r[row] : way_of(plan.rotors[i]) / h) -
               plan.part(plan.rotors[i]).compliance * (rotor_momenta_[i] + z[row]);
    }
  }

  // How far a rotor turns, or slides, in the step; the joint's angle alone gives it only up to whole turns.
  double way_of(int k) const {
    const Part& part = plan.part(k);
    const double way = here(k).position(part)[0] - before(k).position(part)[0];
    if (!part.turn) return way;
    const double about = h * start_joints.velocity(plan.parts[k], xi)[0];
    return about + std::remainder(way - about, 2 * std::numbers::pi);
  }

  // Adds - h df_app/dxi; dampers act on the discrete velocity.
  void add_damper_blocks(size_t k) {
    const Force& force = system.forces[k];
    if (force.damping == 0) return;
    const ForceState here(force, start.frames, xi, start.angles[k]);
    const bool own = force.kind == Force::Kind::own;  // what couples a body with itself comes with the ground
    for (Side row : kSides)
      for (Side column : kSides) {
        const PairBlocks& blocks = force_blocks[4 * k + 2 * row + column];
        if (!blocks.ww || (own && row == column && force.parent != system.n())) continue;
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
    for (int b = 0; b < system.n(); ++b)
      if (!core->set_rotational(b, slopes_[b])) return false;
    struct Derivatives {
      const HamiltonEquations& equations;
      Mat3 rotations(const Delassus::Place& place, const Mat3&) const { return equations.anchor_rows(place); }
      Rows rows(const Delassus::Place& place, const Rows&) const { return equations.row_slope(place.part, place.side); }
    };
    core->assemble(Derivatives{*this}, Delassus::Jacobians{start_joints});
    return true;
  }
  bool fill_matrix() {
    lu.set_zero();
    for (int b = 0; b < system.n(); ++b) {
      put_diagonal(body_blocks[b].v, system.bodies[b].mass);
      put(body_blocks[b].w, slopes_[b]);
    }
    if (!system.own.empty()) own_.find(system, start.frames, xi, false);
    for (size_t k = 0; k < system.forces.size(); ++k) add_damper_blocks(k);
    for (int k = 0; k < nodes.parts(); ++k) {
      pad(k);
      for (Side side : kSides) {
        if (plan.body(k, side) == system.n()) continue;
        const SideBlocks& blocks = part_blocks[2 * k + side];
        const Rows slope = row_slope(k, side);
        blocks.put_columns(before(k).jacobian(plan.part(k), side));
        blocks.put_rows(slope.v, slope.w);
      }
    }
    pad_others();
    return true;
  }

  // Derivative of the rows with respect to xi.
  Rows row_slope(int k, Side side) const {
    const Part& part = plan.part(k);
    const Rows G = here(k).jacobian(part, side);
    if (by_velocity()) return rate_slope(k, side, G);
    if (part.slips) return slip_slope(k, side, G);
    return {G.v, G.w * tangents[plan.body(k, side)]};
  }
  // That of rows of velocity: G M^-1 p depends on xi by p_w = E^T y, by E, and by G. Not inlined: methods at position
  // level would pay for it.
  [[gnu::noinline]] Rows rate_slope(int k, Side side, const Rows& G) const {
    const int b = plan.body(k, side);
    const Rows N = velocity_slope(k, side, state.u, false);
    return {G.v + h * N.v, G.w * velocity_slopes_[b] + h * N.w * tangents[b]};
  }
  // The same for a spherical part, with respect to rotations.
  Mat3 anchor_rows(const Delassus::Place& place) const {
    const JointState& joint = joints[place.joint];
    const Mat3 G = joint.anchor_jacobian(place.side), &T = tangents[place.body];
    if (!by_velocity()) return G * T;
    return G * velocity_slopes_[place.body] + h * joint.anchor_rate_slope(place.side, state.u[place.body].w) * T;
  }
  // d(w)/dxi, w = J^-1 (E^T y - spin).
  Mat3 angular_slope(int b) const {
    const Body& body = system.bodies[b];
    return body.inertia_inverse *
           (rotations[b].transpose() * slopes_[b] + h * hat(angular_momentum(body, state.u[b].w)) * tangents[b]);
  }

  const double share_;
  const bool slopes_of_rates_ = by_velocity() || (share_ == 1 && !plan.slips.empty());
  std::vector<Mat3> slopes_ = tangents, velocity_slopes_ = tangents;  // d(D* L)/dxi, dw/dxi
  std::vector<double> rotor_momenta_ = rates_;                        // I r of the rotors
  OwnSlopes own_;
};

}  // namespace lieeuler
