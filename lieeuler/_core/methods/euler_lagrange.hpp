// Implicit Lie group methods for the Lagrangian equations, (4.1) of docs/theory.md, all at n+1 but u_n, q_n and G_n:
//
//   M (u - u_n) = h f(q, u) - G^T Lam,   Lam = h lam,   q = q_n * (h xi)
//
// What they share, and the stabilised ones, reconstructed from doi:10.1177/1687814019842406:
//
//   Phi(q) = 0,   G u = 0,   M xi = M u - G_n^T mu                  DAE2L_LSE, DAE1L_LSE
//
// Rows of slip, A u = 0 alone, have no mu, (18.1) of docs/theory.md. The correction of xi is weighted with the mass;
// the plain one, xi = u - G_n^T mu, is that of Gear, Gupta and Leimkuhler.
//
// Unknowns: u of each body, Lam of each joint; when stabilised also xi and mu. Newton's matrix is (7.1), or (7.2) of
// docs/theory.md. Methods of other rows are in methods/unstabilised.hpp; other numbers make these equations those of
// methods/generalized_alpha.hpp.
#pragma once

#include "methods/newton.hpp"

namespace lieeuler {

class LagrangeEquations : public StepEquations {
 public:
  // The shares are theta / h and rho of generalized-alpha, 1 of implicit Euler.
  LagrangeEquations(const Plan& plan, CoordinateMap map, Level level, bool index1_output, const Layout& layout,
                    double force_share = 1, double velocity_share = 1)
      : StepEquations(plan, map, level, index1_output, layout),
        force_share(force_share),
        velocity_share(velocity_share) {
    if (!core) find_blocks();
    for (int k = 0; k < nodes.parts(); ++k) {
      const Part& part = plan.part(k);
      if (part.spherical || part.turn) continue;
      const bool grounded = plan.body(k, kParent) == system.n() || plan.body(k, kChild) == system.n();
      if (!grounded || !AxisRows::suits(part)) coupled_.push_back(k);
    }
  }

  void guess() override {
    for (int b = 0; b < system.n(); ++b)
      store(state.u[b], &z[3 * nodes.v(b)]), store(state.u[b], &z[3 * nodes.xi_v(b)]);
    guess_multipliers(force_time());
  }
  bool factor() override {
    for (int b = 0; b < system.n(); ++b) tangents[b] = maps[b].left_tangent();
    return (core ? fill_core() : fill_matrix()) && factor_matrix();
  }
  bool couples_by_springs() const override {
    constexpr double kStiff = 0.2;  // step over a spring's time; its square is the error that an iteration leaves
    return std::abs(h) * system.frequency > kStiff;
  }
  void take_whole_matrix(const Constraints& joints) override {
    StepEquations::take_whole_matrix(joints);
    find_blocks();
  }
  Status finish() override {
    if (!configure()) return Status::map_domain;
    settle();
    if (index1_output) return owe_index1();
    store_multipliers(h);
    for (int b = 0; b < system.n(); ++b) state.a[b] = (state.u[b] - start.u[b]) / h;
    return Status::success;
  }

  // theta: the time for which a force acts in a step.
  double force_time() const { return force_share * h; }
  // Derivative of the rows of velocity with respect to xi.
  Rows rate_slope(int k, Side side) const {
    const Rows N = velocity_slope(k, side, state.u, false);
    return {slope_time() * N.v, slope_time() * N.w * tangents[plan.body(k, side)]};
  }
  // balance -= rho h K T xi, with what a matrix with the bodies eliminated leaves out of K, the derivative of reactions
  // and forces by positions: what couples bodies, or rotations with translations.
  void subtract_left_out(const std::vector<Twist>& xi, std::vector<Twist>& balance) {
    for (int b = 0; b < system.n(); ++b) turned_[b] = {xi[b].v, times(tangents[b], xi[b].w)};
    for (int k : coupled_) {
      const int parent = plan.body(k, kParent), child = plan.body(k, kChild);
      for (Side side : kSides)
        balance[plan.body(k, side)] -=
            here(k).coupled_reaction(plan.part(k), side, slope_impulse(k), turned_[parent], turned_[child]);
    }
    add_slopes(force_time() * slope_time(), turned_, balance, &ForceState::by_position);
    if (damped) add_slopes(force_time(), xi, balance, &ForceState::by_velocity);
  }
  // balance += factor times the derivatives of the forces along a motion.
  void add_slopes(double factor, const std::vector<Twist>& motion, std::vector<Twist>& balance,
                  Stiffness (ForceState::*slope)(Side, Side) const) const {
    for (size_t k = 0; k < system.forces.size(); ++k) {
      const Force& force = system.forces[k];
      const ForceState here(force, state.frames, state.u, start.angles[k]);
      for (Side row : kSides)
        for (Side column : kSides) {
          const Stiffness K = (here.*slope)(row, column);
          const Twist& along = motion[column == kChild ? force.child : force.parent];
          Twist& own = balance[row == kChild ? force.child : force.parent];
          own.v += factor * (K.vv * along.v + K.vw * along.w), own.w += factor * (K.wv * along.v + K.ww * along.w);
        }
    }
  }

