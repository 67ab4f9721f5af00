// What the Lagrangian and the Hamiltonian Euler steppers share: the state, the guess, Newton, the blocks of its matrix.
#pragma once

#include "kinematics.hpp"
#include "newton.hpp"

namespace lieeuler {

// The constraint equations of a step; stabilised: position and velocity.
enum class Level { position, velocity, stabilised, acceleration };

inline Twist load(const double* at) { return {Eigen::Map<const Vec3>(at), Eigen::Map<const Vec3>(at + 3)}; }
inline void store(const Twist& twist, double* at) {
  Eigen::Map<Vec3>{at} = twist.v;
  Eigen::Map<Vec3>{at + 3} = twist.w;
}

// Equations supplies guess(z), residual(z, r), matrix(lu), exact_matrix(), has_velocity_rows(level) and finish().
template <class Equations, class Map>
class EulerStepper {
 public:
  // Starts from frames and u of `state`; a and lam become the index-1 values there.
  Status start(const State& state, double h) {
    state_ = state;
    h_ = h;
    rows_.evaluate(state_.frames);
    if (!index1_.saddle.factor(rows_)) return Status::singular_matrix;
    index1_.accelerations(rows_, state_);
    z_.assign(lu_.unknowns(), 0.0);
    equations().guess(z_);
    predictor_.reset(z_);
    newton_.reset(z_.size());
    return Status::success;
  }

  Status step(Counters& counters) {
    std::swap(start_, state_);
    std::swap(start_rows_, rows_);
    measure_scales();
    predictor_.guess(z_);
    Status status = newton_.solve(equations(), z_, lu_, target(), counters);
    if (status != Status::success && predictor_.extrapolates()) {
      predictor_.forget();
      predictor_.guess(z_);
      status = newton_.solve(equations(), z_, lu_, target(), counters);
    }
    if (status != Status::success) return status;
    predictor_.push(z_);
    ++counters.steps;
    return equations().finish();
  }

  // z -= correction; the size of the change of configuration, relative to the size of the system.
  double correct(std::vector<double>& z, const std::vector<double>& correction) const {
    for (size_t i = 0; i < z.size(); ++i) z[i] -= correction[i];
    double translation = 0, rotation = 0, sum = 0;
    for (int b = 0; b < system_.n(); ++b) {
      const Twist d = load(correction.data() + xi_offset(b));
      translation = std::max(translation, d.v.cwiseAbs().maxCoeff());
      rotation = std::max(rotation, d.w.cwiseAbs().maxCoeff());
      sum += d.v.sum() + d.w.sum();
    }
    if (!std::isfinite(sum)) return sum;  // max() above would hide a NaN
    return h_ * std::max(translation / length_, rotation);
  }

  const State& state() const { return state_; }
  const ConstraintRows& rows() const { return rows_; }

 protected:
  EulerStepper(const System& system, Level level, bool index1_output, int body_size, int joint_factor)
      : system_(system), level_(level), index1_output_(index1_output), body_size_(body_size), rows_(system),
        start_rows_(system), index1_(system), start_(system), state_(system), maps_(system.n() + 1),
        xi_(system.n() + 1) {
    const int n = system.n();
    lu_.plan(system, body_size, joint_factor);
    for (int b = 0; b < n; ++b) diagonals_.push_back(lu_.block(b, b));
    int row = 0;
    for (size_t j = 0; j < system.joints.size(); ++j) {
      const int node = n + static_cast<int>(j);
      row_offset_.push_back(row);
      joint_offset_.push_back(lu_.offset(node));
      row += system.joints[j].rows();
      for (Side side : {kParent, kChild}) {
        const int body = body_of(static_cast<int>(j), side), other = body_of(static_cast<int>(j), opposite(side));
        const bool coupled = !system.joints[j].dots.empty() && body != n && other != n;
        lower_.push_back(body == n ? nullptr : lu_.block(node, body));
        upper_.push_back(body == n ? nullptr : lu_.block(body, node));
        coupling_.push_back(coupled ? lu_.block(body, other) : nullptr);
      }
    }
  }

  static Side opposite(Side side) { return side == kChild ? kParent : kChild; }
  int joints() const { return static_cast<int>(system_.joints.size()); }
  int body_of(int joint, Side side) const {
    return side == kChild ? system_.joints[joint].child : system_.joints[joint].parent;
  }
  const Twist& velocity_of(int joint, Side side) const { return state_.u[body_of(joint, side)]; }

  // q = q_n * (h xi); false outside the map's domain.
  bool move(int body) {
    if (!maps_[body].set(h_ * xi_[body].w)) return false;
    state_.frames[body].x = start_.frames[body].x + h_ * xi_[body].v;
    state_.frames[body].R = start_.frames[body].R * maps_[body].rotation();
    return true;
  }
  void polish() {
    for (int b = 0; b < system_.n(); ++b) state_.frames[b].R = polished(state_.frames[b].R);
  }
  // (a, lam) of the index-1 system at the new state.
  Status solve_index1() {
    if (!index1_.saddle.factor(rows_)) return Status::singular_matrix;
    index1_.accelerations(rows_, state_);
    return Status::success;
  }

  const System& system_;
  const Level level_;
  const bool index1_output_;
  const int body_size_;  // unknowns per body: u, or u and xi
  double h_ = 0;
  ConstraintRows rows_, start_rows_;  // G at q and q_n
  Index1 index1_;
  State start_, state_;
  std::vector<Map> maps_;
  std::vector<Twist> xi_;
  std::vector<double> z_;
  BlockLU lu_;
  std::vector<int> row_offset_, joint_offset_;                 // of each joint, in lam and in z
  std::vector<double*> diagonals_, lower_, upper_, coupling_;  // blocks; the last three per joint and side

 private:
  Equations& equations() { return static_cast<Equations&>(*this); }
  int xi_offset(int body) const { return lu_.offset(body) + body_size_ - 6; }

  void measure_scales() {
    length_ = system_.length;
    speed_ = 0;
    for (int b = 0; b < system_.n(); ++b) {
      length_ = std::max(length_, start_.frames[b].x.cwiseAbs().maxCoeff());
      speed_ = std::max({speed_, start_.u[b].v.cwiseAbs().maxCoeff() / length_, start_.u[b].w.cwiseAbs().maxCoeff()});
    }
  }
  // Rounding level of h u: that of the configuration, or that of the velocity where Newton solves velocity rows.
  double target() const {
    const double eps = std::numeric_limits<double>::epsilon();
    return Equations::has_velocity_rows(level_) ? 0.1 * eps * std::min(1.0, h_ * std::max(1.0, speed_)) : 0.1 * eps;
  }

  double length_ = 1, speed_ = 0;
  Newton newton_;
  Predictor predictor_;
};

}  // namespace lieeuler
