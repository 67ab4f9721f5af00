// The saddle-point system of a tree with few constraint rows by its Schur complement, for many right-hand sides, about
// the bodies' reference points.
//
// If a light body carries a heavy one, S is the sum of a large and a small matrix and keeps few digits of the small
// one. A second solve for the residual of G udot + gamma restores them.
#pragma once

#include "model/reference_points.hpp"

namespace lieeuler {

class SmallSchur {
 public:
  explicit SmallSchur(const Plan& plan) : system_(plan.system), points_(plan, true) {
    for (int b = 0; b < system_.n(); ++b) bodies_.push_back({1 / system_.bodies[b].mass, points_.inertia(b).inverse()});
    for (int k = 0; k < plan.count(); ++k) {
      if (points_.holds(plan.parts[k])) continue;
      const Part& part = plan.part(k);
      const int joint = plan.parts[k].joint;
      for (Side side : kSides)
        if (const int body = plan.body(k, side); body != system_.n())
          sides_.push_back({&part, joint, side, body, rows_, part.rows(), {}, {}});
      parts_.push_back({k, &part, rows_});
      rows_ += part.rows();
    }
  }

  // False if rows have become dependent.
  bool factor(const Constraints& joints) {
    assemble(joints);
    if (parts() == 1) return invert_block();
    return factor_dense();
  }

  // Solves M y + G^T lam = f, G y = rows; y and lam replace f and the rows of each part. Inlined: series call it for
  // every order.
  [[gnu::always_inline]] void solve(std::vector<Twist>& f, std::vector<Vec3>& rows, bool) {
    for (size_t b = 0; b < bodies_.size(); ++b) {
      f[b].v *= bodies_[b].mass_inverse;
      f[b].w = times(bodies_[b].inertia_inverse, f[b].w);
    }
    if (parts() == 1) solve_single(f, rows[parts_[0].index]);
    if (parts() > 1) solve_rows(f, rows);
  }

 private:
  static constexpr int kMostRows = 3 * Plan::kMostSmallParts;
  static constexpr double kSingular = 1e-13;  // a relative pivot below this is rounding
  static constexpr double kGraded = 1e-3;     // a relative pivot below this has lost three digits
  struct Inertia {
    double mass_inverse;
    Mat3 inertia_inverse;
  };
  struct PartRows {
    int index;
    const Part* part;
    int row;  // the first
  };
  // One side of a part: its rows G and M^-1 G^T.
  struct Sided {
    const Part* part;
    int joint;
    Side side;
    int body, row, rows;
    Rows G, H;
  };

  int parts() const { return static_cast<int>(parts_.size()); }
  double& S(int i, int j) { return S_[j * kMostRows + i]; }

  void assemble(const Constraints& joints) {
    std::fill_n(S_, rows_ * kMostRows, 0.0);
    for (Sided& side : sides_) {
      const JointState& joint = joints[side.joint];
      side.G = points_.moved(joint.jacobian(*side.part, side.side), side.body, joint.attitude(side.side));
      side.H.w.noalias() = bodies_[side.body].inertia_inverse * side.G.w.transpose();
      side.H.v = bodies_[side.body].mass_inverse * side.G.v.transpose();
    }
    for (const Sided& row : sides_)
      for (const Sided& column : sides_) {
        if (row.body != column.body || row.row < column.row) continue;
        Mat3 block = row.G.w * column.H.w;
        if (!points_.pinned(row.body)) block.noalias() += row.G.v * column.H.v;
        for (int j = 0; j < column.rows; ++j)
          for (int i = 0; i < row.rows; ++i) S(row.row + i, column.row + j) += block(i, j);
      }
  }

  // r = G y - rows
  void put_rates(const std::vector<Vec3>& rows, const std::vector<Twist>& y, double* r) const {
    for (const PartRows& part : parts_)
      for (int i = 0; i < part.part->rows(); ++i) r[part.row + i] = -rows[part.index][i];
    for (const Sided& side : sides_) {
      const Vec3 rate = rate_of(side, y[side.body]);
      for (int i = 0; i < side.rows; ++i) r[side.row + i] += rate[i];
    }
  }
  // G y, and y -= M^-1 G^T lam, of one side.
  [[gnu::always_inline]] Vec3 rate_of(const Sided& side, const Twist& y) const {
    Vec3 rate = times(side.G.w, y.w);
    if (!points_.pinned(side.body)) rate += side.G.v * y.v;
    return rate;
  }
  [[gnu::always_inline]] void respond(const Sided& side, const Vec3& lam, Twist& y) const {
    y.w -= times(side.H.w, lam);
    if (!points_.pinned(side.body)) y.v -= side.H.v * lam;
  }
  // r becomes lam = S^-1 r,  y -= M^-1 G^T lam
  void subtract_response(double* r, std::vector<Twist>& y) const {
    solve_dense(r);
    for (const Sided& side : sides_) {
      Vec3 own = Vec3::Zero();
      for (int i = 0; i < side.rows; ++i) own[i] = r[side.row + i];
      respond(side, own, y[side.body]);
    }
  }

