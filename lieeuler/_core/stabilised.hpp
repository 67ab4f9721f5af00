// The linear systems of the stabilised Lagrangian methods on trees, in two parts instead of one of twice the size.
//
// Newton's system for (du, dLam, dxi, dmu), with A = M - h df/du, K the stiffness onto xi and N the slope of the velocity
// rows, is
//
//   A du + h K dxi + G^T dLam = r_u        M (dxi - du) + Gn^T dmu = r_xi
//   G du + h N dxi            = r_lam      G T dxi                 = r_mu
//
// du follows from the second of the first column's rows. What is left, with c = dLam + dmu, couples only through
// E = A M^-1 Gn^T - G^T = O(h):
//
//   [A + h K, G^T; G T, 0] (dxi, c) = (r_u + A M^-1 r_xi - E dmu, r_mu)
//   G M^-1 Gn^T dmu                 = r_lam + G M^-1 r_xi - (G + h N) dxi
//
// and since (G + h N) dxi is r_mu but for O(h) dxi, dmu is known to O(h) beforehand, and a sweep over the two shrinks the
// error by O(h^2).
#pragma once

#include "delassus.hpp"

namespace lieeuler {

class StabilisedSolve {
 public:
  // `delassus` is worked in from factor() to solve(), free in between.
  StabilisedSolve(const System& system, Delassus& delassus)
      : system_(system), delassus_(delassus), slopes_(2 * delassus_.parts(), Mat3::Zero()), rows_(3 * delassus_.parts(), 0.0),
        mu_(rows_), core_rhs_(6 * system.n() + rows_.size(), 0.0), total_(core_rhs_), force_(system.n() + 1),
        change_(force_), balance_(force_), shift_(force_), position_(delassus_.parts()) {}

  // Where the sweeps converge by construction: no damping, and no loops, whose redundant rows need the whole matrix.
  static bool suits(const System& system) {
    return elimination_order(system).loops.empty() &&
           std::all_of(system.forces.begin(), system.forces.end(), [](const Force& f) { return f.damping == 0; });
  }

  // At the guess: constraint rows there, their multipliers' columns at q_n, and h N T of every part's side.
  void factor(const Constraints& joints, const Constraints& before) {
    joints_ = &joints;
    delassus_.assemble(joints, before);
    regular_ = delassus_.lu().factor();
  }
  // Of a spherical part the rotations' alone.
  Mat3& slope(int part, Side side) { return slopes_[2 * part + side]; }
  Mat3& translation_slope(int part, Side side) {
    if (translation_slopes_.empty()) translation_slopes_.assign(slopes_.size(), Mat3::Zero());
    return translation_slopes_[2 * part + side];
  }

  // Solves for the corrections r -> (du, dLam, dxi, dmu), laid out as in `nodes`. `core` holds the factorized first
  // matrix; `tolerance` is the error wanted of dxi, translations over `length`. False where the sweeps do not converge.
  // The velocity rows hold in any case: dmu is solved last.
  bool solve(std::vector<double>& r, const Nodes& nodes, BlockLU& core, const std::vector<Twist>& u, double h,
             double length, double tolerance) {
    if (!regular_) return false;
    const double coupling = kCaution * start(r, nodes, u, h, length);
    double last = std::numeric_limits<double>::infinity();
    for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
      core.solve(core_rhs_.data());
      for (int b = 0; b < system_.n(); ++b) change_[b] = load(&core_rhs_[6 * b]);
      for (size_t i = 0; i < total_.size(); ++i) total_[i] = sweep == 0 ? core_rhs_[i] : total_[i] + core_rhs_[i];
      follow();
      if (sweep == 0 && coupling * largest(rows_) <= tolerance) return finish(r, nodes);
      std::fill(core_rhs_.begin(), core_rhs_.end(), 0.0);
      const double left = couple(u, h, length);
      if (left <= tolerance) return finish(r, nodes);
      if (!(left < kSlow * last)) return left <= kNoise * tolerance && finish(r, nodes);
      last = left;
    }
    return false;
  }

 private:
  static constexpr int kMostSweeps = 12;
  static constexpr double kSlow = 0.3;
  static constexpr double kNoise = 1e3;  // times the tolerance: what no longer shrinks there is rounding
  static constexpr double kCaution = 10;  // on the size of E, seen along one direction

