// Base of the Lagrangian and Hamiltonian Euler steppers: the state, the guess, Newton, and the blocks of its matrix.
#pragma once

#include <array>
#include <optional>

#include "model/sizes.hpp"
#include "solve/projection.hpp"

namespace lieeuler {

// The constraint equations of a step; stabilised: position and velocity.
enum class Level { position, velocity, stabilised, acceleration };

// The unknowns of a step, and how Newton's matrix is laid out and factored.
struct Layout {
  bool doubled_unknowns = false;  // a second set of velocities and multipliers: xi and mu beside u and Lam
  bool doubled_matrix = false;    // in Newton's matrix too
  bool second_order = false;      // the matrix holds second derivatives of the constraints
  bool eliminates = false;        // only constraint rows couple bodies, so the bodies are eliminated beforehand
};

// Equations supplies begin(), guess(z), residual(z, r), factor(), exact_matrix(), has_velocity_rows(level), finish(),
// fall_back(), take_whole_matrix(), couples_by_springs(), and projects(level): whether finish() factors the saddle
// point at the new state.
template <class Equations, class Map>
class EulerStepper {
 public:
  // Starts from frames and u of `state`; a and lam become the index-1 values there.
  Status start(const State& state, double h) {
    state_ = state;
    h_ = h;
    update_angles(system_, state_.frames, state_.u, state_.angles);
    joints_.update(state_.frames);
    if (rank_ == Rank::unknown) {
      if (!saddle_.find_redundancy(joints_)) return Status::singular_matrix;
      if (core_ && saddle_.sparse().dropped()) follow_choice();
      if (!core_) scale_tail();
      rank_ = Rank::of_start;
    }
    // Take the whole matrix if rows depend on several loops together, or if the matrix with the bodies eliminated would
    // leave out too much.
    if (core_ && plan_.independent && (!saddle_.sparse().dropped() || equations().couples_by_springs())) {
      equations().take_whole_matrix();
      scale_tail();
    }
    lu_.expect_deficiency(saddle_.redundant() * (nodes_.doubled() ? 2 : 1));
    if (const Status status = solve_index1(); status != Status::success) return status;
    if (const Status status = equations().begin(); status != Status::success) return status;
    std::fill(z_.begin(), z_.end(), 0.0);
    predictor_.reset(z_.size());
    newton_.reset(z_.size());
    return Status::success;
  }

  Status step(Counters& counters) {
    const Status status = advance(h_, predictor_, counters);
    if (status == Status::success) ++counters.steps;
    return status;
  }

  // One step of size h, which may be negative, guessed from the earlier solutions in `predictor`.
  Status advance(double h, Predictor& predictor, Counters& counters) {
    h_ = h;
    owes_output_ = false;
    if (predictor.empty())
      equations().guess(z_);
    else
      predictor.guess(z_);
    remove_null_space(z_);
    std::swap(start_, state_);
    std::swap(start_joints_, joints_);
    state_.frames.follow(start_.frames, h_);
    measure_scales();
    Status status = newton_.solve(equations(), z_, target(), counters);
    if (status != Status::success && predictor.extrapolates()) {
      predictor.forget();
      predictor.guess(z_);
      status = newton_.solve(equations(), z_, target(), counters);
    }
    if (status != Status::success && equations().fall_back()) {
      if (predictor.empty())
        guess_afresh();
      else
        predictor.guess(z_);
      status = newton_.solve(equations(), z_, target(), counters);
    }
    if (status == Status::newton_failed || status == Status::map_domain) status = solve_by_halves(status, counters);
    if (status == Status::newton_failed && lu_.smallest_tail_pivot() < kNearlySingular) return Status::singular_matrix;
    if (status != Status::success) return status;
    forget_rates();
    predictor.push(z_);
    if (const Status end = equations().finish(); end != Status::success) return end;
    if (core_ && saddle_.sparse().choice() != choice_) {
      follow_choice();
      predictor.forget();  // its multipliers belong to other rows
    }
    return saddle_.redundant() > 0 ? follow_null_space() : Status::success;
  }