  const double force_share, velocity_share;
  const bool damped = system.damped();

 protected:
  // The velocities from which u changes in a step; zero for the ground.
  virtual const std::vector<Twist>& from() const { return start.u; }
  // u, xi and the configuration of z; false outside the map's domain.
  virtual bool configure() {
    for (int b = 0; b < system.n(); ++b) {
      state.u[b] = load(&z[3 * nodes.v(b)]);
      xi[b] = load(&z[3 * nodes.xi_v(b)]);
      if (!move(b)) return false;
    }
    return true;
  }
  // M (u - from) - theta f + G^T Lam of every body, at the new state.
  void put_balance(std::vector<double>& r) {
    joints.update(state.frames);
    generalized_forces(system, state.frames, state.u, start.angles, force);
    const std::vector<Twist>& from = this->from();
    for (int b = 0; b < system.n(); ++b) {
      const Body& body = system.bodies[b];
      const Twist &f = force[b], gain = load(&z[3 * nodes.v(b)]) - from[b];
      balance_[b] = {body.mass * gain.v - force_time() * f.v, times(body.inertia, gain.w) - force_time() * f.w};
    }
    for (int k = 0; k < nodes.parts(); ++k)
      joints.subtract_reaction(plan.parts[k], -load3(&z[3 * nodes.lam(k)]), balance_);
    for (int b = 0; b < system.n(); ++b) store(balance_[b], &r[3 * nodes.v(b)]);
  }
  // Completes the rows of Lam of mimics and rotors. Not inlined: systems without them would pay for it.
  [[gnu::noinline, gnu::cold]] void put_others(std::vector<double>& r, bool positions) const {
    unite_rows(&z[3 * nodes.lam(0)], &r[3 * nodes.lam(0)], positions);
    for (int k : plan.rotors) r[3 * nodes.lam(k)] = rotor_gain(k) - plan.part(k).compliance * z[3 * nodes.lam(k)];
  }
  // The change of a rotor's rate in the step: of methods that take accelerations at the new state s (u - from) +
  // theta (ds/dt) u, of others the difference of the rates at the two states.
  virtual bool accelerates() const { return false; }
  double rotor_gain(int k) const {
    const PlacedPart& part = plan.parts[k];
    const double rate = joints.velocity(part, state.u)[0];
    if (!accelerates()) return rate - start_joints.velocity(part, start.u)[0];
    return rate - joints.velocity(part, from())[0] + force_time() * joints.gamma(part, state.u)[0];
  }
  // Its derivatives with respect to u and xi; with accelerations, second derivatives of s are left out.
  std::pair<Rows, Rows> rotor_slopes(int k, Side side) const {
    const Rows G = here(k).jacobian(plan.part(k), side), N = velocity_slope(k, side, state.u, accelerates());
    if (!accelerates()) return {G, {h * N.v, h * N.w * tangents[plan.body(k, side)]}};
    return {{G.v + force_time() * N.v, G.w + force_time() * N.w}, {}};
  }

  // Whether rows of joints alone couple bodies, in the derivatives too: trees of spherical joints without forces.
  static bool is_spherical_tree(const Plan& plan) {
    return plan.system.forces.empty() && plan.plain() && plan.forest &&
           std::ranges::all_of(plan.parts, [](const PlacedPart& placed) { return placed.part->spherical; });
  }
  // Whether sweeps over what a smaller matrix leaves out converge by construction: without loops unless dependent rows
  // are dropped, and without forces of whose sizes nothing is known.
  static bool sweeps_converge(const Plan& plan) {
    return plan.system.own.empty() && plan.plain() && plan.slips.empty() && (plan.forest || plan.independent);
  }
  // Whether the matrix with the bodies eliminated leaves out how forces and rows of dot products couple bodies.
  bool incomplete() const { return core && saddle.dropped(); }