  // A M^-1 y - y for one body, h times the slope of the gyroscopic torque: rotations only.
  Vec3 gyroscopic(int b, const Twist& u, const Vec3& y, double h) const {
    const Body& body = system_.bodies[b];
    return h * (u.w.cross(y) - angular_momentum(body, u.w).cross(body.inertia_inverse * y));
  }
  static double largest(const std::vector<double>& values) {
    double size = 0;
    for (double value : values) size = std::max(size, std::abs(value));
    return size;
  }
  // The first right-hand sides, with dmu as if (G + h N) dxi were r_mu. Returns the size of E, of M^-1 E dmu over dmu.
  double start(const std::vector<double>& r, const Nodes& nodes, const std::vector<Twist>& u, double h, double length) {
    for (int b = 0; b < system_.n(); ++b) {
      const Twist own = load(&r[3 * nodes.v(b)]), drift = load(&r[3 * nodes.xi_v(b)]);
      store(Twist{own.v + drift.v, own.w + drift.w + gyroscopic(b, u[b], drift.w, h)}, &core_rhs_[6 * b]);
      force_[b] = velocity(system_.bodies[b], drift);
    }
    force_[system_.n()] = Twist{};
    for (int k = 0; k < delassus_.parts(); ++k) {
      const Joint& joint = joint_of(k);
      const Vec3 position = load3(&r[3 * nodes.mu(k)]), rate = load3(&r[3 * nodes.lam(k)]);
      store(position, &core_rhs_[6 * system_.n() + 3 * k]);
      position_[k] = position;
      store(Vec3(position - rate - state_of(k).velocity(delassus_.part(k), force_[joint.parent], force_[joint.child])),
            &rows_[3 * k]);
    }
    std::fill(mu_.begin(), mu_.end(), 0.0);
    shift_ = force_;
    solve_mu();
    const double multipliers = largest(rows_), coupled = couple(u, h, length);
    return multipliers > 0 ? coupled / multipliers : std::numeric_limits<double>::infinity();
  }
  // The change of dmu that the latest change of dxi asks for, beyond what stood for it before.
  void follow() {
    for (int k = 0; k < delassus_.parts(); ++k) {
      const Joint& joint = joint_of(k);
      Vec3 rate = state_of(k).velocity(delassus_.part(k), change_[joint.parent], change_[joint.child]) - position_[k];
      for (Side side : kSides) {
        const int b = side == kChild ? joint.child : joint.parent;
        if (b == system_.n()) continue;
        rate += slopes_[2 * k + side] * change_[b].w;
        if (!delassus_.part(k).spherical) rate += translation_slopes_[2 * k + side] * change_[b].v;
      }
      store(rate, &rows_[3 * k]);
      position_[k].setZero();
    }
    solve_mu();
  }
  // Solves - S dmu = rows_; rows_ becomes the change of dmu, force_ its - M^-1 Gn^T dmu.
  void solve_mu() {
    std::fill(force_.begin(), force_.end(), Twist{});
    delassus_.solve(force_, rows_.data());
    for (size_t i = 0; i < mu_.size(); ++i) mu_[i] += rows_[i];
    for (int b = 0; b < system_.n(); ++b) shift_[b].v += force_[b].v, shift_[b].w += force_[b].w;
  }
  // Adds - E times the latest change of dmu to the right-hand side; its size as a velocity.
  double couple(const std::vector<Twist>& u, double h, double length) {
    std::fill(balance_.begin(), balance_.end(), Twist{});
    for (int k = 0; k < delassus_.parts(); ++k) {
      const Joint& joint = joint_of(k);
      state_of(k).subtract_reaction(delassus_.part(k), load3(&rows_[3 * k]), balance_[joint.parent], balance_[joint.child]);
    }
    double size = 0;
    for (int b = 0; b < system_.n(); ++b) {
      const Body& body = system_.bodies[b];
      const Twist& y = force_[b];
      const Vec3 v = body.mass * y.v - balance_[b].v;
      const Vec3 w = body.inertia * y.w - balance_[b].w +
                     h * (u[b].w.cross(body.inertia * y.w) - angular_momentum(body, u[b].w).cross(y.w));
      size = std::max({size, v.cwiseAbs().maxCoeff() / (body.mass * length),
                       Vec3(body.inertia_inverse * w).cwiseAbs().maxCoeff()});
      for (int i = 0; i < 3; ++i) core_rhs_[6 * b + i] += v[i], core_rhs_[6 * b + 3 + i] += w[i];
    }
    return size;
  }
  // du = dxi - shift, dLam = c - dmu.
  bool finish(std::vector<double>& r, const Nodes& nodes) {
    for (int k = 0; k < delassus_.parts(); ++k) {
      const Vec3 mu = load3(&mu_[3 * k]);
      store(mu, &r[3 * nodes.mu(k)]);
      store(Vec3(load3(&total_[6 * system_.n() + 3 * k]) - mu), &r[3 * nodes.lam(k)]);
    }
    for (int b = 0; b < system_.n(); ++b) {
      const Twist xi = load(&total_[6 * b]);
      store(xi, &r[3 * nodes.xi_v(b)]);
      store(Twist{xi.v - shift_[b].v, xi.w - shift_[b].w}, &r[3 * nodes.v(b)]);
    }
    return true;
  }

  const Joint& joint_of(int k) const { return system_.joints[delassus_.index(k).joint]; }
  const JointState& state_of(int k) const { return (*joints_)[delassus_.index(k).joint]; }

  const System& system_;
  Delassus& delassus_;
  const Constraints* joints_ = nullptr;
  std::vector<Mat3> slopes_, translation_slopes_;
  std::vector<double> rows_, mu_, core_rhs_, total_;
  std::vector<Twist> force_, change_, balance_;
  std::vector<Twist> shift_;  // dxi - du = M^-1 (r_xi - Gn^T dmu)
  std::vector<Vec3> position_;  // r_mu, until the first sweep has used it
  bool regular_ = false;
};

}  // namespace lieeuler
