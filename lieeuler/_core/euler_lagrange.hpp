// Implicit Lie group Euler methods for the Lagrangian equations (doi:10.1177/1687814019842406), all at n+1:
//
//   M (u - u_n) = h f(q, u) - G^T Lam,   Lam = h lam,   q = q_n * (h xi)
//
//   position      Phi(q) = 0                                    xi = u                    DAE3L_LE
//   velocity      G u = 0                                       xi = u                    DAE2L_LE
//   stabilised    Phi(q) = 0, G u = 0                           M xi = M u - G_n^T mu     DAE2L_LSE, DAE1L_LSE
//   acceleration  G a + gamma + 2 alpha G u + beta^2 Phi = 0    xi = u, a = (u - u_n)/h   INDEX1_LE, BAUMGARTE_LE
//
// Unknowns: u of each body (u and xi when stabilised), Lam of each joint (Lam and mu).
#pragma once

#include "euler.hpp"

namespace lieeuler {

struct Gains {
  double alpha = 0, beta = 0;  // 1/s
};

template <class Map>
class LagrangeStepper : public EulerStepper<LagrangeStepper<Map>, Map> {
  using Base = EulerStepper<LagrangeStepper<Map>, Map>;
  friend Base;

 public:
  LagrangeStepper(const System& system, Level level, bool index1_output, Gains gains)
      : Base(system, level, index1_output, level == Level::stabilised ? 12 : 6, level == Level::stabilised ? 2 : 1),
        gains_(gains), tangents_(system.n() + 1), balance_(system.n() + 1), drift_(system.n() + 1),
        impulses_(system.rows()), corrections_(system.rows()) {}

  Status residual(const std::vector<double>& z, std::vector<double>& r) {
    if (!configure(z)) return Status::map_domain;
    this->rows_.evaluate(this->state_.frames);
    for (int b = 0; b < this->system_.n(); ++b) {
      const Body& body = this->system_.bodies[b];
      const Twist &u = this->state_.u[b], &before = this->start_.u[b], f = generalized_force(this->system_, b, u);
      balance_[b] = {body.mass * (u.v - before.v) - h_ * f.v, body.inertia * (u.w - before.w) - h_ * f.w};
      if (stabilised()) drift_[b] = momentum(body, {this->xi_[b].v - u.v, this->xi_[b].w - u.w});
    }
    for (int j = 0; j < this->joints(); ++j) {
      const int rows = this->system_.joints[j].rows(), at = this->joint_offset_[j];
      std::copy_n(z.data() + at, rows, impulses_.data() + this->row_offset_[j]);
      if (stabilised()) std::copy_n(z.data() + at + rows, rows, corrections_.data() + this->row_offset_[j]);
      constraint_residual(j, r.data() + at);
    }
    this->rows_.subtract_reactions(impulses_.data(), -1.0, balance_);
    if (stabilised()) this->start_rows_.subtract_reactions(corrections_.data(), -1.0, drift_);
    for (int b = 0; b < this->system_.n(); ++b) {
      store(balance_[b], r.data() + this->lu_.offset(b));
      if (stabilised()) store(drift_[b], r.data() + this->lu_.offset(b) + 6);
    }
    return Status::success;
  }

  static constexpr bool has_velocity_rows(Level level) { return level != Level::position; }
  bool exact_matrix() const { return this->level_ != Level::acceleration; }
  void matrix(BlockLU& lu) {
    lu.set_zero();
    for (int b = 0; b < this->system_.n(); ++b) {
      tangents_[b] = this->maps_[b].left_tangent();
      body_block(b);
    }
    for (int j = 0; j < this->joints(); ++j) {
      for (Side row : {kParent, kChild})
        for (Side column : {kParent, kChild}) stiffness_block(j, row, column);
      for (Side side : {kParent, kChild})
        if (this->lower_[2 * j + side]) constraint_blocks(j, side);
    }
  }

 private:
  using Base::h_;
  bool stabilised() const { return this->level_ == Level::stabilised; }

