// A step of an implicit method: both its ends, its unknowns and Newton's matrix, which a family of methods completes by
// its equations; and the stepper that solves them by Newton's iteration, to rounding of (7.4) of docs/theory.md.
#pragma once

#include <array>
#include <memory>
#include <optional>

#include "methods/method.hpp"
#include "model/system.hpp"
#include "solve/projection.hpp"

namespace lieeuler {

// The unknowns of a step, and how Newton's matrix is laid out and factored.
struct Layout {
  bool solves_velocities = false;  // there are rows of velocity
  bool doubled_unknowns = false;   // a second set of velocities and multipliers: xi and mu beside u and Lam
  bool doubled_matrix = false;     // in Newton's matrix too
  bool second_order = false;       // the matrix holds second derivatives of the constraints
  bool eliminates = false;         // only constraint rows couple bodies, so the bodies are eliminated beforehand
};

// The equations of one step of a family of methods.
class StepEquations {
 public:
  StepEquations(const Plan& plan, CoordinateMap map, Level level, bool index1_output, const Layout& layout)
      : plan(plan),
        level(level),
        index1_output(index1_output),
        solves_velocities(layout.solves_velocities),
        second_order(layout.second_order),
        nodes(plan, layout.doubled_unknowns),
        saddle(plan, layout.eliminates && plan.independent),
        maps(system.n() + 1, Map(map)) {
    if (layout.eliminates)
      core.emplace(plan, plan.independent ? Delassus::Kind::independent : Delassus::Kind::sparse);
    else
      plan_matrix(layout.doubled_matrix);
    for (const Joint& joint : system.joints)
      for (Side side : kSides) {
        const int b = side == kChild ? joint.child : joint.parent;
        if (b == system.n()) continue;
        const Vec3& arm = side == kChild ? joint.child_anchor : joint.parent_anchor;
        enlarge(mobility, arm.norm() * largest_mobility(system.bodies[b].inertia_inverse));
      }
  }
  virtual ~StepEquations() = default;

  // What a family supplies. At the start of a run:
  virtual Status begin() { return Status::success; }
  // z without earlier solutions.
  virtual void guess() = 0;
  // The configuration of z, and what z leaves of the equations there.
  virtual Status residual(std::vector<double>& r) = 0;
  // Newton's matrix at this configuration; false if it is singular.
  virtual bool factor() = 0;
  // Replaces a residual by its correction; false if the iteration will not converge.
  virtual bool solve_linear(std::vector<double>& r) {
    remove_null_space(r);
    solve_matrix(r.data());
    remove_null_space(r);
    return true;
  }
  // Whether the matrix has all derivatives of the residual.
  virtual bool exact_matrix() const { return true; }
  // Whether springs couple bodies so stiffly that iterations with a matrix without them converge slowly.
  virtual bool couples_by_springs() const { return false; }
  // Takes the matrix of all bodies and rows from here on; joints: where rows are scaled.
  virtual void take_whole_matrix(const Constraints& joints) {
    plan_matrix(nodes.doubled());
    scale_tail(joints);
  }
  // Takes another matrix if the iteration with the present one fails; false if there is none.
  virtual bool fall_back() { return false; }
  // The new state at the end of a step, and whether it factors the saddle point there.
  virtual Status finish() = 0;
  virtual bool projects() const { return false; }
  // (a, lam), which finish() owes.
  virtual void output() { saddle.accelerate(joints, state); }

  // z -= correction; returns the size of the change of configuration, relative to the size of the system.
  double correct(const std::vector<double>& correction) {
    for (size_t i = 0; i < z.size(); ++i) z[i] -= correction[i];
    double translation = 0, rotation = 0, sum = 0;
    for (int b = 0; b < system.n(); ++b) {
      const double* d = correction.data() + 3 * nodes.xi_v(b);
      for (int i = 0; i < 3; ++i) {
        translation = std::max(translation, std::abs(d[i]));
        rotation = std::max(rotation, std::abs(d[3 + i]));
        sum += d[i] + d[3 + i];
      }
    }
    if (!std::isfinite(sum)) return sum;  // max() above would hide a NaN
    return std::abs(h) * std::max(translation / length, rotation);
  }

  // Newton's matrix, as a block factorization or with the bodies eliminated.
  bool factor_matrix() { return core ? core->lu().factor() : lu.factor(); }
  void solve_matrix(double* r) {
    if (core)
      core->solve(r, r + 6 * system.n());
    else
      lu.solve(r);
  }

