// Symplectic Lie group Euler methods for the constrained Hamilton equations, reconstructed from
// doi:10.1177/1687814019842406, in Hamilton-Pontryagin form (doi:10.1007/s10208-008-9030-4), with Lam = h lam and
// D*, Ad* acting on the rotational part:
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
// Unknowns: xi of each body, Lam of each joint.
#pragma once

#include "linalg/compensated.hpp"
#include "methods/euler.hpp"

namespace lieeuler {

template <class Map>
class HamiltonStepper : public EulerStepper<HamiltonStepper<Map>, Map> {
  using Base = EulerStepper<HamiltonStepper<Map>, Map>;
  friend Base;

 public:
  enum class Kind { euler, rattle };

  HamiltonStepper(const Plan& plan, Level level, bool index1_output, Kind kind = Kind::euler)
      : Base(plan, level, index1_output,
             {.second_order = level == Level::velocity, .eliminates = eliminates(plan, level)}),
        rattle_(kind == Kind::rattle),
        rotations_(system_.n() + 1),
        slopes_(system_.n()),
        tangents_(slopes_),
        velocity_slopes_(level == Level::velocity || (!rattle_ && !plan.slips.empty()) ? system_.n() : 0),
        momentum_(system_.n() + 1),
        impulse_(system_.n() + 1),
        change_(rattle_ ? system_.n() + 1 : 0),
        mu_(system_.rows() + system_.others(), 0.0),
        rates_(plan.rotors.size(), 0.0),
        rotor_momenta_(rates_) {
    if (!this->core_) find_blocks();
  }

  static constexpr bool has_velocity_rows(Level level) { return level == Level::velocity; }
  static constexpr bool projects(Level level) { return level == Level::stabilised; }
  static constexpr bool exact_matrix() { return true; }
  static constexpr bool fall_back() { return false; }
  static constexpr bool couples_by_springs() { return false; }

  Status residual(const std::vector<double>& z, std::vector<double>& r) {
    if (!configure(z)) return Status::map_domain;
    joints_.update(state_.frames);
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = system_.bodies[b];
      const Vec3 y = maps_[b].momentum(angular_momentum(body, xi_[b].w));
      store(Twist{body.mass * xi_[b].v - impulse_[b].v, y - impulse_[b].w}, &r[3 * nodes_.v(b)]);
      if (!velocity_slopes_.empty())
        state_.u[b] = {xi_[b].v, times(body.inertia_inverse, transposed_times(rotations_[b], y) - body.spin)};
    }
    for (int k = 0; k < nodes_.parts(); ++k)
      store(by_velocity() ? this->velocity_rows(k, state_, this->here(k))
                          : Vec3(this->here(k).position(this->part_of(k)) / h_),
            &r[3 * nodes_.lam(k)]);
    if (this->has_others_) complete_others(z, r);
    return Status::success;
  }

  void take_whole_matrix() {
    this->plan_matrix(false);
    find_blocks();
  }