  // What a slope along xi is multiplied by, and Lam times that.
  double slope_time() const { return slope_share * h; }
  Vec3 slope_impulse(int k) const { return slope_time() * load3(&z[3 * nodes.lam(k)]); }

  // Rows of position.
  struct PositionRows {
    const std::vector<Mat3>& tangents;
    Mat3 rotations(const Delassus::Place& place, const Mat3& G) const { return G * tangents[place.body]; }
    Rows rows(const Delassus::Place& place, const Rows& G) const { return {G.v, rotations(place, G.w)}; }
  };
  // The matrix with the bodies eliminated: a rotational block per body, and the rows of the parts. Coupling of bodies
  // by dot rows is left to the iteration: it is O(h^2).
  virtual bool fill_core() { return fill_core(PositionRows{tangents}); }
  template <class RowsOf>
  bool fill_core(const RowsOf& rows) {
    for (int b = 0; b < system.n(); ++b) rotational_[b].setZero();
    for (int k = 0; k < nodes.parts(); ++k) {
      const Vec3 impulse = slope_impulse(k);
      for (Side side : kSides) {
        const int b = plan.body(k, side);
        if (b == system.n()) continue;
        if (plan.part(k).spherical)
          rotational_[b] += here(k).anchor_stiffness(side, impulse);
        else
          rotational_[b] += here(k).own_stiffness(plan.part(k), side, impulse);
      }
    }
    for (int b = 0; b < system.n(); ++b)
      if (!core->set_rotational(b, inertia_block(b) + rotational_[b] * tangents[b])) return false;
    core->assemble(rows, Delassus::Jacobians{joints});
    return true;
  }

  // The matrix of all bodies and rows.
  virtual bool fill_matrix() {
    lu.set_zero();
    for (int b = 0; b < system.n(); ++b) {
      put_diagonal(body_blocks[b].v, system.bodies[b].mass);
      put(body_blocks[b].w, inertia_block(b));
    }
    if (!system.own.empty()) own_.find(system, state.frames, state.u, true);
    for (size_t k = 0; k < system.forces.size(); ++k) add_force_blocks(k);
    for (int k = 0; k < nodes.parts(); ++k) {
      pad(k);
      for (Side row : kSides)
        for (Side column : kSides) add_stiffness_blocks(k, row, column);
      for (Side side : kSides) {
        if (plan.body(k, side) == system.n()) continue;
        const Rows G = here(k).jacobian(plan.part(k), side);
        part_blocks[2 * k + side].put_columns(G);
        put_rows(k, side, G);
      }
    }
    for (int k : plan.rotors)
      for (Side side : kSides) {
        if (plan.body(k, side) == system.n()) continue;
        const auto [by_u, by_xi] = rotor_slopes(k, side);
        put_rates(k, side, by_u, by_xi);
      }
    pad_others();
    return true;
  }
  // The derivatives of the rows of one side of a part with Jacobian G.
  virtual void put_rows(int k, Side side, const Rows& G) = 0;
  // Derivatives of rows with respect to u and xi, which are the same unknowns in a matrix that is not doubled.
  void put_rates(int k, Side side, const Rows& by_u, const Rows& by_xi) {
    if (!columns.doubled()) return part_blocks[2 * k + side].put_rows(by_u.v + by_xi.v, by_u.w + by_xi.w);
    part_blocks[2 * k + side].put_rows(by_u.v, by_u.w);
    rates_[2 * k + side].put_rows(by_xi.v, by_xi.w);
  }

  double slope_share = 1;

