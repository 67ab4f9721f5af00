// The saddle-point system [M G^T; G 0] at one configuration: projection of velocities and index-1 accelerations.
#pragma once

#include <optional>

#include "model/scales.hpp"
#include "solve/delassus.hpp"
#include "solve/dense_saddle.hpp"
#include "solve/independent_rows.hpp"

namespace lieeuler {

class SaddlePoint {
 public:
  // independent: without the rows of loops that depend on others.
  explicit SaddlePoint(const System& system, bool independent = false)
      : system_(system),
        delassus_(std::in_place, system, independent),
        graded_(system.graded()),
        thin_(system.thin() || DenseSaddle::fits(system)),
        rows_(3 * delassus_->parts(), 0.0),
        force_(system.n() + 1) {
    if (independent) independent_.emplace(system);
    if (DenseSaddle::fits(system)) dense_.emplace(system);
    for (int k = 0; k < delassus_->parts(); ++k)
      if (delassus_->part(k).drive) driven_.push_back(k);
  }

  Delassus& delassus() { return *delassus_; }

  // Counts the redundant rows at this configuration. False where the rest is singular.
  bool count_redundancy(const Constraints& joints, int& redundant) {
    if (independent_) {
      redundant = independent_->choose(joints, dropped_);
      return true;
    }
    if (dense_) {
      redundant = dense_->redundancy(joints);
      dense_->scale(joints);
      return true;
    }
    constexpr double kTolerance = 1e-11;  // of pivots of order one, which go as squares of singular values of G
    delassus_->assemble(joints);
    return delassus_->lu().find_deficiency(kTolerance, redundant);
  }
  // 1 / sqrt of the diagonal of G M^-1 G^T, three values a part: with it constraint rows are of order one in any units.
  std::vector<double> row_scales(const Constraints& joints) const {
    std::vector<double> scales(3 * delassus_->parts(), 1.0);
    for (int k = 0; k < delassus_->parts(); ++k) {
      const auto [j, p] = delassus_->index(k);
      Vec3 mobility = Vec3::Zero();
      for (Side side : kSides) {
        const int b = side == kChild ? system_.joints[j].child : system_.joints[j].parent;
        if (b == system_.n()) continue;
        const Body& body = system_.bodies[b];
        const Rows G = joints[j].jacobian(delassus_->part(k), side);
        mobility += (G.v * G.v.transpose() / body.mass + G.w * body.inertia_inverse * G.w.transpose()).diagonal();
      }
      for (int r = 0; r < delassus_->part(k).rows(); ++r) scales[3 * k + r] = 1 / std::sqrt(mobility[r]);
    }
    return scales;
  }

  // Counts the redundant rows, and expects as many from then on.
  bool find_redundancy(const Constraints& joints) {
    int redundant;
    if (independent_) {
      scales_ = row_scales(joints);
      redundant_ = independent_->choose(joints, dropped_);
      if (take_choice(joints) && regular()) return true;
      independent_.reset();  // rows depend on more than one loop at once
      delassus_.emplace(system_);
    }
    std::vector<double> scales = row_scales(joints);
    scales.resize(delassus_->unknowns(), 1.0);
    delassus_->lu().scale_tail(scales);
    if (!count_redundancy(joints, redundant)) return false;
    delassus_->lu().expect_deficiency(redundant);
    redundant_ = redundant;
    null_.assign(redundant, std::vector<double>(delassus_->unknowns(), 0.0));
    return true;
  }
  int redundant() const { return redundant_; }
  // Places in lam of the rows left out, where there are any.
  const std::vector<char>* dropped() const { return independent_ ? &dropped_ : nullptr; }
  // Near a singular position of a loop it goes to zero, as the square of the distance.
  double smallest_pivot() { return delassus_->lu().smallest_tail_pivot(); }

  bool factor(const Constraints& joints) {
    factored_ = &joints;
    delassus_->assemble(joints);
    const bool regular = delassus_->lu().factor();
    if (independent_) {
      if (regular && delassus_->largest_inverse(scales_) < kWorse * inverse_at_choice_) return true;
      return independent_->choose(joints, dropped_) == redundant_ && take_choice(joints);
    }
    solves_dense_ = dense_ && dense_->factor(joints, redundant_);
    if (!regular && !solves_dense_) return false;
    find_null_space(joints);
    return true;
  }
  // Counts the choices of independent rows.
  int choice() const { return choice_; }

  // Takes the multiplier directions without effect, G^T w = 0, out of three values a part: of residuals, where they are
  // the rows' own contradiction, and of multipliers, which become those of least norm.
  void remove_null_space(double* values) const {
    for (const std::vector<double>& w : null_) subtract_component(w, values);
  }

  // The least-norm part of multipliers in the order of lam.
  void make_least_norm(std::vector<double>& lam) const {
    for (const std::vector<double>& w : null_) {
      double product = 0;
      for_rows([&](int row, int place) { product += w[place] * lam[row]; });
      for_rows([&](int row, int place) { lam[row] -= product * w[place]; });
    }
  }