  // Replaces a residual by its correction.
  bool solve_linear(std::vector<double>& r) {
    remove_null_space(r);
    solve_matrix(r.data());
    remove_null_space(r);
    return true;
  }

  // z -= correction; returns the size of the change of configuration, relative to the size of the system.
  double correct(std::vector<double>& z, const std::vector<double>& correction) const {
    for (size_t i = 0; i < z.size(); ++i) z[i] -= correction[i];
    double translation = 0, rotation = 0, sum = 0;
    for (int b = 0; b < system_.n(); ++b) {
      const double* d = correction.data() + 3 * nodes_.xi_v(b);
      for (int i = 0; i < 3; ++i) {
        translation = std::max(translation, std::abs(d[i]));
        rotation = std::max(rotation, std::abs(d[3 + i]));
        sum += d[i] + d[3 + i];
      }
    }
    if (!std::isfinite(sum)) return sum;  // max() above would hide a NaN
    return std::abs(h_) * std::max(translation / length_, rotation);
  }

  // Solves the velocities to rounding level too, not only h times the velocities.
  void polish_velocities() { newton_.polishes = true; }
  // Keeps the rounding errors of products of rotations in the attitudes, to show what the group update alone preserves.
  void keep_rounding() { polishes_attitudes_ = false; }
  // Solves steps to this error, relative to the sizes of the system, instead of to rounding level.
  void solve_to(double accuracy) { accuracy_ = std::max(accuracy, std::numeric_limits<double>::epsilon()); }
  bool to_rounding() const { return accuracy_ == std::numeric_limits<double>::epsilon(); }

  size_t unknowns() const { return z_.size(); }
  int redundant_rows() const { return saddle_.redundant(); }
  // With index-1 output, accelerations and multipliers are computed when they are asked for.
  const State& state() {
    if (std::exchange(owes_output_, false)) saddle_.accelerate(joints_, state_);
    return state_;
  }
  const Constraints& joints() const { return joints_; }

 protected:
  EulerStepper(const Plan& plan, Level level, bool index1_output, const Layout& layout)
      : plan_(plan),
        system_(plan.system),
        level_(level),
        index1_output_(index1_output),
        second_order_(layout.second_order),
        has_others_(!plan.plain() || !plan.slips.empty()),
        nodes_(plan, layout.doubled_unknowns),
        columns_(nodes_),
        joints_(system_),
        start_joints_(system_),
        saddle_(plan, layout.eliminates && plan.independent ? Elimination::independent : Elimination::complete),
        start_(system_),
        state_(system_),
        maps_(system_.n() + 1),
        xi_(system_.n() + 1),
        force_(system_.n() + 1),
        z_(3 * nodes_.count(), 0.0) {
    if (layout.eliminates)
      core_.emplace(plan, plan.independent);
    else
      plan_matrix(layout.doubled_matrix);
    for (const Joint& joint : system_.joints)
      for (Side side : kSides) {
        const int b = side == kChild ? joint.child : joint.parent;
        if (b == system_.n()) continue;
        const Vec3& arm = side == kChild ? joint.child_anchor : joint.parent_anchor;
        enlarge(mobility_, arm.norm() * largest_mobility(system_.bodies[b].inertia_inverse));
      }
  }

  // Newton's matrix, as a block factorization or with the bodies eliminated.
  bool factor_matrix() { return core_ ? core_->lu().factor() : lu_.factor(); }
  void solve_matrix(double* r) {
    if (core_)
      core_->solve(r, r + 6 * system_.n());
    else
      lu_.solve(r);
  }