 private:
  // J - theta df/du of the gyroscopic torque.
  Mat3 inertia_block(int b) const {
    const Body& body = system.bodies[b];
    const Vec3& w = state.u[b].w;
    return body.inertia + force_time() * gyroscopic_slope(w, angular_momentum(body, w), body.inertia);
  }
  // Adds h d(G^T Lam)/dq T to the columns of xi.
  void add_stiffness_blocks(int k, Side row, Side column) {
    const PairBlocks& blocks = stiffness_[4 * k + 2 * row + column];
    const Part& part = plan.part(k);
    if (!blocks.ww || (part.spherical && row != column)) return;
    const Mat3& T = tangents[plan.body(k, column)];
    if (part.spherical) return add(blocks.ww, here(k).anchor_stiffness(row, slope_impulse(k)) * T);  // the only block
    blocks.add(1, here(k).geometric_stiffness(part, row, column, slope_impulse(k)), T);
  }
  // Adds - theta df/du to the columns of u, and - theta h df/dq T to those of xi. Of the user's forces, what couples a
  // body with itself comes with its pair with the ground.
  void add_force_blocks(size_t k) {
    const Force& force = system.forces[k];
    const ForceState here(force, state.frames, state.u, start.angles[k]);
    const bool own = force.kind == Force::Kind::own;
    for (Side row : kSides)
      for (Side column : kSides) {
        const PairBlocks& by_position = springs_[4 * k + 2 * row + column];
        if (!by_position.ww || (own && row == column && force.parent != system.n())) continue;
        const int to = row == kChild ? force.child : force.parent, by = column == kChild ? force.child : force.parent;
        by_position.add(-force_time() * slope_time(), own ? own_.by_position(to, by) : here.by_position(row, column),
                        tangents[by]);
        if (force.damping == 0 && !own) continue;
        force_blocks[4 * k + 2 * row + column].add(
            -force_time(), own ? own_.by_velocity(to, by) : here.by_velocity(row, column), Mat3::Identity());
      }
  }
  void find_blocks() {
    stiffness_.clear(), springs_.clear(), rates_.clear();
    for (int k = 0; k < nodes.parts(); ++k) {
      append_pairs(plan.body(k, kParent), plan.body(k, kChild), true, stiffness_);
      for (int b : plan.parts[k].bodies)
        rates_.push_back(side_blocks(columns.lam(k), columns.doubled() ? b : system.n(), true));
    }
    for (const Force& force : system.forces) append_pairs(force.parent, force.child, true, springs_);
  }

  std::vector<int> coupled_;  // parts of which the matrix with the bodies eliminated lacks something
  std::vector<Twist> balance_ = xi, turned_ = xi;
  std::vector<Mat3> rotational_ = tangents;  // stiffness, by the rotation of the own body
  OwnSlopes own_;
  // Blocks that only Lagrangian steps have: columns of xi, per part or force, row side, column side; those in rows of
  // velocity, per part and side.
  std::vector<PairBlocks> stiffness_, springs_;
  std::vector<SideBlocks> rates_;
};

// The linear systems of stabilised equations, in two parts instead of one of twice the size.
//
// Newton's system (7.2) of docs/theory.md for (du, dLam, dxi, dmu), with A = M - theta df/du, K the stiffness onto xi,
// N the slope of the velocity rows, and the theta and rho of generalized-alpha (h and 1 of implicit Euler), is
//
//   A du + h K dxi + G^T dLam = r_u        M (dxi - rho du) + Gn^T dmu = r_xi
//   G du + h N dxi            = r_lam      G T dxi                     = r_mu
//
// The equation on the upper right gives du. The others, with c = rho dLam + dmu, are coupled only by
// E = A M^-1 Gn^T - G^T = O(h):
//
//   [A + rho h K, G^T; G T, 0] (dxi, c) = (rho r_u + A M^-1 r_xi - E dmu, r_mu)
//   G M^-1 Gn^T dmu                     = rho r_lam + G M^-1 r_xi - (G + rho h N) dxi
//
// (G + rho h N) dxi differs from r_mu by O(h) dxi, which changes little from one step to the next. So dmu is well known
// beforehand, and a sweep over the two systems reduces the error by O(h^2).
//
// With bodies eliminated beforehand A + rho h K lacks the blocks of K that couple bodies, and those of springs. They
// are O(h^2) beside A, and what they add is subtracted in the same sweeps: K dxi beside E dmu. If they are too large
// for that, they are left to Newton's iteration, and the matrix is not exact.
//
// S at q_n, which differs by O(h), replaces S = G M^-1 Gn^T as long as each pass over the residual rows reduces them
// well.
class StabilisedSolve {
 public:
  // S of q_n must be factored in `at` when the iteration of a step begins.
  explicit StabilisedSolve(LagrangeEquations& at) : at(at) {}