  // Takes from the momentum p what violates the velocity constraints: p <- p - G^T mu and u = M^-1 p with
  // G u = 0, p with the bodies' spin.
  void project(const Constraints& joints, std::vector<Twist>& p, std::vector<Twist>& u, double* mu) {
    project(joints, p, u, mu, p);
  }
  // The same with -G^T mu added to `change` in place of p.
  void project(const Constraints& joints, const std::vector<Twist>& p, std::vector<Twist>& u, double* mu,
               std::vector<Twist>& change) {
    for (int b = 0; b < system_.n(); ++b) force_[b] = {p[b].v, p[b].w - system_.bodies[b].spin};
    std::fill(rows_.begin(), rows_.end(), 0.0);
    for (int k : driven_) store(Vec3(-joints[delassus_->index(k).joint].drift(delassus_->part(k))), &rows_[3 * k]);
    solve(joints, u, mu);
    subtract_reactions(joints, rows_, change);
  }

  // The least displacement that closes the joints to first order: M d + G^T mu = 0, G d = -Phi.
  void displace(const Constraints& joints, std::vector<Twist>& d) {
    std::fill(force_.begin(), force_.end(), Twist{});
    for (int k = 0; k < delassus_->parts(); ++k)
      store(Vec3(-joints[delassus_->index(k).joint].position(delassus_->part(k))), &rows_[3 * k]);
    solve(joints, d, nullptr);
  }

  // M y + G^T lam = f, G y = rows, at the joints factored last: takes f and the rows of each part, leaves y and lam in
  // their places. to_rounding: what redundant rows cost in digits matters.
  void solve(std::vector<Twist>& f, std::vector<Vec3>& rows, bool to_rounding) {
    for (int k = 0; k < delassus_->parts(); ++k) store(rows[k], &rows_[3 * k]);
    solve_in_place(*factored_, f, graded_ || thin_ || (to_rounding && redundant_ > 0));
    for (int k = 0; k < delassus_->parts(); ++k) rows[k] = load3(&rows_[3 * k]);
  }

  // (a, lam) of the index-1 system: M a + G^T lam = f, G a + gamma = 0.
  void accelerate(const Constraints& joints, State& state) {
    generalized_forces(system_, state.frames, state.u, state.angles, force_);
    for (int k = 0; k < delassus_->parts(); ++k) {
      const Joint& joint = system_.joints[delassus_->index(k).joint];
      store(Vec3(-joints[delassus_->index(k).joint].gamma(delassus_->part(k), state.u[joint.parent],
                                                          state.u[joint.child])),
            &rows_[3 * k]);
    }
    solve(joints, state.a, state.lam.data());
  }

 private:
  static constexpr double kWorse = 4;         // of the inverted pivots: other rows are chosen then
  static constexpr double kDependent = 1e10;  // inverse of an eigenvalue that is rounding
  static constexpr int kMostPasses = 8;       // of refinement: each gains a digit or more where moments span eight
  static constexpr double kSlow = 0.3;        // a correction not smaller than this much of the last is rounding

