// The saddle-point system of few constraint rows by its Schur complement, made for many right-hand sides.
//
//   S = G M^-1 G^T,   lam = S^-1 (G M^-1 f + gamma),   udot = M^-1 (f - G^T lam)
//
// Where a light body carries a heavy one, S is the sum of a large and a small matrix and keeps few digits of the small
// one; near a singular position of a loop it loses as many as its pivots. What is left of G udot + gamma is then solved
// for once more, which restores them.
//
// Of loops whose rows depend on each other S is singular: as many pivots as there are independent rows are taken, the
// largest first, and the multipliers of the other rows are zero. The choice stays while the pivots are good. Off the
// constraints, at the stages of a step, it decides what the accelerations are: there it stays in any case.
// Bodies pinned to the ground have no translation: M is their inertia about the pin, and the pin has no multiplier.
#pragma once

#include <Eigen/Core>
#include <numeric>

#include "model/reference_points.hpp"
#include "solve/world_rows.hpp"

namespace lieeuler {

class SmallSchur : public WorldRows {
 public:
  // Of trees, bodies move about the points that hang on the ground (model/reference_points.hpp).
  explicit SmallSchur(const Plan& plan) : WorldRows(plan), system_(plan.system), points_(plan, plan.forest) {
    for (int b = 0; b < system_.n(); ++b) bodies_.push_back({1 / system_.bodies[b].mass, points_.inertia(b).inverse()});
    for (int k = 0; k < plan.count(); ++k) {
      if (points_.holds(plan.parts[k])) continue;
      const Part& part = plan.part(k);
      const int joint = plan.parts[k].joint;
      for (Side side : kSides)
        if (const int body = plan.body(k, side); body != system_.n())
          sides_.push_back({&part, joint, side, body, rows_, part.rows(), {}, {}});
      parts_.push_back({k, joint, &part, rows_});
      rows_ += part.rows();
    }
    rank_ = rows_;
    S_.resize(rows_ * rows_), L_.resize(rows_ * rows_);
    all_rows_.resize(plan.count()), twists_.resize(system_.n() + 1);
  }

  // Finds how many rows depend on others, and expects as many from then on. False where the system is singular.
  bool find_redundancy(const Constraints& joints) {
    int redundant;
    count_redundancy(joints, redundant);
    rank_ = rows_ - redundant;
    smallest_at_choice_ = std::numeric_limits<double>::infinity();
    return factor(joints, true);
  }
  bool count_redundancy(const Constraints& joints, int& redundant) {
    assemble(joints);
    redundant = parts() < 2 ? 0 : rows_ - eliminate(rows_, kDependent, true);
    return true;
  }
  int redundant() const { return rows_ - rank_; }
  // Over its entry of S: near a singular position it goes to zero, as the square of the distance.
  double smallest_pivot() const { return smallest_pivot_; }

  // False where the rows have become dependent. on_constraints: other rows may be chosen.
  bool factor(const Constraints& joints, bool on_constraints) {
    factored_ = &joints;
    assemble(joints);
    if (parts() == 1) return invert_block();
    if (eliminate(rank_, kSingular, false) == rank_ &&
        !(on_constraints && smallest_pivot_ < kWorse * smallest_at_choice_))
      return true;
    if (eliminate(rank_, kSingular, true) < rank_) return false;
    smallest_at_choice_ = smallest_pivot_;
    return true;
  }

  // M y + G^T lam = f, G y = rows: takes f and the rows of each part, leaves y and lam in their places. to_rounding:
  // what redundant rows cost in digits matters. Inlined: series call it for every order.
  [[gnu::always_inline]] void solve(std::vector<Twist>& f, std::vector<Vec3>& rows, bool to_rounding) {
    for (size_t b = 0; b < bodies_.size(); ++b) {
      f[b].v *= bodies_[b].mass_inverse;
      f[b].w = times(bodies_[b].inertia_inverse, f[b].w);
    }
    correct(f, rows, to_rounding);
  }
  // The same from velocities without multipliers, y = M^-1 f.
  [[gnu::always_inline]] void correct(std::vector<Twist>& y, std::vector<Vec3>& rows, bool to_rounding) {
    if (parts() == 1) solve_single(y, rows[parts_[0].index]);
    if (parts() > 1) solve_rows(y, rows, to_rounding);
  }