  // Takes the rows at the guess.
  void linearise() {
    if (at.h != h_) forget();
    h_ = at.h, fresh_ = false;
    for (int k = 0; k < plan_.count(); ++k)
      for (Side side : kSides)
        if (!plan_.part(k).spherical && plan_.body(k, side) != system_.n())
          slopes_[2 * k + side] = at.rate_slope(k, side);
  }
  // Whether the last solve had all blocks.
  bool exact() const { return exact_; }
  // Drops the guess that one step leaves for the next.
  void forget() { std::fill(excess_.begin(), excess_.end(), Vec3::Zero()); }
  // Solves for the corrections: r becomes (du, dLam, dxi, dmu). incomplete: rho h K dxi lacks something in the first
  // matrix. False if the sweeps do not converge. The rows of position and velocity are satisfied in any case: the first
  // system contains the former, and dmu is solved last.
  bool solve(std::vector<double>& r, bool incomplete) {
    const double length = at.length, tolerance = at.target() / std::abs(h_);  // rounding error of dxi
    double coupling = kCaution * start(r);
    double last = std::numeric_limits<double>::infinity(), pull = 0;
    double stiffness = last;
    exact_ = true;
    for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
      at.solve_matrix(core_rhs_.data());
      for (size_t i = 0; i < total_.size(); ++i) total_[i] = sweep == 0 ? core_rhs_[i] : total_[i] + core_rhs_[i];
      if (!follow(tolerance * length)) return false;
      const double change = largest(correction_);
      const bool settled = coupling * change <= kRounding * tolerance;
      if (settled && !incomplete) return finish(r);
      if (incomplete) {
        const double motion = note_motion();
        if (settled && stiffness * motion <= kRounding * tolerance) return finish(r);
        std::fill(pull_.begin(), pull_.end(), Twist{});
        at.subtract_left_out(moved_, pull_);
        pull = size_of(pull_);
        stiffness = kCaution * pull / motion;
        if (!(pull < kSlow * motion)) incomplete = exact_ = pull == 0;
      }
      std::fill(core_rhs_.begin(), core_rhs_.end(), 0.0);
      const double left = couple();
      coupling = std::max(coupling, kCaution * left / change);
      if (incomplete) add(pull_);
      if (left <= kRounding * tolerance && (!incomplete || pull <= kRounding * tolerance)) return finish(r);
      if (left > kRounding * tolerance && !(left < kSlow * last)) {
        if (!incomplete) return left <= kNoise * tolerance && finish(r);
        incomplete = exact_ = false;
      }
      last = left;
    }
    return false;
  }

 private:
  static constexpr int kMostSweeps = 12;
  static constexpr double kSlow = 0.3;
  static constexpr double kNoise = 1e3;   // times the tolerance; below it, changes that no longer shrink are rounding
  static constexpr double kCaution = 10;  // safety factor on the size of E, measured along one direction
  static constexpr double kStale = 0.01;  // a pass that reduces the rows less than this renews S
  static constexpr double kRounding = 4;  // times the tolerance: rounding error of the products of a sweep

  // A M^-1 y - y for one body, theta times the slope of the gyroscopic torque: rotations only. `rate` is M^-1 y.
  Vec3 gyroscopic(int b, const Vec3& y, const Vec3& rate) const {
    const Vec3& w = at.state.u[b].w;
    return at.force_time() * (w.cross(y) - angular_momentum(system_.bodies[b], w).cross(rate));
  }
  static double largest(const std::vector<double>& values) {
    double size = 0;
    for (double value : values) size = std::max(size, std::abs(value));
    return size;
  }
  // Sets the first right-hand sides, with dmu for the (G + rho h N) dxi - r_mu of the last solve. Returns the size of
  // E, measured as M^-1 E dmu over dmu.
  double start(const std::vector<double>& r) {
    const Nodes& nodes = at.nodes;
    for (int b = 0; b < system_.n(); ++b) {
      const Twist own = load(&r[3 * nodes.v(b)]), drift = load(&r[3 * nodes.xi_v(b)]);
      shift_[b] = velocity(system_.bodies[b], drift);
      store(Twist{rho_ * own.v + drift.v, rho_ * own.w + drift.w + gyroscopic(b, drift.w, shift_[b].w)},
            &core_rhs_[6 * b]);
    }
    for (int k = 0; k < plan_.count(); ++k) {
      const Vec3 position = load3(&r[3 * nodes.mu(k)]), rate = load3(&r[3 * nodes.lam(k)]);
      store(position, &core_rhs_[6 * system_.n() + 3 * k]);
      guessed_[k] = position + excess_[k];
      store(Vec3(guessed_[k] - rho_ * rate - row_rate(k, shift_)), &rows_[3 * k]);
      excess_[k] = -position;
    }
    delassus_.zero_dropped(rows_.data());
    std::fill(balance_.begin(), balance_.end(), Twist{});
    if (at.damped) add_damping(shift_), add(balance_);
    std::fill(mu_.begin(), mu_.end(), 0.0);
    clear_correction();
    pass();
    accept_correction();
    const double multipliers = largest(correction_), coupled = couple();
    return multipliers > 0 ? coupled / multipliers : std::numeric_limits<double>::infinity();
  }
  // Changes dmu for the latest change of dxi, in core_rhs_, beyond what was guessed for it, until the residual of the
  // rows is at most `wanted`, or rounding. False if S is singular.
  bool follow(double wanted) {
    for (int b = 0; b < system_.n(); ++b) velocity_[b] = load(&core_rhs_[6 * b]);
    velocity_[system_.n()] = Twist{};
    for (int k = 0; k < plan_.count(); ++k) {
      const Vec3 rate = row_rate(k, velocity_) + slope_rate(k);
      store(Vec3(load3(&rows_[3 * k]) + rate - guessed_[k]), &rows_[3 * k]);
      excess_[k] += rate;
      guessed_[k].setZero();
    }
    delassus_.zero_dropped(rows_.data());
    clear_correction();
    double last = largest(rows_);
    for (;;) {
      pass();
      const double left = largest(rows_);
      if (left <= wanted || fresh_) break;
      const bool stale = !(left <= kStale * last);  // a NaN too
      if (stale && left <= kRounding * wanted) break;
      if (stale && !renew()) return false;
      last = left;
    }
    accept_correction();
    return true;
  }
  // rho h N T dxi of one part, with dxi in velocity_.
  Vec3 slope_rate(int k) const {
    Vec3 rate = Vec3::Zero();
    for (Side side : kSides) {
      const int b = plan_.body(k, side);
      if (b == system_.n()) continue;
      if (plan_.part(k).spherical)
        rate +=
            rho_ * h_ * state_of(k).anchor_rate_change(side, at.state.u[b].w, times(at.tangents[b], velocity_[b].w));
      else
        rate += slopes_[2 * k + side].v * velocity_[b].v + slopes_[2 * k + side].w * velocity_[b].w;
    }
    return rate;
  }