  // Lays out Newton's matrix, with (doubled) or without the second set of velocities and multipliers.
  void plan_matrix(bool doubled) {
    core_.reset();
    columns_ = Nodes(plan_, doubled);
    lu_.follow(columns_.blocks(second_order_));
    padding_.clear(), blocks_.clear(), force_blocks_.clear(), mimic_blocks_.clear();
    for (int k = 0; k < columns_.parts(); ++k) {
      padding_.push_back({lu_.block(columns_.lam(k), columns_.lam(k)), lu_.block(columns_.mu(k), columns_.mu(k))});
      for (Side side : kSides) {
        const int body = body_of(k, side);
        blocks_.push_back(body == system_.n()
                              ? SideBlocks{}
                              : SideBlocks::of(lu_, columns_.lam(k), columns_.v(body), columns_.w(body)));
      }
    }
    for (const PlacedMimic& mimic : plan_.mimics) {
      mimic_blocks_.emplace_back(mimic, [&](int i, int j) { return lu_.block(columns_.lam(i), columns_.lam(j)); });
      mimic_blocks_.emplace_back(mimic, [&](int i, int j) { return lu_.block(columns_.mu(i), columns_.mu(j)); });
    }
    for (const Force& force : system_.forces)
      for (int row : {force.parent, force.child})
        for (int column : {force.parent, force.child})
          force_blocks_.push_back(
              row == system_.n() || column == system_.n()
                  ? PairBlocks{}
                  : PairBlocks::of(lu_, columns_.v(row), columns_.w(row), columns_.v(column), columns_.w(column)));
  }

  const Part& part_of(int k) const { return plan_.part(k); }
  int body_of(int k, Side side) const { return plan_.body(k, side); }
  const JointState& here(int k) const { return joints_[plan_.parts[k].joint]; }
  const JointState& before(int k) const { return start_joints_[plan_.parts[k].joint]; }
  Vec3 velocity_rows(int k, const State& state, const JointState& joint) const {
    const Vec3 rate = joint.velocity(part_of(k), state.u[body_of(k, kParent)], state.u[body_of(k, kChild)]);
    return part_of(k).drive ? Vec3(rate + joint.drift(part_of(k))) : rate;
  }
  void subtract_reaction(int k, const JointState& joint, const Vec3& lam, std::vector<Twist>& impulse) const {
    joint.subtract_reaction(part_of(k), lam, impulse[body_of(k, kParent)], impulse[body_of(k, kChild)]);
  }
  // Fills the missing rows of a part with the identity.
  void pad(int k) {
    for (double* block : padding_[k])
      for (int r = part_of(k).rows(); r < 3; ++r) block[(kColumn + 1) * r] = 1;
  }
  // Puts in the compliance of rotors and the coupling of mimics. Rotors and rows of slip have no second multiplier.
  void pad_others() {
    for (const MimicBlocks& blocks : mimic_blocks_) blocks.put();
    for (int k : plan_.slips)
      for (int r = 0; columns_.doubled() && r < part_of(k).rows(); ++r) padding_[k][1][(kColumn + 1) * r] = 1;
    for (int k : plan_.rotors) padding_[k][1][0] = 1, padding_[k][0][0] = -part_of(k).compliance;
  }

  // Combines the rows of followers and leaders; z: the multipliers of the same parts.
  void unite_rows(const double* z, double* r, bool positions) const {
    combine(plan_, r);
    for (const PlacedMimic& mimic : plan_.mimics) {
      if (positions) r[3 * mimic.follower] = gap(plan_, mimic, joints_, start_.angles) / h_;
      r[3 * mimic.leader + 1] = -(mimic.ratio * z[3 * mimic.follower] + z[3 * mimic.leader]);
    }
  }