  // Lays out Newton's matrix, with (doubled) or without the second set of velocities and multipliers.
  void plan_matrix(bool doubled) {
    core.reset();
    columns = Nodes(plan, doubled);
    lu.follow(columns.blocks(second_order));
    body_blocks.clear(), padding.clear(), part_blocks.clear(), force_blocks.clear(), mimic_blocks.clear();
    for (int b = 0; b < system.n(); ++b) {
      const int v = columns.v(b), w = columns.w(b), xi_v = columns.xi_v(b), xi_w = columns.xi_w(b);
      body_blocks.push_back({lu.block(v, v), lu.block(w, w), lu.block(xi_v, xi_v), lu.block(xi_w, xi_w),
                             lu.block(xi_v, v), lu.block(xi_w, w)});
    }
    for (int k = 0; k < columns.parts(); ++k) {
      padding.push_back({lu.block(columns.lam(k), columns.lam(k)), lu.block(columns.mu(k), columns.mu(k))});
      for (Side side : kSides) part_blocks.push_back(side_blocks(columns.lam(k), plan.body(k, side), false));
    }
    for (const PlacedMimic& mimic : plan.mimics) {
      mimic_blocks.emplace_back(mimic, [&](int i, int j) { return lu.block(columns.lam(i), columns.lam(j)); });
      mimic_blocks.emplace_back(mimic, [&](int i, int j) { return lu.block(columns.mu(i), columns.mu(j)); });
    }
    for (const Force& force : system.forces) append_pairs(force.parent, force.child, false, force_blocks);
  }
  // Blocks of a node of multipliers and a body, or of two bodies and of each with itself, none of the ground; columns
  // are those of the velocities or of xi.
  SideBlocks side_blocks(int node, int b, bool xi) {
    if (b == system.n()) return {};
    return SideBlocks::of(lu, node, xi ? columns.xi_v(b) : columns.v(b), xi ? columns.xi_w(b) : columns.w(b));
  }
  void append_pairs(int parent, int child, bool xi, std::vector<PairBlocks>& out) {
    for (int row : {parent, child})
      for (int b : {parent, child})
        out.push_back(row == system.n() || b == system.n()
                          ? PairBlocks{}
                          : PairBlocks::of(lu, columns.v(row), columns.w(row), xi ? columns.xi_v(b) : columns.v(b),
                                           xi ? columns.xi_w(b) : columns.w(b)));
  }

  const JointState& here(int k) const { return joints[plan.parts[k]]; }
  const JointState& before(int k) const { return start_joints[plan.parts[k]]; }
  // The derivative of G u by the configuration, for the velocities of all bodies.
  Rows velocity_slope(int k, Side side, const std::vector<Twist>& u, bool both_orders) const {
    return here(k).velocity_slope(plan.part(k), side, u[plan.body(k, kParent)], u[plan.body(k, kChild)], both_orders);
  }
  // The rows of velocity at the new configuration.
  Vec3 velocity_rows(int k, const State& state) const {
    const Vec3 rate = joints.velocity(plan.parts[k], state.u);
    return plan.part(k).drive ? Vec3(rate + here(k).drift(plan.part(k))) : rate;
  }
  // Fills the missing rows of a part with the identity.
  void pad(int k) {
    for (double* block : padding[k])
      for (int r = plan.part(k).rows(); r < 3; ++r) block[(kColumn + 1) * r] = 1;
  }
  // Puts in the compliance of rotors and the coupling of mimics. Rotors and rows of slip have no second multiplier.
  void pad_others() {
    for (const MimicBlocks& blocks : mimic_blocks) blocks.put();
    for (int k : plan.slips)
      for (int r = 0; columns.doubled() && r < plan.part(k).rows(); ++r) padding[k][1][(kColumn + 1) * r] = 1;
    for (int k : plan.rotors) padding[k][1][0] = 1, padding[k][0][0] = -plan.part(k).compliance;
  }

  // Combines the rows of followers and leaders; z: the multipliers of the same parts.
  void unite_rows(const double* z, double* r, bool positions) const {
    combine(plan, r);
    for (const PlacedMimic& mimic : plan.mimics) {
      if (positions) r[3 * mimic.follower] = gap(plan, mimic, joints, start.angles) / h;
      r[3 * mimic.leader + 1] = -(mimic.ratio * z[3 * mimic.follower] + z[3 * mimic.leader]);
    }
  }