  // The least-norm multipliers that act as these do.
  void make_least_norm(const Constraints& joints, std::vector<double>& lam) {
    if (redundant() == 0 || !factor(joints, true)) return;
    std::vector<std::vector<double>> null;
    for (int k = rank_; k < rows_; ++k) {
      std::vector<double> w = without_effect(k);
      for (int pass = 0; pass < 2; ++pass)  // Gram and Schmidt, twice is enough
        for (const std::vector<double>& other : null) subtract_component(other, w);
      const double length = std::sqrt(std::inner_product(w.begin(), w.end(), w.begin(), 0.0));
      for (double& value : w) value /= length;
      subtract_component(w, lam);
      null.push_back(std::move(w));
    }
  }

 private:
  static constexpr int kMostRows = Plan::kMostSmallRows;
  static constexpr double kSingular = 1e-13;   // what rounding leaves of a pivot
  static constexpr double kDependent = 1e-11;  // pivots go as squares of singular values of G
  static constexpr double kWorse = 0.25;       // of the smallest pivot: other rows are chosen then
  static constexpr double kGraded = 1e-3;      // of its entry: a pivot below it has lost three digits
  struct Inertia {
    double mass_inverse;
    Mat3 inertia_inverse;
  };
  struct PartRows {
    int index, joint;
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
  double& S(int i, int j) { return S_[j * rows_ + i]; }
  double* L(int j) { return &L_[j * rows_]; }

  void assemble(const Constraints& joints) {
    std::fill(S_.begin(), S_.end(), 0.0);
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
    for (int j = 0; j < rows_; ++j)
      for (int i = j + 1; i < rows_; ++i) S(j, i) = S(i, j);
  }

  // S = L L^T with the rows in `order_`; where they are to be chosen, the one most of whose entry is left comes next.
  // Stops after `most` pivots, or where the next is below `tolerance` of its entry. Returns the number of pivots; the
  // other rows follow in L.
  int eliminate(int most, double tolerance, bool choose) {
    if (choose) std::iota(order_, order_ + rows_, 0);
    for (int i = 0; i < rows_; ++i) left_[i] = 1, entry_inverse_[i] = 1 / S(i, i);
    smallest_pivot_ = 1;
    for (int j = 0; j < most; ++j) {
      const int next = choose ? static_cast<int>(std::max_element(left_ + j, left_ + rows_) - left_) : j;
      if (!(left_[next] > tolerance)) return j;
      smallest_pivot_ = std::min(smallest_pivot_, left_[next]);
      if (next != j) {
        std::swap(order_[j], order_[next]), std::swap(left_[j], left_[next]);
        for (int k = 0; k < j; ++k) std::swap(L(k)[j], L(k)[next]);
      }
      double* const column = L(j);
      const double* const given = &S_[order_[j] * rows_];
      for (int i = j; i < rows_; ++i) column[i] = given[order_[i]];
      for (int k = 0; k < j; ++k) {
        const double* const other = L(k);
        const double factor = other[j];
        for (int i = j; i < rows_; ++i) column[i] -= factor * other[i];
      }
      pivot_inverse_[j] = 1 / std::sqrt(column[j]);
      for (int i = j + 1; i < rows_; ++i) {
        column[i] *= pivot_inverse_[j];
        left_[i] -= column[i] * column[i] * entry_inverse_[order_[i]];
      }
    }
    return most;
  }
  // x <- L^-T x, of the rows with pivots
  void substitute_back(double* x) const {
    using Column = Eigen::Map<const Eigen::VectorXd>;
    for (int j = rank_ - 1; j >= 0; --j) {
      const int below = rank_ - j - 1;
      const double sum = Column(&L_[j * rows_ + j + 1], below).dot(Column(x + j + 1, below));
      x[j] = (x[j] - sum) * pivot_inverse_[j];
    }
  }

  // r = G y - rows
  void put_rates(const std::vector<Vec3>& rows, const std::vector<Twist>& y, double* r) const {
    for (const PartRows& part : parts_)
      for (int i = 0; i < part.part->rows(); ++i) r[part.row + i] = -rows[part.index][i];
    for (const Sided& side : sides_) {
      Vec3 rate = side.G.w * y[side.body].w;
      if (!points_.pinned(side.body)) rate += side.G.v * y[side.body].v;
      for (int i = 0; i < side.rows; ++i) r[side.row + i] += rate[i];
    }
  }
  // lam = S^-1 r,  y -= M^-1 G^T lam
  void subtract_response(const double* r, double* lam, std::vector<Twist>& y) {
    double x[kMostRows];
    for (int i = 0; i < rank_; ++i) x[i] = r[order_[i]];
    for (int j = 0; j < rank_; ++j) {
      const double* const column = L(j);
      x[j] *= pivot_inverse_[j];
      for (int i = j + 1; i < rank_; ++i) x[i] -= x[j] * column[i];
    }
    substitute_back(x);
    for (int i = 0; i < rows_; ++i) lam[order_[i]] = i < rank_ ? x[i] : 0;
    for (const Sided& side : sides_) {
      Vec3 own = Vec3::Zero();
      for (int i = 0; i < side.rows; ++i) own[i] = lam[side.row + i];
      y[side.body].w -= side.H.w * own;
      if (!points_.pinned(side.body)) y[side.body].v -= side.H.v * own;
    }
  }