  // q = q_n * (h xi); false outside the map's domain.
  bool move(int body) {
    if (!maps_[body].set(h_ * xi_[body].w)) return false;
    state_.frames[body].x = start_.frames[body].x + h_ * xi_[body].v;
    state_.frames[body].R.noalias() = start_.frames[body].R * maps_[body].rotation();
    return true;
  }
  // Completes the new configuration: makes attitudes rotations to rounding and evaluates the joints.
  void settle() {
    if (polishes_attitudes_)
      for (int b = 0; b < system_.n(); ++b) state_.frames[b].R = polished(state_.frames[b].R);
    evaluate_joints();
  }
  void evaluate_joints() {
    joints_.update(state_.frames);
    state_.angles = start_.angles;
    update_angles(system_, state_.frames, state_.u, state_.angles);
  }
  // (a, lam) of the index-1 system at the current state.
  Status solve_index1() {
    if (!saddle_.factor(joints_)) return Status::singular_matrix;
    saddle_.accelerate(joints_, state_);
    return Status::success;
  }
  // The same when state() is asked for, but the matrix now.
  Status owe_index1() {
    owes_output_ = true;
    return saddle_.factor(joints_) ? Status::success : Status::singular_matrix;
  }
  // Lam = duration * lam
  void store_multipliers(double duration) {
    for (int k = 0; k < nodes_.parts(); ++k)
      for (int r = 0; r < part_of(k).rows(); ++r) state_.lam[part_of(k).row + r] = z_[3 * nodes_.lam(k) + r] / duration;
  }
  void guess_multipliers(double duration, std::vector<double>& z) const {
    for (int k = 0; k < nodes_.parts(); ++k)
      for (int r = 0; r < part_of(k).rows(); ++r) z[3 * nodes_.lam(k) + r] = duration * state_.lam[part_of(k).row + r];
  }

  const Plan& plan_;
  const System& system_;
  const Level level_;
  bool index1_output_;
  bool owes_output_ = false;  // (a, lam) of the index-1 system; the saddle point is factored
  const bool second_order_;   // whether the matrix holds second derivatives of the constraints
  const bool has_others_;     // whether there are rows of slip, mimics or rotors
  const Nodes nodes_;         // layout of the unknowns z
  Nodes columns_;             // layout of Newton's matrix
  double h_ = 0;
  Constraints joints_, start_joints_;  // at q and q_n
  SaddleSolver saddle_;
  State start_, state_;
  std::vector<Map> maps_;
  std::vector<Twist> xi_, force_;
  std::vector<double> z_;
  BlockLU lu_;
  std::optional<Delassus> core_;                 // in place of lu_
  std::vector<SideBlocks> blocks_;               // of lam and (v, w), per part and side
  std::vector<std::array<double*, 2>> padding_;  // diagonal blocks of lam and mu, per part
  std::vector<MimicBlocks> mimic_blocks_;        // of lam, then mu
  std::vector<PairBlocks> force_blocks_;         // columns of (v, w), per force, row side, column side

  // The wanted error of h u, rounding level unless set otherwise: relative to the configuration, or to the velocity if
  // Newton solves velocity rows.
  double target() const {
    return Equations::has_velocity_rows(level_) ? accuracy_ * std::min(1.0, std::abs(h_) * speed_) : accuracy_;
  }

  double length_ = 1, speed_ = 1;
  double accuracy_ = std::numeric_limits<double>::epsilon();
  bool polishes_attitudes_ = true;
  double mobility_ = 0;  // the largest angular velocity that a unit impulse at an anchor can give

 private:
  Equations& equations() { return static_cast<Equations&>(*this); }

  // Sets the rates of leaders to zero: no residual depends on them, so that their guesses would grow.
  void forget_rates() {
    for (const PlacedMimic& mimic : plan_.mimics)
      z_[3 * nodes_.lam(mimic.leader) + 1] = z_[3 * nodes_.mu(mimic.leader) + 1] = 0;
  }