  // q = q_n * (h xi); false outside the map's domain.
  bool move(int body) {
    if (!maps[body].set(h * xi[body].w)) return false;
    state.frames[body].x = start.frames[body].x + h * xi[body].v;
    rotations[body] = maps[body].rotation();
    state.frames[body].R.noalias() = start.frames[body].R * rotations[body];
    return true;
  }
  // Completes the new configuration: makes attitudes rotations to rounding and evaluates the joints.
  virtual void settle() {
    if (polishes_attitudes)
      for (int b = 0; b < system.n(); ++b) state.frames[b].R = polished(state.frames[b].R);
    evaluate_joints();
  }
  void evaluate_joints() {
    joints.update(state.frames);
    state.angles = start.angles;
    update_angles(system, state.frames, state.u, state.angles);
  }
  // (a, lam) of the index-1 system at the current state.
  Status solve_index1() {
    if (!saddle.factor(joints)) return Status::singular_matrix;
    saddle.accelerate(joints, state);
    return Status::success;
  }
  // The same when state() is asked for, but the matrix now.
  Status owe_index1() {
    owes_output = true;
    return saddle.factor(joints) ? Status::success : Status::singular_matrix;
  }
  // Lam = duration * lam
  void store_multipliers(double duration) {
    plan.for_rows([&](int row, int place) { state.lam[row] = z[3 * nodes.lam(0) + place] / duration; });
  }
  void guess_multipliers(double duration) {
    plan.for_rows([&](int row, int place) { z[3 * nodes.lam(0) + place] = duration * state.lam[row]; });
  }

  void follow_choice() {
    core->drop(*saddle.dropped());
    choice = saddle.choice();
  }

  void remove_null_space(std::vector<double>& r) const {
    if (saddle.redundant() == 0) return;
    saddle.remove_null_space(&r[3 * nodes.lam(0)]);
    if (nodes.doubled()) saddle.remove_null_space(&r[3 * nodes.mu(0)]);
  }

  // Scales the rows of lam and of mu, and tells the matrix how many of them depend on others.
  void scale_tail(const Constraints& joints) {
    std::vector<double> scales(3 * columns.count(), 1.0);
    const std::vector<double> rows = saddle.row_scales(joints);
    std::copy(rows.begin(), rows.end(), scales.begin() + 3 * columns.lam(0));
    std::copy(rows.begin(), rows.end(), scales.begin() + 3 * columns.mu(0));
    lu.scale_tail(scales);
    lu.expect_deficiency(saddle.redundant() * (columns.doubled() ? 2 : 1));
  }

  void measure_scales() {
    const Scales scales = Scales::of_motion(system, start);
    length = scales.length, speed = std::max(scales.rate, scales.natural(system));
    // Velocities are sums of the joints' impulses and have their rounding errors, which are large in a long chain. With
    // very different masses impulses say nothing about speeds.
    if (plan.graded) return;
    double impulse = 0;
    for (size_t i = 3 * nodes.lam(0); i < z.size(); ++i) impulse = std::max(impulse, std::abs(z[i]));
    speed = std::max(speed, impulse * mobility);
  }

  const Plan& plan;
  const System& system = plan.system;
  const Level level;
  bool index1_output;
  const bool solves_velocities;
  bool owes_output = false;  // (a, lam), which output() completes; for index-1 values the saddle point is factored
  const bool second_order;   // whether the matrix holds second derivatives of the constraints
  const bool has_others = !plan.plain() || !plan.slips.empty();  // rows of slip, mimics or rotors
  const Nodes nodes;                                             // layout of the unknowns z
  Nodes columns = nodes;                                         // layout of Newton's matrix
  double h = 0;
  Constraints joints{system}, start_joints{system};  // at q and q_n
  SaddleSolver saddle;
  State start{system}, state = start;
  std::vector<Map> maps;
  std::vector<Mat3> rotations = std::vector<Mat3>(system.n() + 1), tangents = rotations;  // of the maps, E and T
  std::vector<Twist> xi = std::vector<Twist>(system.n() + 1), force = xi;
  std::vector<double> z = std::vector<double>(3 * nodes.count(), 0.0);
  BlockLU lu;
  std::optional<Delassus> core;  // in place of lu
  // Diagonal blocks of a body; of a doubled matrix also those of xi, and those of xi against the velocities.
  struct BodyBlocks {
    double *v, *w, *xi_v, *xi_w, *xi_v_v, *xi_w_w;
  };
  std::vector<BodyBlocks> body_blocks;
  std::vector<SideBlocks> part_blocks;          // of lam and (v, w), per part and side
  std::vector<std::array<double*, 2>> padding;  // diagonal blocks of lam and mu, per part
  std::vector<MimicBlocks> mimic_blocks;        // of lam, then mu
  std::vector<PairBlocks> force_blocks;         // columns of (v, w), per force, row side, column side