  void guess(std::vector<double>& z) const {
    for (int b = 0; b < this->system_.n(); ++b)
      for (int at = this->lu_.offset(b); at < this->lu_.offset(b + 1); at += 6) store(this->state_.u[b], z.data() + at);
    for (int j = 0; j < this->joints(); ++j)
      for (int r = 0; r < this->system_.joints[j].rows(); ++r)
        z[this->joint_offset_[j] + r] = h_ * this->state_.lam[this->row_offset_[j] + r];
  }

  bool configure(const std::vector<double>& z) {
    for (int b = 0; b < this->system_.n(); ++b) {
      this->state_.u[b] = load(z.data() + this->lu_.offset(b));
      this->xi_[b] = stabilised() ? load(z.data() + this->lu_.offset(b) + 6) : this->state_.u[b];
      if (!this->move(b)) return false;
    }
    return true;
  }

  // Velocity row first, position row second where there are both; positions are divided by h.
  void constraint_residual(int j, double* out) {
    const int rows = this->system_.joints[j].rows();
    const JointState here = this->rows_.at(j, this->state_.frames);
    double phi[kMaxRows], rate[kMaxRows];
    here.position(phi);
    this->rows_.velocity(j, this->state_.u, rate);
    switch (this->level_) {
      case Level::position:
        for (int r = 0; r < rows; ++r) out[r] = phi[r] / h_;
        break;
      case Level::velocity:
        std::copy_n(rate, rows, out);
        break;
      case Level::stabilised:
        std::copy_n(rate, rows, out);
        for (int r = 0; r < rows; ++r) out[rows + r] = phi[r] / h_;
        break;
      case Level::acceleration: {
        double gamma[kMaxRows], before[kMaxRows];
        here.gamma(this->velocity_of(j, kParent), this->velocity_of(j, kChild), gamma);
        this->rows_.velocity(j, this->start_.u, before);
        const double damping = 2 * gains_.alpha, stiffness = gains_.beta * gains_.beta;
        for (int r = 0; r < rows; ++r)
          out[r] = (rate[r] - before[r]) + h_ * (gamma[r] + damping * rate[r] + stiffness * phi[r]);
      }
    }
  }

  // M - h df/du, and M (xi - u) below it.
  void body_block(int b) {
    const Body& body = this->system_.bodies[b];
    const Vec3& w = this->state_.u[b].w;
    const Mat3 dynamic = body.inertia + h_ * gyroscopic_slope(w, body.inertia * w, body.inertia);
    const int width = this->body_size_;
    double* block = this->diagonals_[b];
    for (int i = 0; i < 3; ++i) {
      block[i * width + i] = body.mass;
      for (int k = 0; k < 3; ++k) block[(3 + i) * width + 3 + k] = dynamic(i, k);
    }
    if (!stabilised()) return;
    for (int i = 0; i < 3; ++i) {
      block[(6 + i) * width + 6 + i] = body.mass, block[(6 + i) * width + i] = -body.mass;
      for (int k = 0; k < 3; ++k) {
        block[(9 + i) * width + 9 + k] = body.inertia(i, k);
        block[(9 + i) * width + 3 + k] = -body.inertia(i, k);
      }
    }
  }

  // h d(G^T Lam)/dq T, onto the columns of xi.
  void stiffness_block(int j, Side row, Side column) {
    const Joint& joint = this->system_.joints[j];
    const int row_body = this->body_of(j, row), column_body = this->body_of(j, column), ground = this->system_.n();
    if (row_body == ground || column_body == ground || (row != column && joint.dots.empty())) return;
    double* target = row == column ? this->diagonals_[row_body] : this->coupling_[2 * j + row];
    Mat6 K = Mat6::Zero();
    const double* impulse = impulses_.data() + this->row_offset_[j];
    this->rows_.at(j, this->state_.frames).geometric_stiffness(row, column, impulse, K);
    const Mat3 &T = tangents_[column_body];
    K.topRightCorner<3, 3>() = (K.topRightCorner<3, 3>() * T).eval();
    K.bottomRightCorner<3, 3>() = (K.bottomRightCorner<3, 3>() * T).eval();
    const int width = this->body_size_, shift = width - 6;
    for (int i = 0; i < 6; ++i)
      for (int k = 0; k < 6; ++k) target[i * width + shift + k] += h_ * K(i, k);
  }

