// The saddle-point system of few constraint rows by its Schur complement, made for many right-hand sides.
//
//   S = G M^-1 G^T,   lam = S^-1 (G M^-1 f + gamma),   udot = M^-1 (f - G^T lam)
//
// Where a light body carries a heavy one, S is the sum of a large and a small matrix and keeps few digits of the small
// one: what is left of G udot + gamma is then solved for once more, which restores them.
//
// Bodies pinned to the ground have no translation: M is their inertia about the pin, and the pin has no multiplier.
#pragma once

#include "model/reference_points.hpp"

namespace lieeuler {

class SmallSaddle {
 public:
  SmallSaddle(const System& system, const ReferencePoints& points) : points_(points) {
    for (int b = 0; b < system.n(); ++b) bodies_.push_back({1 / system.bodies[b].mass, points.inertia(b).inverse()});
    const Nodes nodes(system, false);
    for (int k = 0; k < nodes.parts(); ++k) {
      if (points.holds(nodes.part(k))) continue;
      const Joint& joint = system.joints[nodes.part(k).joint];
      const Part& part = joint.parts[nodes.part(k).part];
      const int place = parts();
      for (Side side : kSides) {
        const int body = side == kChild ? joint.child : joint.parent;
        if (body != system.n()) sides_.push_back({&part, nodes.part(k).joint, side, body, place, {}, {}});
      }
      parts_.push_back({k, part.rows()});
    }
    if (parts() > kMostParts) return;
    inverse_.resize(parts() * parts());
    factor_.resize(9 * inverse_.size());
  }
  static constexpr int kMostParts = 4;
  // Parts that are left for multipliers.
  int parts() const { return static_cast<int>(parts_.size()); }

  // False where the rows have become dependent.
  bool factor(const Constraints& joints, const Configuration& frames) {
    for (Mat3& block : inverse_) block.setZero();
    for (int p = 0; p < parts(); ++p)
      for (int r = parts_[p].rows; r < 3; ++r) block(p, p)(r, r) = 1;
    for (Sided& side : sides_) {
      side.G = points_.moved(joints[side.joint].jacobian(*side.part, side.side), side.body, frames[side.body].R);
      side.H.w.noalias() = bodies_[side.body].inertia_inverse * side.G.w.transpose();
      side.H.v = bodies_[side.body].mass_inverse * side.G.v.transpose();
    }
    for (const Sided& row : sides_)
      for (const Sided& column : sides_) {
        if (row.body != column.body) continue;
        Mat3& S = block(row.place, column.place);
        S.noalias() += row.G.w * column.H.w;
        if (!points_.pinned(row.body)) S.noalias() += row.G.v * column.H.v;
      }
    smallest_pivot_ = 1;
    return parts() == 1 ? invert_block() : invert();
  }

  // M y + G^T lam = f, G y = rows: takes f and the rows of each part, leaves y and lam in their places, to rounding
  // always.
  void solve(std::vector<Twist>& f, std::vector<Vec3>& rows, bool) {
    for (size_t b = 0; b < bodies_.size(); ++b) {
      f[b].v *= bodies_[b].mass_inverse;
      f[b].w = Vec3(bodies_[b].inertia_inverse * f[b].w);
    }
    if (parts() == 0) return;
    Vec3 r[kMostParts], lam[kMostParts];
    for (int p = 0; p < parts(); ++p) r[p] = -rows[parts_[p].part];
    add_rates(f, r);
    correct(r, lam, f);
    if (smallest_pivot_ < kGraded) {
      Vec3 more[kMostParts];
      for (int p = 0; p < parts(); ++p) r[p] = -rows[parts_[p].part];
      add_rates(f, r);
      correct(r, more, f);
      for (int p = 0; p < parts(); ++p) lam[p] += more[p];
    }
    for (int p = 0; p < parts(); ++p) rows[parts_[p].part] = lam[p];
  }

 private:
  static constexpr double kSingular = 1e-13;  // what rounding leaves of a pivot
  static constexpr double kGraded = 1e-3;     // of its entry: a pivot below it has lost three digits
  struct Inertia {
    double mass_inverse;
    Mat3 inertia_inverse;
  };
  struct PartRows {
    int part, rows;
  };
  // One side of a part: its rows G and M^-1 G^T.
  struct Sided {
    const Part* part;
    int joint;
    Side side;
    int body, place;
    Rows G, H;
  };

  Mat3& block(int row, int column) { return inverse_[row * parts() + column]; }

  // r += G y
  void add_rates(const std::vector<Twist>& y, Vec3* r) const {
    for (const Sided& side : sides_) {
      r[side.place] += side.G.w * y[side.body].w;
      if (!points_.pinned(side.body)) r[side.place] += side.G.v * y[side.body].v;
    }
  }
  // lam = S^-1 r,  y -= M^-1 G^T lam
  void correct(const Vec3* r, Vec3* lam, std::vector<Twist>& y) {
    for (int p = 0; p < parts(); ++p) {
      lam[p] = block(p, 0) * r[0];
      for (int q = 1; q < parts(); ++q) lam[p] += block(p, q) * r[q];
    }
    for (const Sided& side : sides_) {
      y[side.body].w -= side.H.w * lam[side.place];
      if (!points_.pinned(side.body)) y[side.body].v -= side.H.v * lam[side.place];
    }
  }

  bool invert_block() {
    Mat3& S = inverse_[0];
    const Vec3 a = S.col(1).cross(S.col(2));
    const double volume = S.col(0).dot(a);
    const double size = S(0, 0) * S(1, 1) * S(2, 2);
    if (!(volume > kSingular * size)) return false;
    smallest_pivot_ = volume / size;
    Mat3 rows;
    rows << a.transpose(), S.col(2).cross(S.col(0)).transpose(), S.col(0).cross(S.col(1)).transpose();
    S = rows / volume;
    return true;
  }
  // By Cholesky's factors, S = L L^T; the inverse of L takes its place, then S^-1 = L^-T L^-1 that of the blocks.
  bool invert() {
    const int n = 3 * parts();
    auto L = [&](int i, int j) -> double& { return factor_[i * n + j]; };
    for (int j = 0; j < n; ++j)
      for (int i = j; i < n; ++i) {
        const double entry = block(i / 3, j / 3)(i % 3, j % 3);
        double sum = entry;
        for (int k = 0; k < j; ++k) sum -= L(i, k) * L(j, k);
        if (i == j && !(sum > kSingular * entry)) return false;
        if (i == j) smallest_pivot_ = std::min(smallest_pivot_, sum / entry);
        L(i, j) = i == j ? std::sqrt(sum) : sum / L(j, j);
      }
    for (int j = 0; j < n; ++j) {
      L(j, j) = 1 / L(j, j);
      for (int i = j + 1; i < n; ++i) {
        double sum = 0;
        for (int k = j; k < i; ++k) sum -= L(i, k) * L(k, j);
        L(i, j) = sum / L(i, i);
      }
    }
    for (int i = 0; i < n; ++i)
      for (int j = 0; j <= i; ++j) {
        double sum = 0;
        for (int k = i; k < n; ++k) sum += L(k, i) * L(k, j);
        block(i / 3, j / 3)(i % 3, j % 3) = block(j / 3, i / 3)(j % 3, i % 3) = sum;
      }
    return true;
  }

  const ReferencePoints& points_;
  std::vector<Inertia> bodies_;
  std::vector<PartRows> parts_;
  std::vector<Sided> sides_;
  std::vector<Mat3> inverse_;  // S^-1 by blocks
  std::vector<double> factor_;
  double smallest_pivot_ = 1;  // of S, over its entry
};

}  // namespace lieeuler