  // Solves - S dmu = rows_ and adds dmu to the correction; rows_ becomes the residual.
  void pass() {
    target_ = rows_;
    delassus_.solve_rows(rows_.data(), flat(response_));
    for (size_t i = 0; i < rows_.size(); ++i) correction_[i] += rows_[i];
    for (int b = 0; b < system_.n(); ++b) velocity_[b] += response_[b];
    for (int k = 0; k < plan_.count(); ++k) store(Vec3(load3(&target_[3 * k]) - row_rate(k, response_)), &rows_[3 * k]);
    delassus_.zero_dropped(rows_.data());
  }
  bool renew() {
    delassus_.assemble(at.joints, at.start_joints);
    fresh_ = true;
    return delassus_.lu().factor();
  }
  void clear_correction() {
    std::fill(correction_.begin(), correction_.end(), 0.0);
    std::fill(velocity_.begin(), velocity_.end(), Twist{});
  }
  // Adds correction_, a change of dmu, and velocity_, its - M^-1 Gn^T dmu.
  void accept_correction() {
    for (size_t i = 0; i < mu_.size(); ++i) mu_[i] += correction_[i];
    for (int b = 0; b < system_.n(); ++b) shift_[b] += velocity_[b];
  }
  // Adds - E times the latest change of dmu to the right-hand side; returns its size as a velocity.
  double couple() {
    std::fill(balance_.begin(), balance_.end(), Twist{});
    for (int k = 0; k < plan_.count(); ++k) {
      const Joint& joint = plan_.joint(k);
      state_of(k).subtract_reaction_change(plan_.part(k), at.start_joints[plan_.parts[k]], load3(&correction_[3 * k]),
                                           balance_[joint.parent], balance_[joint.child]);
    }
    for (int b = 0; b < system_.n(); ++b) {
      const Twist change = balance_[b];
      const Vec3& rate = velocity_[b].w;
      balance_[b] = {-change.v, gyroscopic(b, times(system_.bodies[b].inertia, rate), rate) - change.w};
    }
    if (at.damped) add_damping(velocity_);
    add(balance_);
    return size_of(balance_);
  }
  // The dampers' part of (A - M) u.
  void add_damping(const std::vector<Twist>& u) {
    at.add_slopes(-at.force_time(), u, balance_, &ForceState::by_velocity);
  }
  // Adds to the right-hand side.
  void add(const std::vector<Twist>& balance) {
    for (int b = 0; b < system_.n(); ++b)
      for (int i = 0; i < 3; ++i) core_rhs_[6 * b + i] += balance[b].v[i], core_rhs_[6 * b + 3 + i] += balance[b].w[i];
  }
  // The largest velocity that impulses give to bodies.
  double size_of(const std::vector<Twist>& impulses) const {
    double size = 0;
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = system_.bodies[b];
      const Twist& p = impulses[b];
      size = std::max({size, p.v.cwiseAbs().maxCoeff() / (body.mass * at.length),
                       times(body.inertia_inverse, p.w).cwiseAbs().maxCoeff()});
    }
    return size;
  }
  // Keeps the latest change of dxi, in core_rhs_; returns its size.
  double note_motion() {
    double size = 0;
    for (int b = 0; b < system_.n(); ++b) {
      moved_[b] = load(&core_rhs_[6 * b]);
      size = std::max(size, Scales{at.length}.rate_of(moved_[b]));
    }
    return size;
  }
  // du = (dxi - shift) / rho, dLam = (c - dmu) / rho.
  bool finish(std::vector<double>& r) {
    const Nodes& nodes = at.nodes;
    for (int k = 0; k < plan_.count(); ++k) {
      const Vec3 mu = load3(&mu_[3 * k]);
      store(mu, &r[3 * nodes.mu(k)]);
      store(Vec3((load3(&total_[6 * system_.n() + 3 * k]) - mu) / rho_), &r[3 * nodes.lam(k)]);
    }
    for (int b = 0; b < system_.n(); ++b) {
      const Twist xi = load(&total_[6 * b]);
      store(xi, &r[3 * nodes.xi_v(b)]);
      store((xi - shift_[b]) / rho_, &r[3 * nodes.v(b)]);
    }
    return true;
  }

  const JointState& state_of(int k) const { return at.joints[plan_.parts[k]]; }
  // The rows of one part applied to velocities.
  Vec3 row_rate(int k, const std::vector<Twist>& u) const { return at.joints.velocity(plan_.parts[k], u); }

  LagrangeEquations& at;
  const Plan& plan_ = at.plan;
  const System& system_ = at.system;
  Delassus& delassus_ = at.saddle.delassus();
  const double rho_ = at.velocity_share;
  double h_ = 0;
  bool fresh_ = false;  // S is that of this iteration
  bool exact_ = true;
  std::vector<Rows> slopes_ = std::vector<Rows>(2 * plan_.count());
  std::vector<double> rows_ = std::vector<double>(3 * plan_.count());  // residual of - S dmu,
  std::vector<double> target_ = rows_;                                 // and before the last pass
  std::vector<double> correction_ = rows_, mu_ = rows_;
  std::vector<double> core_rhs_ = std::vector<double>(6 * system_.n() + rows_.size()), total_ = core_rhs_;
  std::vector<Twist> velocity_ = at.xi, response_ = at.xi, balance_ = at.xi;
  std::vector<Twist> moved_ = at.xi, pull_ = at.xi;  // change of dxi, and what rho h K dxi lacks for it
  std::vector<Twist> shift_ = at.xi;                 // dxi - rho du = M^-1 (r_xi - Gn^T dmu)
  std::vector<Vec3> excess_ = std::vector<Vec3>(plan_.count(), Vec3::Zero());  // (G + rho h N) dxi - r_mu
  std::vector<Vec3> guessed_ = excess_;  // guess of (G + rho h N) dxi, until the first sweep has computed it
};