  void constraint_blocks(int j, Side side) {
    const int rows = this->system_.joints[j].rows();
    const Mat3& T = tangents_[this->body_of(j, side)];
    const Rows& G = this->rows_(j, side);
    Rows moved = G, rate = Rows::Zero();  // G T, and h d(rate)/dq T
    for (int r = 0; r < rows; ++r) moved.row(r).tail<3>() = G.row(r).tail<3>() * T;
    if (this->level_ != Level::position) rate_slope(j, side, rate);
    double *lower = this->lower_[2 * j + side], *upper = this->upper_[2 * j + side];
    if (!stabilised()) {
      for (int r = 0; r < rows; ++r)
        for (int c = 0; c < 6; ++c) {
          lower[r * 6 + c] = this->level_ == Level::position ? moved(r, c) : G(r, c) + rate(r, c);
          upper[c * rows + r] = G(r, c);
        }
      return;
    }
    const Rows& before = this->start_rows_(j, side);
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < 6; ++c) {
        lower[r * 12 + c] = G(r, c), lower[r * 12 + 6 + c] = rate(r, c);
        lower[(rows + r) * 12 + 6 + c] = moved(r, c);
        upper[c * 2 * rows + r] = G(r, c), upper[(6 + c) * 2 * rows + rows + r] = before(r, c);
      }
  }

  // Derivative of the velocity or acceleration row with respect to xi beyond G itself. For the acceleration level the
  // third derivatives of Phi are left out: they enter at h^2, and the iteration still ends at the exact equations.
  void rate_slope(int j, Side side, Rows& slope) {
    const int rows = this->system_.joints[j].rows();
    const Mat3& T = tangents_[this->body_of(j, side)];
    const JointState here = this->rows_.at(j, this->state_.frames);
    const Twist &parent = this->velocity_of(j, kParent), &child = this->velocity_of(j, kChild);
    Rows first;
    if (this->level_ != Level::acceleration) {
      here.velocity_slope(side, parent, child, first);
      for (int r = 0; r < rows; ++r) slope.row(r) << h_ * first.row(r).head<3>(), h_ * first.row(r).tail<3>() * T;
      return;
    }
    auto change = [&](int b) {
      return Twist{this->state_.u[b].v - this->start_.u[b].v, this->state_.u[b].w - this->start_.u[b].w};
    };
    Rows second;
    here.velocity_slope(side, change(this->body_of(j, kParent)), change(this->body_of(j, kChild)), first);  // d(G h a)/dq
    here.gamma_velocity_slope(side, parent, child, second);
    const double feedback = 2 * gains_.alpha + h_ * gains_.beta * gains_.beta;
    for (int r = 0; r < rows; ++r)
      slope.row(r) = h_ * (first.row(r) + second.row(r) + feedback * this->rows_(j, side).row(r));
  }

  Status finish() {
    if (!configure(this->z_)) return Status::map_domain;
    this->polish();
    this->rows_.evaluate(this->state_.frames);
    if (this->index1_output_) return this->solve_index1();
    for (int j = 0; j < this->joints(); ++j)
      for (int r = 0; r < this->system_.joints[j].rows(); ++r)
        this->state_.lam[this->row_offset_[j] + r] = this->z_[this->joint_offset_[j] + r] / h_;
    for (int b = 0; b < this->system_.n(); ++b)
      this->state_.a[b] = {(this->state_.u[b].v - this->start_.u[b].v) / h_,
                           (this->state_.u[b].w - this->start_.u[b].w) / h_};
    return Status::success;
  }

  Gains gains_;
  std::vector<Mat3> tangents_;
  std::vector<Twist> balance_, drift_;          // residuals of the dynamics and of M xi = M u - G_n^T mu
  std::vector<double> impulses_, corrections_;  // Lam and mu, in the order of lam
};

}  // namespace lieeuler
