// Symplectic Lie group Euler methods for the constrained Hamilton equations (doi:10.1177/1687814019842406) in
// Hamilton-Pontryagin form (doi:10.1007/s10208-008-9030-4), with Lam = h lam and D*, Ad* acting on the rotational part:
//
//   D*(h xi) M xi = p_n + h f_app(q_n, xi) - G_n^T Lam,   q = q_n * (h xi),   p = Ad*(h xi) D*(h xi) M xi
//
//   position      Phi(q) = 0                                                          DAE3H_LE
//   velocity      G M^-1 p = 0                                                        DAE2H_LE
//   stabilised    Phi(q) = 0, then p <- p - G^T mu with G M^-1 p = 0                  DAE2H_LSE, DAE1H_LSE
//
// Unknowns: xi of each body, Lam of each joint.
#pragma once

#include "euler.hpp"

namespace lieeuler {

template <class Map>
class HamiltonStepper : public EulerStepper<HamiltonStepper<Map>, Map> {
  using Base = EulerStepper<HamiltonStepper<Map>, Map>;
  friend Base;

 public:
  HamiltonStepper(const System& system, Level level, bool index1_output)
      : Base(system, level, index1_output, 6, 1), rotations_(system.n() + 1), slopes_(system.n() + 1),
        impulse_(system.n() + 1), mu_(system.rows(), 0.0) {}

  Status residual(const std::vector<double>& z, std::vector<double>& r) {
    if (!configure(z)) return Status::map_domain;
    for (int b = 0; b < this->system_.n(); ++b) {
      const Body& body = this->system_.bodies[b];
      const Twist& xi = this->xi_[b];
      const Vec3 y = this->maps_[b].momentum(body.inertia * xi.w);
      store({body.mass * xi.v - impulse_[b].v, y - impulse_[b].w}, r.data() + 6 * b);
      if (by_velocity()) this->state_.u[b] = {xi.v, body.inertia_inverse * (rotations_[b].transpose() * y)};
    }
    if (by_velocity()) this->rows_.evaluate(this->state_.frames);
    for (int j = 0; j < this->joints(); ++j) {
      double* out = r.data() + this->joint_offset_[j];
      if (by_velocity()) {
        this->rows_.velocity(j, this->state_.u, out);
      } else {
        this->rows_.at(j, this->state_.frames).position(out);
        for (int k = 0; k < this->system_.joints[j].rows(); ++k) out[k] /= h_;
      }
    }
    return Status::success;
  }

  static constexpr bool has_velocity_rows(Level level) { return level == Level::velocity; }
  static constexpr bool exact_matrix() { return true; }
  void matrix(BlockLU& lu) {
    lu.set_zero();
    if (!by_velocity()) this->rows_.evaluate(this->state_.frames);
    for (int b = 0; b < this->system_.n(); ++b) {
      const Body& body = this->system_.bodies[b];
      const Vec3& w = this->xi_[b].w;
      slopes_[b] = this->maps_[b].momentum_slope(w, body.inertia * w, body.inertia, h_);
      Eigen::Map<Mat6> block(this->diagonals_[b]);
      block.diagonal().template head<3>().setConstant(body.mass);
      block.template bottomRightCorner<3, 3>() = slopes_[b];
    }
    for (int j = 0; j < this->joints(); ++j)
      for (Side side : {kParent, kChild})
        if (this->lower_[2 * j + side]) constraint_blocks(j, side);
  }

 private:
  using Base::h_;
  bool by_velocity() const { return this->level_ == Level::velocity; }

  void guess(std::vector<double>& z) const {
    for (int b = 0; b < this->system_.n(); ++b) store(this->state_.u[b], z.data() + 6 * b);
    for (int r = 0; r < this->system_.rows(); ++r) z[6 * this->system_.n() + r] = h_ * this->state_.lam[r];
  }

  // q = q_n * (h xi) and the impulse p_n + h f_app(q_n, xi) - G_n^T Lam.
  bool configure(const std::vector<double>& z) {
    for (int b = 0; b < this->system_.n(); ++b) {
      this->xi_[b] = load(z.data() + 6 * b);
      if (!this->move(b)) return false;
      rotations_[b] = this->maps_[b].rotation();
      const Twist p = momentum(this->system_.bodies[b], this->start_.u[b]), f = applied_force(this->system_, b);
      impulse_[b] = {p.v + h_ * f.v, p.w + h_ * f.w};
    }
    this->start_rows_.subtract_reactions(z.data() + 6 * this->system_.n(), 1.0, impulse_);
    return true;
  }

  void constraint_blocks(int j, Side side) {
    const int rows = this->system_.joints[j].rows(), b = this->body_of(j, side);
    const Mat3 T = this->maps_[b].left_tangent();
    const Rows &G = this->rows_(j, side), &before = this->start_rows_(j, side);
    Rows slope = G;
    if (by_velocity()) {
      // d(G M^-1 p): p_w = E^T y turns with E, and G with the configuration.
      const Body& body = this->system_.bodies[b];
      const Mat3 turned = rotations_[b].transpose() * slopes_[b] + h_ * hat(body.inertia * this->state_.u[b].w) * T;
      const Mat3 velocity_slope = body.inertia_inverse * turned;
      Rows N;
      this->rows_.at(j, this->state_.frames)
          .velocity_slope(side, this->velocity_of(j, kParent), this->velocity_of(j, kChild), N);
      for (int r = 0; r < rows; ++r)
        slope.row(r) << G.row(r).template head<3>() + h_ * N.row(r).template head<3>(),
            G.row(r).template tail<3>() * velocity_slope + h_ * N.row(r).template tail<3>() * T;
    } else {
      for (int r = 0; r < rows; ++r) slope.row(r).template tail<3>() = G.row(r).template tail<3>() * T;
    }
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < 6; ++c) {
        this->lower_[2 * j + side][r * 6 + c] = slope(r, c);
        this->upper_[2 * j + side][c * rows + r] = before(r, c);
      }
  }

  Status finish() {
    if (!configure(this->z_)) return Status::map_domain;
    for (int b = 0; b < this->system_.n(); ++b) {
      impulse_[b].w = rotations_[b].transpose() * impulse_[b].w;  // p, from here on
      this->state_.u[b] = velocity(this->system_.bodies[b], impulse_[b]);
    }
    this->polish();
    this->rows_.evaluate(this->state_.frames);
    for (int r = 0; r < this->system_.rows(); ++r) this->state_.lam[r] = this->z_[6 * this->system_.n() + r] / h_;
    if (this->level_ == Level::stabilised) {
      if (!this->index1_.saddle.factor(this->rows_)) return Status::singular_matrix;
      this->index1_.saddle.solve(impulse_, nullptr, this->state_.u, mu_.data());
      for (int r = 0; r < this->system_.rows(); ++r) this->state_.lam[r] += mu_[r] / h_;
    }
    if (this->index1_output_)
      this->index1_.accelerations(this->rows_, this->state_);  // factored above: index-1 output comes with stabilised
    else
      accelerations_from_multipliers(this->system_, this->rows_, this->state_);
    return Status::success;
  }

  std::vector<Mat3> rotations_, slopes_;  // E, and d(D* J xi)/d xi
  std::vector<Twist> impulse_;
  std::vector<double> mu_;
};

}  // namespace lieeuler