  bool take_choice(const Constraints& joints) {
    ++choice_;
    delassus_->drop(dropped_);
    delassus_->assemble(joints);
    if (!delassus_->lu().factor()) return false;
    inverse_at_choice_ = delassus_->largest_inverse(scales_);
    return true;
  }
  // Whether the rows chosen loop by loop are independent all together: a few steps of inverse iteration.
  bool regular() {
    std::vector<double> x(rows_.size());
    for (size_t i = 0; i < x.size(); ++i) x[i] = std::sin(1.0 + static_cast<double>(i));
    for (int pass = 0; pass < 4; ++pass) {
      double square = 0;
      for (double value : x) square += value * value;
      for (size_t i = 0; i < x.size(); ++i) x[i] /= std::sqrt(square) * scales_[i];
      delassus_->solve_rows(x.data(), flat(force_));
      square = 0;
      for (size_t i = 0; i < x.size(); ++i) x[i] /= scales_[i], square += x[i] * x[i];
      if (!(square < kDependent * kDependent)) return false;
    }
    return true;
  }
  // M y + G^T m = force_, G y = rows_; rows_ becomes m, in three values a part.
  void solve(const Constraints& joints, std::vector<Twist>& y, double* multipliers) {
    solve_in_place(joints, force_, redundant_ > 0 || graded_ || thin_);
    std::copy_n(force_.begin(), system_.n(), y.begin());
    if (multipliers) for_rows([&](int row, int place) { multipliers[row] = rows_[place]; });
  }
  // The same with the forces in y, which become y. again: what rounding has left is solved for once more;
  // near-dependent rows and graded masses lose digits of the rows in the first pass, thin bodies of the balance of
  // forces too.
  void solve_in_place(const Constraints& joints, std::vector<Twist>& y, bool again) {
    if (again) wanted_ = rows_;
    if (thin_) forces_ = y;
    solve_once(y);
    double last = std::numeric_limits<double>::infinity();
    for (int pass = 0; again && pass < (thin_ ? kMostPasses : 1); ++pass) {
      const double change = refine(joints, y);
      if (!(change < kSlow * last)) break;
      last = change;
    }
  }
  void solve_once(std::vector<Twist>& y) {
    solve_all(y, [this](double* values) { remove_null_space(values); });
  }
  // As Delassus::solve().
  template <class Adjust>
  void solve_all(std::vector<Twist>& y, Adjust adjust) {
    if (!solves_dense_) return delassus_->solve(flat(y), rows_.data(), adjust);
    adjust(rows_.data());
    dense_->solve(flat(y), rows_.data());
    adjust(rows_.data());
  }
  // Adds the correction of the residual of the whole system to y and rows_; returns its largest rate.
  double refine(const Constraints& joints, std::vector<Twist>& y) {
    y[system_.n()] = Twist{};
    first_ = rows_, correction_.assign(system_.n() + 1, Twist{});
    if (thin_) {
      for (int b = 0; b < system_.n(); ++b) {
        const Twist inertial = momentum(system_.bodies[b], y[b]);
        correction_[b] = {forces_[b].v - inertial.v, forces_[b].w - inertial.w};
      }
      subtract_reactions(joints, rows_, correction_);
    }
    for (int k = 0; k < delassus_->parts(); ++k) {
      const Joint& joint = system_.joints[delassus_->index(k).joint];
      const Vec3 rate = joints[delassus_->index(k).joint].velocity(delassus_->part(k), y[joint.parent], y[joint.child]);
      store(Vec3(load3(&wanted_[3 * k]) - rate), &rows_[3 * k]);
    }
    solve_once(correction_);
    const Scales scales{system_.length};
    double change = 0;
    for (int b = 0; b < system_.n(); ++b) {
      y[b].v += correction_[b].v, y[b].w += correction_[b].w;
      change = std::max(change, scales.rate_of(correction_[b]));
    }
    for (size_t i = 0; i < rows_.size(); ++i) rows_[i] += first_[i];
    return change;
  }
  // target -= G^T values
  void subtract_reactions(const Constraints& joints, const std::vector<double>& values,
                          std::vector<Twist>& target) const {
    for (int k = 0; k < delassus_->parts(); ++k) {
      const int j = delassus_->index(k).joint;
      joints[j].subtract_reaction(delassus_->part(k), load3(&values[3 * k]), target[system_.joints[j].parent],
                                  target[system_.joints[j].child]);
    }
  }

  // Orthonormal vectors of multipliers w with G^T w = 0.
  void find_null_space(const Constraints& joints) {
    for (int k = 0; k < static_cast<int>(null_.size()); ++k) {
      std::vector<double>& w = null_[k];
      if (solves_dense_)
        dense_->null_vector(k, w.data());
      else
        delassus_->lu().null_vector(k, w.data());
      std::fill(w.begin() + static_cast<long>(rows_.size()), w.end(), 0.0);  // null vectors have no part in the bodies
      cleanse(joints, w);
      for (int pass = 0; pass < 2; ++pass)  // Gram and Schmidt, twice is enough
        for (int i = 0; i < k; ++i) subtract_component(null_[i], w.data());
      double square = 0;
      for (double value : w) square += value * value;
      for (double& value : w) value /= std::sqrt(square);
    }
  }
  // What G^T w is not zero by, M y + G^T m = G^T w with G y = 0, belongs to m: w <- w - m.
  void cleanse(const Constraints& joints, std::vector<double>& w) {
    std::fill(force_.begin(), force_.end(), Twist{});
    subtract_reactions(joints, w, force_);
    for (Twist& force : force_) force.v = -force.v, force.w = -force.w;
    std::fill(rows_.begin(), rows_.end(), 0.0);
    solve_all(force_, [](double*) {});
    for (size_t i = 0; i < rows_.size(); ++i) w[i] -= rows_[i];
  }
  void subtract_component(const std::vector<double>& w, double* values) const {
    double product = 0;
    for (size_t i = 0; i < rows_.size(); ++i) product += w[i] * values[i];
    for (size_t i = 0; i < rows_.size(); ++i) values[i] -= product * w[i];
  }
  // Calls visit(row in lam, place among three values a part) for every constraint row.
  template <class Visit>
  void for_rows(Visit visit) const {
    for (int k = 0; k < delassus_->parts(); ++k)
      for (int r = 0; r < delassus_->part(k).rows(); ++r) visit(delassus_->part(k).row + r, 3 * k + r);
  }

  const System& system_;
  std::optional<Delassus> delassus_;
  const bool graded_, thin_;
  std::optional<IndependentRows> independent_;
  std::optional<DenseSaddle> dense_;
  bool solves_dense_ = false;  // at the joints factored last
  std::vector<char> dropped_;
  std::vector<int> driven_;     // parts with a drive
  std::vector<double> scales_;  // of rows_, where rows are chosen
  double inverse_at_choice_ = 0;
  int redundant_ = 0, choice_ = 0;
  const Constraints* factored_ = nullptr;
  std::vector<double> rows_;            // right-hand side, then multipliers, three values a part
  std::vector<double> wanted_, first_;  // of a second pass
  std::vector<Twist> force_, forces_, correction_;
  std::vector<std::vector<double>> null_;  // orthonormal vectors w with G^T w = 0, three values a part
};

}  // namespace lieeuler