  bool to_rounding() const { return accuracy == std::numeric_limits<double>::epsilon(); }
  // The wanted error of h u, rounding level unless set otherwise: relative to the configuration, or to the velocity if
  // Newton solves velocity rows.
  double target() const { return solves_velocities ? accuracy * std::min(1.0, std::abs(h) * speed) : accuracy; }

  double length = 1, speed = 1;
  double accuracy = std::numeric_limits<double>::epsilon();
  bool polishes_attitudes = true;
  double mobility = 0;  // the largest angular velocity that a unit impulse at an anchor can give
  int choice = 0;       // of independent rows, that core has
};

// Guesses the unknowns of the next step by polynomial extrapolation, up to quartic, of the last solutions.
class Predictor {
 public:
  void reset(size_t unknowns) {
    for (auto& past : history_) past.assign(unknowns, 0.0);
    count_ = 0;
  }
  bool empty() const { return count_ == 0; }
  void push(const std::vector<double>& z) {
    newest_ = (newest_ + kPoints - 1) % kPoints;
    std::copy(z.begin(), z.end(), history_[newest_].begin());
    if (count_ < kPoints) ++count_;
  }
  void guess(std::vector<double>& z) const {
    static constexpr double weights[kPoints][kPoints] = {
        {1, 0, 0, 0, 0}, {2, -1, 0, 0, 0}, {3, -3, 1, 0, 0}, {4, -6, 4, -1, 0}, {5, -10, 10, -5, 1}};
    const double* const w = weights[count_ - 1];
    const double w0 = w[0], w1 = w[1], w2 = w[2], w3 = w[3], w4 = w[4];
    const double *const a = past(0), *const b = past(1), *const c = past(2), *const d = past(3), *const e = past(4);
    double* __restrict const out = z.data();
    const size_t n = z.size();
    for (size_t i = 0; i < n; ++i) out[i] = w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i] + w4 * e[i];
  }
  void forget() { count_ = 1; }
  bool extrapolates() const { return count_ > 1; }

 private:
  static constexpr int kPoints = 5;

  const double* past(int k) const { return history_[(newest_ + (k < count_ ? k : 0)) % kPoints].data(); }
  std::vector<double> history_[kPoints];
  int newest_ = 0, count_ = 0;
};

// Newton's iteration for the equations of a family, its guess, the null space of redundant rows, and the choice of the
// matrix.
class NewtonStepper {
 public:
  explicit NewtonStepper(std::unique_ptr<StepEquations> equations)
      : equations_(std::move(equations)), at(*equations_) {}

  // Starts from frames and u of `state`; a and lam become the index-1 values there.
  Status start(const State& state, double h) {
    at.state = state;
    at.state.frames.begin_step(h);
    at.h = h;
    update_angles(at.system, at.state.frames, at.state.u, at.state.angles);
    at.joints.update(at.state.frames);
    if (rank_ == Rank::unknown) {
      if (!at.saddle.find_redundancy(at.joints)) return Status::singular_matrix;
      if (at.core && at.saddle.dropped()) at.follow_choice();
      if (!at.core) at.scale_tail(at.joints);
      rank_ = Rank::of_start;
    }
    // Take the whole matrix if rows depend on several loops together, or if the matrix with the bodies eliminated would
    // leave out too much.
    if (at.core && at.plan.independent && (!at.saddle.dropped() || at.couples_by_springs()))
      at.take_whole_matrix(at.joints);
    if (const Status status = at.solve_index1(); status != Status::success) return status;
    if (const Status status = at.begin(); status != Status::success) return status;
    std::fill(at.z.begin(), at.z.end(), 0.0);
    predictor_.reset(at.z.size());
    residual_.assign(at.z.size(), 0.0);
    curvature_ = 1;
    return Status::success;
  }