// Phi(q) = 0 and G u = 0, with xi beside u and mu beside Lam.
class StabilisedEquations : public LagrangeEquations {
 public:
  StabilisedEquations(const Plan& plan, CoordinateMap map, bool index1_output, Correction correction,
                      double force_share = 1, double velocity_share = 1)
      : LagrangeEquations(plan, map, Level::stabilised, index1_output, layout(plan, correction), force_share,
                          velocity_share),
        plain_(correction == Correction::plain) {
    if (splits(plan, correction))
      slope_share = velocity_share, split_.emplace(*this);
    else
      find_drifts();
    for (const PlacedPart& placed : plan.parts) knows_left_out_ = knows_left_out_ && !placed.part->contact;
  }

  Status begin() override {
    if (split_ && damped && couples_by_springs()) take_whole_matrix(joints);  // sweeps would not converge
    if (split_) split_->forget();
    return Status::success;
  }
  Status residual(std::vector<double>& r) override {
    if (!configure()) return Status::map_domain;
    put_balance(r);
    for (int b = 0; b < system.n(); ++b) {
      const Twist drift = xi[b] - velocity_share * state.u[b] - carry_[b];
      drift_[b] = plain_ ? drift : momentum(system.bodies[b], drift);
    }
    for (int k = 0; k < nodes.parts(); ++k) {
      start_joints.subtract_reaction(plan.parts[k], -load3(&z[3 * nodes.mu(k)]), drift_);
      store(velocity_rows(k, state), &r[3 * nodes.lam(k)]);
      store(Vec3(here(k).position(plan.part(k)) / h), &r[3 * nodes.mu(k)]);
    }
    for (int b = 0; b < system.n(); ++b) store(drift_[b], &r[3 * nodes.xi_v(b)]);
    if (has_others) put_others(r, false), put_second(r);
    return Status::success;
  }
  bool factor() override {
    const bool regular = LagrangeEquations::factor();
    if (split_) split_->linearise();
    return regular;
  }
  bool solve_linear(std::vector<double>& r) override {
    return split_ ? split_->solve(r, incomplete() && knows_left_out_) : StepEquations::solve_linear(r);
  }
  bool exact_matrix() const override {
    return !incomplete() || (to_rounding() && split_ && knows_left_out_ && split_->exact());
  }
  // Replaces a split solve that does not converge by one matrix for all unknowns.
  bool fall_back() override {
    if (!split_) return false;
    take_whole_matrix(start_joints);
    return true;
  }
  void take_whole_matrix(const Constraints& joints) override {
    split_.reset(), slope_share = 1;
    LagrangeEquations::take_whole_matrix(joints);
    find_drifts();
  }
  Status finish() override {
    const Status status = LagrangeEquations::finish();
    if (status == Status::success && split_ && !index1_output && !saddle.factor(joints)) return Status::singular_matrix;
    return status;
  }