  bool factor() {
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = system_.bodies[b];
      slopes_[b] = maps_[b].momentum_slope(xi_[b].w, angular_momentum(body, xi_[b].w), body.inertia, h_);
      tangents_[b] = maps_[b].left_tangent();
      if (!velocity_slopes_.empty()) velocity_slopes_[b] = velocity_slope(b);
    }
    return (this->core_ ? fill_core() : fill_matrix()) && this->factor_matrix();
  }

 private:
  using Base::h_, Base::joints_, Base::level_, Base::lu_, Base::maps_, Base::nodes_, Base::plan_, Base::start_,
      Base::state_;
  using Base::system_, Base::xi_, Base::z_, Base::force_;

  void find_blocks() {
    for (int b = 0; b < system_.n(); ++b)
      bodies_.push_back({lu_.block(nodes_.v(b), nodes_.v(b)), lu_.block(nodes_.w(b), nodes_.w(b))});
  }

  bool by_velocity() const { return level_ == Level::velocity; }
  double impulse_time() const { return rattle_ ? 0.5 * h_ : h_; }

  Status begin() {
    for (int b = 0; b < system_.n(); ++b) momentum_[b] = canonical_momentum(system_.bodies[b], state_.u[b]);
    if (rattle_) carried_.assign(system_.n(), {});
    for (size_t i = 0; i < rates_.size(); ++i)
      rotor_momenta_[i] =
          this->saddle_.rotor_rate(joints_, plan_.rotors[i], state_.u) / this->part_of(plan_.rotors[i]).compliance;
    return Status::success;
  }
  void guess(std::vector<double>& z) const {
    for (int b = 0; b < system_.n(); ++b) store(state_.u[b], &z[3 * nodes_.v(b)]);
    this->guess_multipliers(impulse_time(), z);
  }

  // q = q_n * (h xi) and the impulse p_n + h f_app(q_n, xi) - G_n^T Lam.
  bool configure(const std::vector<double>& z) {
    for (int b = 0; b < system_.n(); ++b) {
      xi_[b] = load(&z[3 * nodes_.v(b)]);
      if (!this->move(b)) return false;
      rotations_[b] = maps_[b].rotation();
    }
    applied_forces(system_, start_.frames, xi_, start_.angles, force_);
    for (int b = 0; b < system_.n(); ++b) {
      const Twist& p = momentum_[b];
      impulse_[b] = {p.v + impulse_time() * force_[b].v, p.w + impulse_time() * force_[b].w};
    }
    for (int k = 0; k < nodes_.parts(); ++k)
      this->subtract_reaction(k, this->before(k), load3(&z[3 * nodes_.lam(k)]), impulse_);
    return true;
  }

  // Rows of slip where others are those of position: of the velocity after the step; of RATTLE in the mean of the two
  // configurations of the step, by the velocity that leads from one to the other, which is symmetric in them.
  Vec3 slip_rows(int k) const {
    if (!rattle_) return this->velocity_rows(k, state_, this->here(k));
    const Twist &parent = xi_[this->body_of(k, kParent)], &child = xi_[this->body_of(k, kChild)];
    return 0.5 * (this->before(k).velocity(this->part_of(k), parent, child) +
                  this->here(k).velocity(this->part_of(k), parent, child));
  }

  // Completes the rows of slip, mimics and rotors. Not inlined: systems without them would pay for it.
  [[gnu::noinline, gnu::cold]] void complete_others(const std::vector<double>& z, std::vector<double>& r) const {
    for (int k : plan_.slips)
      if (!by_velocity()) store(slip_rows(k), &r[3 * nodes_.lam(k)]);
    this->unite_rows(&z[3 * nodes_.lam(0)], &r[3 * nodes_.lam(0)], !by_velocity());
    for (size_t i = 0; i < rates_.size(); ++i) {
      const int at = 3 * nodes_.lam(plan_.rotors[i]);
      r[at] = (by_velocity() ? r[at] : way_of(plan_.rotors[i]) / h_) -
              this->part_of(plan_.rotors[i]).compliance * (rotor_momenta_[i] + z[at]);
    }
  }

  // How far a rotor turns, or slides, in the step; the joint's angle alone gives it only up to whole turns.
  double way_of(int k) const {
    const Part& part = this->part_of(k);
    const double way = this->here(k).position(part)[0] - this->before(k).position(part)[0];
    if (!part.turn) return way;
    const double about =
        h_ * this->before(k).velocity(part, xi_[this->body_of(k, kParent)], xi_[this->body_of(k, kChild)])[0];
    return about + std::remainder(way - about, 2 * std::numbers::pi);
  }

  // Adds - h df_app/dxi; dampers act on the discrete velocity.
  void add_damper_blocks(size_t k) {
    const Force& force = system_.forces[k];
    if (force.damping == 0) return;
    const ForceState here(force, start_.frames, xi_, start_.angles[k]);
    for (Side row : kSides)
      for (Side column : kSides) {
        const PairBlocks& blocks = this->force_blocks_[4 * k + 2 * row + column];
        if (blocks.ww) blocks.add(-impulse_time(), here.by_velocity(row, column), Mat3::Identity());
      }
  }

  // Whether only rows of joints couple bodies: there are no dampers, and no loops whose dependent rows must be kept.
  static bool eliminates(const Plan& plan, Level level) {
    const std::vector<Force>& forces = plan.system.forces;
    return plan.plain() && (plan.forest || (level != Level::velocity && plan.independent)) &&
           std::all_of(forces.begin(), forces.end(), [](const Force& f) { return f.damping == 0; });
  }

  bool fill_core() {
    for (int b = 0; b < system_.n(); ++b)
      if (!this->core_->set_rotational(b, slopes_[b])) return false;
    struct Derivatives {
      const HamiltonStepper& stepper;
      Mat3 rotations(const Delassus::Place& place, const Mat3&) const { return stepper.anchor_rows(place); }
      Rows rows(const Delassus::Place& place, const Rows&) const { return stepper.row_slope(place.part, place.side); }
    };
    this->core_->assemble(Derivatives{*this}, Delassus::Jacobians{this->start_joints_});
    return true;
  }
  bool fill_matrix() {
    lu_.set_zero();
    for (int b = 0; b < system_.n(); ++b) {
      put_diagonal(bodies_[b].first, system_.bodies[b].mass);
      put(bodies_[b].second, slopes_[b]);
    }
    for (size_t k = 0; k < system_.forces.size(); ++k) add_damper_blocks(k);
    for (int k = 0; k < nodes_.parts(); ++k) {
      this->pad(k);
      for (Side side : kSides) {
        if (this->body_of(k, side) == system_.n()) continue;
        const SideBlocks& blocks = this->blocks_[2 * k + side];
        const Rows slope = row_slope(k, side);
        blocks.put_columns(this->before(k).jacobian(this->part_of(k), side));
        blocks.put_rows(slope.v, slope.w);
      }
    }
    this->pad_others();
    return true;
  }

  // Derivative of the rows with respect to xi.
  Rows row_slope(int k, Side side) const {
    const Part& part = this->part_of(k);
    const Rows G = this->here(k).jacobian(part, side);
    if (by_velocity() || part.slips) return rate_slope(k, side, G);
    return {G.v, G.w * tangents_[this->body_of(k, side)]};
  }
  // That of rows of velocity: G M^-1 p depends on xi by p_w = E^T y, by E, and by G. Not inlined: methods at position
  // level would pay for it.
  [[gnu::noinline]] Rows rate_slope(int k, Side side, const Rows& G) const {
    const Part& part = this->part_of(k);
    const int b = this->body_of(k, side);
    const Mat3& T = tangents_[b];
    const std::vector<Twist>& u = part.slips && rattle_ ? xi_ : state_.u;
    const Rows N =
        this->here(k).velocity_slope(part, side, u[this->body_of(k, kParent)], u[this->body_of(k, kChild)], false);
    if (part.slips && rattle_) {
      const Rows G_n = this->before(k).jacobian(part, side);
      return {0.5 * (G.v + G_n.v + h_ * N.v), 0.5 * (G.w + G_n.w + h_ * N.w * T)};
    }
    return {G.v + h_ * N.v, G.w * velocity_slopes_[b] + h_ * N.w * T};
  }
  // The same for a spherical part, with respect to rotations.
  Mat3 anchor_rows(const Delassus::Place& place) const {
    const JointState& joint = joints_[place.joint];
    const Mat3 G = joint.anchor_jacobian(place.side), &T = tangents_[place.body];
    if (!by_velocity()) return G * T;
    return G * velocity_slopes_[place.body] + h_ * joint.anchor_rate_slope(place.side, state_.u[place.body].w) * T;
  }
  // d(w)/dxi, w = J^-1 (E^T y - spin).
  Mat3 velocity_slope(int b) const {
    const Body& body = system_.bodies[b];
    return body.inertia_inverse *
           (rotations_[b].transpose() * slopes_[b] + h_ * hat(angular_momentum(body, state_.u[b].w)) * tangents_[b]);
  }

  Status finish() {
    if (!configure(z_)) return Status::map_domain;
    if (rattle_)
      carry_on();
    else
      turn_impulses();
    this->store_multipliers(impulse_time());
    for (size_t i = 0; i < rates_.size(); ++i) {
      const int k = plan_.rotors[i];
      rotor_momenta_[i] += z_[3 * nodes_.lam(k)];
      rates_[i] = this->part_of(k).compliance * rotor_momenta_[i];
    }
    if (level_ == Level::stabilised) {
      if (!this->saddle_.factor(joints_)) return Status::singular_matrix;
      if (rattle_)
        end_with_projection();
      else
        this->saddle_.project(joints_, momentum_, state_.u, mu_.data(), momentum_, rates_);
      for (size_t i = 0; i < rates_.size(); ++i) rotor_momenta_[i] += mu_[this->part_of(plan_.rotors[i]).row];
      for (size_t r = 0; r < mu_.size(); ++r) state_.lam[r] += mu_[r] / h_;
    }
    this->owes_output_ = this->index1_output_;  // factored above: index-1 output comes with stabilised
    if (!this->index1_output_ && !rattle_) accelerations_from_multipliers(system_, joints_, state_);
    return Status::success;
  }

  void turn_impulses() {
    for (int b = 0; b < system_.n(); ++b) {
      Twist& p = momentum_[b];
      p = {impulse_[b].v, transposed_times(rotations_[b], impulse_[b].w)};
      state_.u[b] = velocity_of(system_.bodies[b], p);
    }
    this->settle();
  }

  // The end of a RATTLE step. A composition has up to fifteen of them, so frames and momenta are added with compensated
  // sums. Computes the change of the momentum before the projection, and the momentum to be projected.
  void carry_on() {
    std::fill(change_.begin(), change_.end(), Twist{});
    for (int k = 0; k < nodes_.parts(); ++k)
      this->subtract_reaction(k, this->before(k), load3(&z_[3 * nodes_.lam(k)]), change_);
    for (int b = 0; b < system_.n(); ++b) {
      const Mat3 turn = maps_[b].turn();
      state_.frames[b] = start_.frames[b];
      carried_[b].frame.move(state_.frames[b], h_ * xi_[b].v, turn);
      Vec3& lost = carried_[b].momentum.w;
      lost += transposed_times(turn, lost);
      change_[b].v += impulse_time() * force_[b].v;
      change_[b].w += impulse_time() * force_[b].w + transposed_times(turn, impulse_[b].w);
    }
    applied_forces(system_, state_.frames, xi_, start_.angles, force_);
    for (int b = 0; b < system_.n(); ++b) {
      Twist &change = change_[b], &p = impulse_[b];
      change.v += impulse_time() * force_[b].v, change.w += impulse_time() * force_[b].w;
      p = {momentum_[b].v + change.v, momentum_[b].w + change.w};
      state_.u[b] = velocity_of(system_.bodies[b], p);
    }
    this->evaluate_joints();
  }
  void end_with_projection() {
    this->saddle_.project(joints_, impulse_, state_.u, mu_.data(), change_, rates_);
    for (int b = 0; b < system_.n(); ++b) add_compensated(momentum_[b], change_[b], carried_[b].momentum);
  }

  const bool rattle_;
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
  std::vector<double> rates_, rotor_momenta_;        // r and I r of the rotors
  std::vector<std::pair<double*, double*>> bodies_;  // diagonal blocks of v and w
};

}  // namespace lieeuler
