// Configurations, constraint rows and the index-1 system: what all methods share.
#pragma once

#include <vector>

#include "block_lu.hpp"
#include "joints.hpp"

namespace lieeuler {

// A point of the trajectory. frames and u have one entry more than bodies: the ground, at rest.
struct State {
  std::vector<Frame> frames;
  std::vector<Twist> u, a;
  std::vector<double> lam;

  explicit State(const System& system)
      : frames(system.n() + 1), u(system.n() + 1), a(system.n() + 1), lam(system.rows(), 0.0) {}
};

// Rows of G of all joints at one configuration, both sides each.
class ConstraintRows {
 public:
  explicit ConstraintRows(const System& system) : system_(&system), sides_(system.joints.size()) {
    for (auto& sides : sides_) sides[0].setZero(), sides[1].setZero();
  }
  Rows& operator()(int joint, Side side) { return sides_[joint][side]; }
  const Rows& operator()(int joint, Side side) const { return sides_[joint][side]; }

  void evaluate(const std::vector<Frame>& frames) {
    for (size_t j = 0; j < sides_.size(); ++j) {
      const JointState state = at(static_cast<int>(j), frames);
      state.jacobian(kChild, sides_[j][kChild]);
      state.jacobian(kParent, sides_[j][kParent]);
    }
  }
  JointState at(int joint, const std::vector<Frame>& frames) const {
    const Joint& record = system_->joints[joint];
    return {record, frames[record.parent], frames[record.child]};
  }
  // impulse -= scale * G^T lam, over all joints
  void subtract_reactions(const double* lam, double scale, std::vector<Twist>& impulse) const {
    for (size_t j = 0; j < sides_.size(); ++j) {
      const Joint& joint = system_->joints[j];
      const int rows = joint.rows();
      for (Side side : {kParent, kChild}) {
        Vec6 sum = Vec6::Zero();
        for (int r = 0; r < rows; ++r) sum += (scale * lam[r]) * sides_[j][side].row(r).transpose();
        Twist& target = impulse[side == kChild ? joint.child : joint.parent];
        target.v -= sum.head<3>(), target.w -= sum.tail<3>();
      }
      lam += rows;
    }
  }
  // G u of one joint
  void velocity(int joint, const std::vector<Twist>& u, double* out) const {
    const Joint& record = system_->joints[joint];
    for (int r = 0; r < record.rows(); ++r) out[r] = 0;
    for (Side side : {kParent, kChild}) {
      const Twist& twist = u[side == kChild ? record.child : record.parent];
      for (int r = 0; r < record.rows(); ++r)
        out[r] += sides_[joint][side].row(r).head<3>().dot(twist.v) + sides_[joint][side].row(r).tail<3>().dot(twist.w);
    }
  }

 private:
  const System* system_;
  std::vector<std::array<Rows, 2>> sides_;
};

// The saddle-point system [M G^T; G 0] at one configuration: projection of velocities and index-1 accelerations.
class SaddlePoint {
 public:
  explicit SaddlePoint(const System& system) : system_(system) {
    lu_.plan(system, 6, 1);
    rhs_.assign(lu_.unknowns(), 0.0);
    for (int b = 0; b < system.n(); ++b) diagonals_.push_back(lu_.block(b, b));
    for (size_t j = 0; j < system.joints.size(); ++j)
      for (Side side : {kParent, kChild}) {
        const int node = system.n() + static_cast<int>(j), body = body_of(static_cast<int>(j), side);
        const bool ground = body == system.n();
        lower_.push_back(ground ? nullptr : lu_.block(node, body));
        upper_.push_back(ground ? nullptr : lu_.block(body, node));
      }
  }

  bool factor(const ConstraintRows& G) {
    lu_.set_zero();
    for (int b = 0; b < system_.n(); ++b) {
      Eigen::Map<Mat6> block(diagonals_[b]);
      block.diagonal().head<3>().setConstant(system_.bodies[b].mass);
      block.bottomRightCorner<3, 3>() = system_.bodies[b].inertia;
    }
    for (size_t j = 0; j < system_.joints.size(); ++j) {
      const int rows = system_.joints[j].rows();
      for (Side side : {kParent, kChild}) {
        if (!lower_[2 * j + side]) continue;
        const Rows& block = G(static_cast<int>(j), side);
        for (int r = 0; r < rows; ++r)
          for (int c = 0; c < 6; ++c)
            lower_[2 * j + side][r * 6 + c] = upper_[2 * j + side][c * rows + r] = block(r, c);
      }
    }
    return lu_.factor();
  }

  // Solves M y + G^T mu = right, G y = rate; rate = nullptr for zero.
  void solve(const std::vector<Twist>& right, const double* rate, std::vector<Twist>& y, double* mu) {
    for (int b = 0; b < system_.n(); ++b) {
      double* at = rhs_.data() + lu_.offset(b);
      Eigen::Map<Vec3>{at} = right[b].v;
      Eigen::Map<Vec3>{at + 3} = right[b].w;
    }
    const int rows = system_.rows(), first = lu_.offset(system_.n());
    for (int r = 0; r < rows; ++r) rhs_[first + r] = rate ? rate[r] : 0.0;
    lu_.solve(rhs_.data());
    for (int b = 0; b < system_.n(); ++b) {
      const double* at = rhs_.data() + lu_.offset(b);
      y[b] = {Eigen::Map<const Vec3>(at), Eigen::Map<const Vec3>(at + 3)};
    }
    std::copy_n(rhs_.data() + first, rows, mu);
  }

 private:
  int body_of(int joint, Side side) const {
    return side == kChild ? system_.joints[joint].child : system_.joints[joint].parent;
  }
  const System& system_;
  BlockLU lu_;
  std::vector<double> rhs_;
  std::vector<double*> diagonals_, lower_, upper_;
};

// Index-1 accelerations and multipliers (a, lam) of a state: M a + G^T lam = f, G a + gamma = 0.
class Index1 {
 public:
  explicit Index1(const System& system)
      : saddle(system), system_(system), force_(system.n() + 1), rate_(system.rows()) {}

  SaddlePoint saddle;  // factored at the state's configuration by the caller

  void accelerations(const ConstraintRows& G, State& state) {
    for (int b = 0; b < system_.n(); ++b) force_[b] = generalized_force(system_, b, state.u[b]);
    double* rate = rate_.data();
    for (size_t j = 0; j < system_.joints.size(); ++j) {
      const Joint& joint = system_.joints[j];
      G.at(static_cast<int>(j), state.frames).gamma(state.u[joint.parent], state.u[joint.child], rate);
      rate += joint.rows();
    }
    for (double& r : rate_) r = -r;
    saddle.solve(force_, rate_.data(), state.a, state.lam.data());
  }

 private:
  const System& system_;
  std::vector<Twist> force_;
  std::vector<double> rate_;
};

// a = M^-1 (f - G^T lam) with the multipliers a method found itself.
inline void accelerations_from_multipliers(const System& system, const ConstraintRows& G, State& state) {
  for (int b = 0; b < system.n(); ++b) state.a[b] = generalized_force(system, b, state.u[b]);
  G.subtract_reactions(state.lam.data(), 1.0, state.a);
  for (int b = 0; b < system.n(); ++b) state.a[b] = velocity(system.bodies[b], state.a[b]);
  state.a[system.n()] = Twist{};
}

}  // namespace lieeuler