  // Solves the step from the solution of half of it: a stiff force makes the motion at the start a bad guess.
  [[gnu::noinline, gnu::cold]] Status solve_by_halves(Status failure, Counters& counters) {
    const double h = std::exchange(h_, 0.5 * h_);
    guess_afresh();
    const Status status = newton_.solve(equations(), z_, target(), counters);
    h_ = h;
    if (status != Status::success) return failure;
    for (size_t i = 3 * nodes_.lam(0); i < z_.size(); ++i) z_[i] *= 2;  // impulses go with the step
    return newton_.solve(equations(), z_, target(), counters) == Status::success ? Status::success : failure;
  }

  // Guesses from the start of the step, after an attempt has changed z_.
  void guess_afresh() {
    std::fill(z_.begin(), z_.end(), 0.0);
    std::swap(start_, state_);
    equations().guess(z_);
    std::swap(start_, state_);
    remove_null_space(z_);
  }

  // Fails if the rank is higher after the first step than at the start, which then was a singular position. Rows may
  // depend on others only where the joints are closed: a method that lets positions drift is asked at the closed ones.
  Status confirm_rank() {
    int redundant;
    const bool counted = saddle_.count_redundancy(joints_, redundant);
    if (counted && redundant >= saddle_.redundant()) return Status::success;
    if (level_ == Level::position || level_ == Level::stabilised) return Status::singular_matrix;
    Projection closed(plan_);
    State state = state_;
    Counters uncounted;
    if (closed.start(start_) != Status::success) return Status::singular_matrix;
    // What cannot be closed has drifted too far to say anything about the start.
    if (closed.project(state, length_, uncounted, false) != Status::success) return Status::success;
    return closed.confirm_rank();
  }

  // Finds the null space at this configuration, which the next step removes from rows and multipliers.
  Status follow_null_space() {
    if (rank_ == Rank::of_start) {
      if (const Status status = confirm_rank(); status != Status::success) return status;
      rank_ = Rank::confirmed;
      if (saddle_.sparse().dropped()) return Status::success;
      if (!saddle_.factor(joints_)) return Status::singular_matrix;
    } else if (saddle_.sparse().dropped()) {
      return Status::success;                                      // no null space to follow
    } else if (!index1_output_ && !Equations::projects(level_)) {  // else finish() has factored it here
      if (!saddle_.factor(joints_)) return Status::singular_matrix;
    }
    state();
    saddle_.make_least_norm(joints_, state_.lam);
    return Status::success;
  }

  void follow_choice() {
    core_->drop(*saddle_.sparse().dropped());
    choice_ = saddle_.sparse().choice();
  }

  void remove_null_space(std::vector<double>& r) const {
    if (saddle_.redundant() == 0) return;
    saddle_.sparse().remove_null_space(&r[3 * nodes_.lam(0)]);
    if (nodes_.doubled()) saddle_.sparse().remove_null_space(&r[3 * nodes_.mu(0)]);
  }

  // Scales the rows of lam and of mu.
  void scale_tail() {
    std::vector<double> scales(z_.size(), 1.0);
    const std::vector<double> rows = saddle_.sparse().row_scales(joints_);
    std::copy(rows.begin(), rows.end(), scales.begin() + 3 * nodes_.lam(0));
    std::copy(rows.begin(), rows.end(), scales.begin() + 3 * nodes_.mu(0));
    lu_.scale_tail(scales);
  }

  void measure_scales() {
    const Scales scales = Scales::of_motion(system_, start_);
    length_ = scales.length, speed_ = std::max(scales.rate, scales.natural(system_));
    // Velocities are sums of the joints' impulses and have their rounding errors, which are large in a long chain. With
    // very different masses impulses say nothing about speeds.
    if (plan_.graded) return;
    double impulse = 0;
    for (size_t i = 3 * nodes_.lam(0); i < z_.size(); ++i) impulse = std::max(impulse, std::abs(z_[i]));
    speed_ = std::max(speed_, impulse * mobility_);
  }
  enum class Rank { unknown, of_start, confirmed } rank_ = Rank::unknown;
  int choice_ = 0;
  Newton newton_;
  Predictor predictor_;
};

}  // namespace lieeuler