  // solve() from velocities without multipliers, y = M^-1 f. Not inlined: series of pinned bodies would have to save
  // its registers.
  [[gnu::noinline]] void solve_rows(std::vector<Twist>& y, std::vector<Vec3>& rows) {
    double r[kMostRows], lam[kMostRows] = {};
    for (int pass = 0; pass < (smallest_pivot_ < kGraded ? 2 : 1); ++pass) {
      put_rates(rows, y, r);
      subtract_response(r, y);
      for (int i = 0; i < rows_; ++i) lam[i] += r[i];
    }
    for (const PartRows& part : parts_) {
      Vec3& out = rows[part.index];
      out.setZero();
      for (int i = 0; i < part.part->rows(); ++i) out[i] = lam[part.row + i];
    }
  }
  // The same for a single part, as three rows even if it has fewer.
  [[gnu::noinline]] void solve_single(std::vector<Twist>& y, Vec3& rows) {
    Vec3 lam = Vec3::Zero();
    for (int pass = 0; pass < (smallest_pivot_ < kGraded ? 2 : 1); ++pass) {
      Vec3 r = -rows;
      for (const Sided& side : sides_) r += rate_of(side, y[side.body]);
      const Vec3 more = times(inverse_, r);
      for (const Sided& side : sides_) respond(side, more, y[side.body]);
      lam += more;
    }
    rows = lam;
  }

  // S = L L^T, with L in place of the lower half and the inverses of its diagonal apart; false if it is singular.
  bool factor_dense() {
    double entry[kMostRows];
    smallest_pivot_ = 1;
    for (int j = 0; j < rows_; ++j) entry[j] = S(j, j);
    for (int j = 0; j < rows_; ++j) {
      double* const column = S_ + kMostRows * j;
      const double left = column[j] / entry[j];
      if (!(left > smallest_pivot_ || std::isnan(smallest_pivot_))) smallest_pivot_ = left;  // a NaN stays
      pivot_inverse_[j] = 1 / std::sqrt(column[j]);
      for (int i = j + 1; i < rows_; ++i) column[i] *= pivot_inverse_[j];
      for (int k = j + 1; k < rows_; ++k) {
        double* const other = S_ + kMostRows * k;
        const double factor = column[k];
        for (int i = k; i < rows_; ++i) other[i] -= factor * column[i];
      }
    }
    return smallest_pivot_ > kSingular;
  }
  // x <- S^-1 x
  void solve_dense(double* x) const {
    for (int j = 0; j < rows_; ++j) {
      const double* const column = S_ + kMostRows * j;
      x[j] *= pivot_inverse_[j];
      for (int i = j + 1; i < rows_; ++i) x[i] -= x[j] * column[i];
    }
    for (int j = rows_ - 1; j >= 0; --j) {
      const double* const column = S_ + kMostRows * j;
      double sum = x[j];
      for (int i = j + 1; i < rows_; ++i) sum -= column[i] * x[i];
      x[j] = sum * pivot_inverse_[j];
    }
  }

  bool invert_block() {
    Mat3 S3 = Mat3::Identity();
    for (int j = 0; j < rows_; ++j)
      for (int i = 0; i < rows_; ++i) S3(i, j) = S(i, j);
    const Vec3 a = S3.col(1).cross(S3.col(2));
    const double volume = S3.col(0).dot(a);
    const double size = S3(0, 0) * S3(1, 1) * S3(2, 2);
    if (!(volume > kSingular * size)) return false;
    smallest_pivot_ = volume / size;
    inverse_ << a.transpose(), S3.col(2).cross(S3.col(0)).transpose(), S3.col(0).cross(S3.col(1)).transpose();
    inverse_ /= volume;
    return true;
  }

  const System& system_;
  const ReferencePoints points_;
  std::vector<Inertia> bodies_;
  std::vector<PartRows> parts_;
  std::vector<Sided> sides_;
  int rows_ = 0;
  double S_[kMostRows * kMostRows];  // by columns
  Mat3 inverse_;                     // S^-1 of a single part
  double pivot_inverse_[kMostRows];
  double smallest_pivot_ = 1;  // relative to its diagonal entry of S
};

}  // namespace lieeuler