  Status step(Counters& counters) {
    at.state.frames.begin_step(at.h);
    const Status status = advance(at.h, predictor_, counters);
    if (status == Status::success) ++counters.steps;
    return status;
  }
  // Where accelerations jump at the end of a step: starts anew with what acts from there on.
  Status cross() { return at_jump() ? start(State(state()), at.h) : Status::success; }

  // A part of size h, which may be negative, of a step that has begun, guessed from the earlier solutions in
  // `predictor`.
  Status advance(double h, Predictor& predictor, Counters& counters) {
    at.h = h;
    at.owes_output = false;
    if (predictor.empty())
      at.guess();
    else
      predictor.guess(at.z);
    at.remove_null_space(at.z);
    swap(at.start, at.state);
    std::swap(at.start_joints, at.joints);
    at.state.frames.follow(at.start.frames, at.h);
    at.measure_scales();
    Status status = solve(counters);
    if (status != Status::success && predictor.extrapolates()) {
      predictor.forget();
      predictor.guess(at.z);
      status = solve(counters);
    }
    if (status != Status::success && at.fall_back()) {
      if (predictor.empty())
        guess_afresh();
      else
        predictor.guess(at.z);
      status = solve(counters);
    }
    if (status == Status::newton_failed || status == Status::map_domain) status = solve_by_halves(status, counters);
    if (status == Status::newton_failed && at.lu.smallest_tail_pivot() < kNearlySingular)
      return Status::singular_matrix;
    if (status != Status::success) return status;
    forget_rates();
    predictor.push(at.z);
    if (const Status end = at.finish(); end != Status::success) return end;
    if (at.core && at.saddle.choice() != at.choice) {
      at.follow_choice();
      predictor.forget();  // its multipliers belong to other rows
    }
    return at.saddle.redundant() > 0 ? follow_null_space() : Status::success;
  }

  // Makes one more correction at the end of a step: the stopping test measures h u and leaves an error of eps / h in u.
  void polish_velocities() { polishes_velocities_ = true; }
  // Keeps the rounding errors of products of rotations in the attitudes, to show what the group update alone preserves.
  void keep_rounding() { at.polishes_attitudes = false; }
  // Solves steps to this error, relative to the sizes of the system, instead of to rounding level.
  void solve_to(double accuracy) { at.accuracy = std::max(accuracy, std::numeric_limits<double>::epsilon()); }

  size_t unknowns() const { return at.z.size(); }
  int redundant_rows() const { return at.saddle.redundant(); }
  // Accelerations and multipliers are computed when they are asked for.
  const State& state() {
    if (std::exchange(at.owes_output, false)) at.output();
    return at.state;
  }
  const Constraints& joints() const { return at.joints; }

 protected:
  bool at_jump() const { return at.plan.jumps_at(at.state.frames); }

  std::unique_ptr<StepEquations> equations_;
  StepEquations& at;

 private:
  // Solves equations.residual(z) = 0 from the guess in z with the matrix at the guess (chord iteration), which is
  // renewed if the corrections shrink slowly. StepEquations::correct measures a correction as h |du|, the change of the
  // configuration, because u itself has rounding errors of eps / h.
  Status solve(Counters& counters) {
    const Status status = iterate(counters);
    return status == Status::success && polishes_velocities_ && at.target() < kNoise ? polish(counters) : status;
  }
  Status polish(Counters& counters) {
    ++counters.force_evaluations, ++counters.newton_iterations;
    if (const Status status = at.residual(residual_); status != Status::success) return status;
    at.solve_linear(residual_);
    return std::isfinite(at.correct(residual_)) ? Status::success : Status::non_finite;
  }
  Status iterate(Counters& counters) {
    const double target = at.target();
    double first = 0, last = std::numeric_limits<double>::infinity();
    bool renew = true;
    for (int k = 1; k <= kMostIterations; ++k) {
      ++counters.force_evaluations;
      if (const Status status = at.residual(residual_); status != Status::success) return status;
      if (renew) {
        ++counters.factorizations;
        if (!at.factor()) return Status::singular_matrix;
      }
      if (!at.solve_linear(residual_)) return Status::newton_failed;
      const double size = at.correct(residual_);
      ++counters.newton_iterations;
      counters.most_iterations = std::max<long>(counters.most_iterations, k);
      if (!std::isfinite(size)) return Status::non_finite;
      if (size <= kFloor) return Status::success;
      if (k == 1 ? at.exact_matrix() && kCaution * curvature_ * size * size <= target : shrunk(size, last, target))
        return Status::success;
      if (k == 1) first = size;
      if (k == 2 && size > kNoise) curvature_ = std::max(curvature_, size / (first * first));
      renew = k > 1 && size > kSlow * last;
      last = size;
    }
    return last <= kStalled ? Status::success : Status::newton_failed;
  }