 protected:
  bool splits() const { return split_.has_value(); }

  std::vector<Twist> carry_ = xi;  // what else xi has beside rho u

 private:
  static bool splits(const Plan& plan, Correction correction) {
    return correction == Correction::mass && sweeps_converge(plan);
  }
  static Layout layout(const Plan& plan, Correction correction) {
    return {.solves_velocities = true,
            .doubled_unknowns = true,
            .doubled_matrix = !splits(plan, correction),
            .second_order = true,
            .eliminates = splits(plan, correction) && (plan.independent || is_spherical_tree(plan))};
  }

  // Completes the rows of mu, which rotors and slip do not have.
  [[gnu::noinline, gnu::cold]] void put_second(std::vector<double>& r) const {
    unite_rows(&z[3 * nodes.mu(0)], &r[3 * nodes.mu(0)], true);
    for (const std::vector<int>* parts : {&plan.rotors, &plan.slips})
      for (int k : *parts) store(load3(&z[3 * nodes.mu(k)]), &r[3 * nodes.mu(k)]);
  }

  bool fill_matrix() override {
    LagrangeEquations::fill_matrix();
    for (int b = 0; columns.doubled() && b < system.n(); ++b) {
      const double mass = plain_ ? 1 : system.bodies[b].mass;
      const Mat3 inertia = plain_ ? Mat3(Mat3::Identity()) : system.bodies[b].inertia;
      const BodyBlocks& blocks = body_blocks[b];  // M (xi - rho u), or xi - rho u
      put_diagonal(blocks.xi_v, mass), put_diagonal(blocks.xi_v_v, -velocity_share * mass);
      put(blocks.xi_w, inertia), put(blocks.xi_w_w, -velocity_share * inertia);
    }
    return true;
  }
  void put_rows(int k, Side side, const Rows& G) override {
    const Mat3 turned = G.w * tangents[plan.body(k, side)];
    if (split_) return part_blocks[2 * k + side].put_rows(G.v, turned);
    put_rates(k, side, G, rate_slope(k, side));
    drifts_[2 * k + side].put_rows(G.v, turned);
    drifts_[2 * k + side].put_columns(before(k).jacobian(plan.part(k), side));
  }
  void find_drifts() {
    drifts_.clear();
    for (int k = 0; k < nodes.parts(); ++k)
      for (int b : plan.parts[k].bodies) {
        const bool single = plan.part(k).compliance > 0 || plan.part(k).slips;  // no second multiplier
        drifts_.push_back(side_blocks(columns.mu(k), single ? system.n() : b, true));
      }
  }

  const bool plain_;               // the correction of xi
  bool knows_left_out_ = true;     // subtract_left_out() has all of it
  std::vector<Twist> drift_ = xi;  // residual of M xi = M u - G_n^T mu
  std::optional<StabilisedSolve> split_;
  std::vector<SideBlocks> drifts_;  // of mu and xi, per part and side
};

}  // namespace lieeuler
