// The saddle-point system of few constraint rows by its Schur complement, made for many right-hand sides.
//
//   S = G M^-1 G^T,   lam = S^-1 (G M^-1 f + gamma),   udot = M^-1 (f - G^T lam)
//
// Bodies pinned to the ground have no translation: M is their inertia about the pin, and the pin has no multiplier.
#pragma once

#include "reference_points.hpp"

namespace lieeuler {

class SmallSaddle {
 public:
  static constexpr int kMostRows = 12;

  SmallSaddle(const System& system, const ReferencePoints& points) : system_(system), points_(points), nodes_(system, false) {
    for (int b = 0; b < system.n(); ++b)
      bodies_.push_back({1 / system.bodies[b].mass, points.inertia(b).inverse()});
    for (int k = 0; k < nodes_.parts(); ++k) {
      if (points.holds(nodes_.part(k))) continue;
      const Joint& joint = system.joints[nodes_.part(k).joint];
      const Part& part = joint.parts[nodes_.part(k).part];
      const int first = 3 * static_cast<int>(multipliers_.size());
      for (Side side : kSides) {
        const int body = side == kChild ? joint.child : joint.parent;
        if (body != system.n()) sides_.push_back({&part, nodes_.part(k).joint, side, body, first, {}, {}});
      }
      multipliers_.push_back({3 * nodes_.lam(k), part.rows()});
    }
    if (rows() <= kMostRows) inverse_.resize(rows(), rows());
  }
  int rows() const { return 3 * static_cast<int>(multipliers_.size()); }

  bool factor(const Constraints& joints, const std::vector<Frame>& frames) {
    inverse_.setZero();
    for (size_t p = 0; p < multipliers_.size(); ++p)
      for (int r = multipliers_[p].rows; r < 3; ++r) inverse_(3 * p + r, 3 * p + r) = 1;
    for (Sided& side : sides_) {
      const Rows G = joints[side.joint].jacobian(*side.part, side.side);
      side.G = points_.moved(G, side.body, frames[side.body].R);
      side.H.w.noalias() = bodies_[side.body].inertia_inverse * side.G.w.transpose();
      side.H.v = bodies_[side.body].mass_inverse * side.G.v.transpose();
    }
    for (const Sided& row : sides_)
      for (const Sided& column : sides_) {
        if (row.body != column.body) continue;
        auto block = inverse_.block<3, 3>(row.first, column.first);
        block.noalias() += row.G.w * column.H.w;
        block.noalias() += row.G.v * column.H.v;
      }
    return invert();
  }

  // In the layout of Nodes: forces and -gamma in, accelerations and multipliers out.
  void solve(std::vector<double>& z) {
    for (int b = 0; b < system_.n(); ++b) {
      double* const f = &z[3 * nodes_.v(b)];
      for (int i = 0; i < 3; ++i) f[i] *= bodies_[b].mass_inverse;
      store(Vec3(bodies_[b].inertia_inverse * load3(f + 3)), f + 3);
    }
    double r[kMostRows];
    for (size_t p = 0; p < multipliers_.size(); ++p) store(Vec3(-load3(&z[multipliers_[p].unknown])), r + 3 * p);
    for (const Sided& side : sides_) {
      const double* const y = &z[3 * nodes_.v(side.body)];
      Vec3 sum = side.G.w * load3(y + 3);
      if (!points_.pinned(side.body)) sum += side.G.v * load3(y);
      for (int i = 0; i < 3; ++i) r[side.first + i] += sum[i];
    }
    double lam[kMostRows];
    Eigen::Map<Vector> solution(lam, rows());
    solution.noalias() = inverse_ * Eigen::Map<const Vector>(r, rows());
    for (const Sided& side : sides_) {
      double* const y = &z[3 * nodes_.v(side.body)];
      const Vec3 l = load3(lam + side.first);
      store(Vec3(load3(y + 3) - side.H.w * l), y + 3);
      if (!points_.pinned(side.body)) store(Vec3(load3(y) - side.H.v * l), y);
    }
    for (size_t p = 0; p < multipliers_.size(); ++p) store(load3(lam + 3 * p), &z[multipliers_[p].unknown]);
  }

 private:
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostRows, 1>;
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostRows, kMostRows>;
  struct Inertia {
    double mass_inverse;
    Mat3 inertia_inverse;
  };
  // One side of a part: its rows G and M^-1 G^T.
  struct Sided {
    const Part* part;
    int joint;
    Side side;
    int body, first;
    Rows G, H;
  };
  struct Multiplier {
    int unknown, rows;
  };

  // False where a pivot has lost all but rounding of its diagonal entry: the rows have become dependent.
  bool invert() {
    constexpr double kSingular = 1e-13;
    if (rows() == 0) return true;
    const Eigen::LLT<Matrix> factors(inverse_);
    if (factors.info() != Eigen::Success) return false;
    for (int i = 0; i < rows(); ++i) {
      const double pivot = factors.matrixLLT()(i, i);
      if (!(pivot * pivot > kSingular * inverse_(i, i))) return false;
    }
    inverse_ = factors.solve(Matrix::Identity(rows(), rows()));
    return true;
  }

  const System& system_;
  const ReferencePoints& points_;
  const Nodes nodes_;
  std::vector<Inertia> bodies_;
  std::vector<Sided> sides_;
  std::vector<Multiplier> multipliers_;
  Matrix inverse_;
};

}  // namespace lieeuler