  // As kNoise, next to a singular position, where rounding is larger. By then every matrix is new, so that curvature
  // would leave only the square of a correction: one of this size that does not shrink is rounding.
  static constexpr double kStalled = 1e-9;
  static constexpr double kSlow = 0.1;     // ratio of corrections above which the matrix is renewed
  static constexpr double kCaution = 100;  // safety factor on the curvature measured in earlier steps
  static constexpr int kMostIterations = 25;

  // The first correction, with the derivative at the guess, leaves an error of the curvature times its square. A later
  // one leaves an error of its size times the ratio of the last two.
  static bool shrunk(double size, double last, double target) {
    const double ratio = size / last;
    return size * ratio <= target || (size <= kNoise && ratio > 0.3);
  }

  // Sets the rates of leaders to zero: no residual depends on them, so that their guesses would grow.
  void forget_rates() {
    for (const PlacedMimic& mimic : at.plan.mimics)
      at.z[3 * at.nodes.lam(mimic.leader) + 1] = at.z[3 * at.nodes.mu(mimic.leader) + 1] = 0;
  }

  // Solves the step from the solution of half of it: a stiff force makes the motion at the start a bad guess.
  [[gnu::noinline, gnu::cold]] Status solve_by_halves(Status failure, Counters& counters) {
    const double h = std::exchange(at.h, 0.5 * at.h);
    guess_afresh();
    const Status status = solve(counters);
    at.h = h;
    if (status != Status::success) return failure;
    for (size_t i = 3 * at.nodes.lam(0); i < at.z.size(); ++i) at.z[i] *= 2;  // impulses go with the step
    return solve(counters) == Status::success ? Status::success : failure;
  }

  // Guesses from the start of the step, after an attempt has changed z.
  void guess_afresh() {
    std::fill(at.z.begin(), at.z.end(), 0.0);
    swap(at.start, at.state);
    at.guess();
    swap(at.start, at.state);
    at.remove_null_space(at.z);
  }

  // Fails if the rank is higher after the first step than at the start, which then was a singular position. Rows may
  // depend on others only where the joints are closed: a method that lets positions drift is asked at the closed ones.
  Status confirm_rank() {
    int redundant;
    const bool counted = at.saddle.count_redundancy(at.joints, redundant);
    if (counted && redundant >= at.saddle.redundant()) return Status::success;
    if (at.level == Level::position || at.level == Level::stabilised) return Status::singular_matrix;
    Projection closed(at.plan);
    State state = at.state;
    Counters uncounted;
    if (closed.start(at.start) != Status::success) return Status::singular_matrix;
    // What cannot be closed has drifted too far to say anything about the start.
    if (closed.project(state, at.length, uncounted, false) != Status::success) return Status::success;
    return closed.confirm_rank();
  }

  // Finds the null space at this configuration, which the next step removes from rows and multipliers.
  Status follow_null_space() {
    if (rank_ == Rank::of_start) {
      if (const Status status = confirm_rank(); status != Status::success) return status;
      rank_ = Rank::confirmed;
      if (at.saddle.dropped()) return Status::success;
      if (!at.saddle.factor(at.joints)) return Status::singular_matrix;
    } else if (at.saddle.dropped()) {
      return Status::success;                          // no null space to follow
    } else if (!at.index1_output && !at.projects()) {  // else finish() has factored it here
      if (!at.saddle.factor(at.joints)) return Status::singular_matrix;
    }
    state();
    at.saddle.make_least_norm(at.joints, at.state.lam);
    return Status::success;
  }

  enum class Rank { unknown, of_start, confirmed } rank_ = Rank::unknown;
  Predictor predictor_;
  std::vector<double> residual_;
  double curvature_ = 1;  // largest ratio of a second correction to the square of the first; of order 1 by geometry
  bool polishes_velocities_ = false;
};

// One whose family is known.
template <class Family>
class ImplicitStepper : public NewtonStepper {
 public:
  template <class... Arguments>
  explicit ImplicitStepper(const Arguments&... arguments) : NewtonStepper(std::make_unique<Family>(arguments...)) {}

  Family& equations() { return static_cast<Family&>(at); }
};

}  // namespace lieeuler