  // solve() from y without multipliers. Not inlined: series of pinned bodies would save the registers that this needs.
  [[gnu::noinline]] void solve_rows(std::vector<Twist>& y, std::vector<Vec3>& rows, bool to_rounding) {
    double r[kMostRows], lam[kMostRows];
    put_rates(rows, y, r);
    subtract_response(r, lam, y);
    if (smallest_pivot_ < kGraded || (to_rounding && redundant() > 0)) {
      double more[kMostRows];
      put_rates(rows, y, r);
      subtract_response(r, more, y);
      for (int i = 0; i < rows_; ++i) lam[i] += more[i];
    }
    for (const PartRows& part : parts_) {
      Vec3& out = rows[part.index];
      out.setZero();
      for (int i = 0; i < part.part->rows(); ++i) out[i] = lam[part.row + i];
    }
  }
  // The same of a single part, three rows whatever it has.
  [[gnu::noinline]] void solve_single(std::vector<Twist>& y, Vec3& rows) {
    Vec3 lam = Vec3::Zero();
    for (int pass = 0; pass < (smallest_pivot_ < kGraded ? 2 : 1); ++pass) {
      Vec3 r = -rows;
      for (const Sided& side : sides_) {
        r += side.G.w * y[side.body].w;
        if (!points_.pinned(side.body)) r += side.G.v * y[side.body].v;
      }
      const Vec3 more = inverse_ * r;
      for (const Sided& side : sides_) {
        y[side.body].w -= side.H.w * more;
        if (!points_.pinned(side.body)) y[side.body].v -= side.H.v * more;
      }
      lam += more;
    }
    rows = lam;
  }

  // Multipliers of all rows, as in lam, that do nothing: one of the k-th row, and those of rows with pivots.
  std::vector<double> without_effect(int k) {
    double x[kMostRows];
    for (int j = 0; j < rank_; ++j) x[j] = -L(j)[k];
    substitute_back(x);
    for (int j = rank_; j < rows_; ++j) x[j] = j == k ? 1 : 0;
    std::vector<double> places(rows_), w(rows_);
    for (int i = 0; i < rows_; ++i) places[order_[i]] = x[i];
    for (const PartRows& part : parts_) std::copy_n(&places[part.row], part.part->rows(), &w[part.part->row]);
    // What rounding leaves of G^T w, M y + G^T m = G^T w with G y = 0, belongs to m: w <- w - m.
    std::fill(twists_.begin(), twists_.end(), Twist{});
    for (const PartRows& part : parts_) {
      const Joint& joint = system_.joints[part.joint];
      Vec3 own = Vec3::Zero();
      std::copy_n(&places[part.row], part.part->rows(), own.data());
      (*factored_)[part.joint].subtract_reaction(*part.part, -own, twists_[joint.parent], twists_[joint.child]);
    }
    std::fill(all_rows_.begin(), all_rows_.end(), Vec3::Zero());
    solve(twists_, all_rows_, true);
    for (const PartRows& part : parts_)
      for (int i = 0; i < part.part->rows(); ++i) w[part.part->row + i] -= all_rows_[part.index][i];
    return w;
  }
  static void subtract_component(const std::vector<double>& w, std::vector<double>& values) {
    const double product = std::inner_product(w.begin(), w.end(), values.begin(), 0.0);
    for (size_t i = 0; i < w.size(); ++i) values[i] -= product * w[i];
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
  int rows_ = 0, rank_ = 0;
  std::vector<double> S_, L_;  // by columns
  Mat3 inverse_;               // S^-1 of a single part
  int order_[kMostRows];
  double left_[kMostRows], entry_inverse_[kMostRows], pivot_inverse_[kMostRows];
  double smallest_pivot_ = 1, smallest_at_choice_ = std::numeric_limits<double>::infinity();  // over the entry of S
  const Constraints* factored_ = nullptr;
  std::vector<Vec3> all_rows_;
  std::vector<Twist> twists_;
};

}  // namespace lieeuler
