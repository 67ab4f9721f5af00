// The saddle point [M G^T; G 0] of a few bodies, factored with pivots from the whole matrix.
//
// Eliminating the bodies first (delassus.hpp) divides by masses and moments. If these span more than some six decades
// in directions that joints hold fast, refinement does not converge, however well the whole matrix is conditioned. The
// cost of this class is the cube of the matrix size; it serves only systems that no other elimination solves.
#pragma once

#include "linalg/full_pivot.hpp"
#include "model/joints.hpp"
#include "model/plan.hpp"

namespace lieeuler {

class DenseSaddle {
 public:
  explicit DenseSaddle(const Plan& plan)
      : plan_(plan), system_(plan.system), scales_(6 * system_.n() + system_.rows()), x_(scales_) {
    matrix_.resize(static_cast<int>(scales_.size()));
  }

  // Number of rows that depend on others, whatever the masses.
  int redundancy(const Constraints& joints) {
    constexpr double kDependent = 1e-11;  // pivots go as squares of singular values of G
    const int n = 6 * system_.n(), rows = system_.rows();
    std::fill(scales_.begin(), scales_.end(), 1.0);
    for (int i = 0; i < n; ++i)
      if (i % 6 > 2) scales_[i] = 1 / system_.length;
    assemble(joints);
    Eigen::MatrixXd G(rows, n);
    for (int i = 0; i < rows; ++i)
      for (int j = 0; j < n; ++j) G(i, j) = matrix_(n + i, j);
    G.rowwise().normalize();
    const Eigen::MatrixXd S = G * G.transpose();
    FullPivotLU independent;
    independent.resize(rows);
    for (int i = 0; i < rows; ++i)
      for (int j = 0; j < rows; ++j) independent(i, j) = S(i, j);
    return rows - independent.rank(kDependent);
  }

  // Computes the scales of rows and columns at this configuration.
  void scale(const Constraints& joints) {
    constexpr int kPasses = 6;  // each halves the decades that the largest entries of rows span
    const int count = matrix_.size();
    std::fill(scales_.begin(), scales_.end(), 1.0);
    for (int pass = 0; pass < kPasses; ++pass) {
      assemble(joints);
      for (int i = 0; i < count; ++i) {
        double largest = 0;
        for (int j = 0; j < count; ++j) largest = std::max(largest, std::abs(matrix_(i, j)));
        if (largest > 0) scales_[i] /= std::sqrt(largest);
      }
    }
  }

  // False if more than `redundant` rows depend on others, or a free motion has a mass that is rounding beside others.
  bool factor(const Constraints& joints, int redundant) {
    assemble(joints);
    return matrix_.factor(matrix_.size() - redundant);
  }

  // Solves M y + G^T lam = f, G y = rows. The six values of a body in `f` become y, the three of a part in `rows` lam.
  void solve(double* f, double* rows) {
    const int n = 6 * system_.n();
    std::copy_n(f, n, x_.begin());
    plan_.for_rows([&](int row, int place) { x_[n + row] = rows[place]; });
    for (size_t i = 0; i < x_.size(); ++i) x_[i] *= scales_[i];
    matrix_.solve(x_.data());
    for (size_t i = 0; i < x_.size(); ++i) x_[i] *= scales_[i];
    std::copy_n(x_.begin(), n, f);
    plan_.for_rows([&](int row, int place) { rows[place] = x_[n + row]; });
  }

  // The k-th vector of multipliers without effect, k < redundant; three values a part.
  void null_vector(int k, double* multipliers) {
    matrix_.null_vector(k, x_.data());
    const int n = 6 * system_.n();
    plan_.for_rows([&](int row, int place) { multipliers[place] = scales_[n + row] * x_[n + row]; });
  }

 private:
  void assemble(const Constraints& joints) {
    const int n = system_.n();
    matrix_.resize(matrix_.size());
    for (int b = 0; b < n; ++b)
      for (int i = 0; i < 3; ++i) {
        put(6 * b + i, 6 * b + i, system_.bodies[b].mass);
        for (int j = 0; j < 3; ++j) put(6 * b + 3 + i, 6 * b + 3 + j, system_.bodies[b].inertia(i, j));
      }
    for (const PlacedPart& placed : plan_.parts)
      for (Side side : kSides) {
        const int b = placed.bodies[side];
        if (b == n) continue;
        const Rows G = joints[placed].jacobian(*placed.part, side);
        for (int r = 0; r < placed.part->rows(); ++r)
          for (int i = 0; i < 3; ++i) {
            const int row = 6 * n + placed.part->row + r;
            put(row, 6 * b + i, G.v(r, i)), put(6 * b + i, row, G.v(r, i));
            put(row, 6 * b + 3 + i, G.w(r, i)), put(6 * b + 3 + i, row, G.w(r, i));
          }
      }
  }
  void put(int i, int j, double value) { matrix_(i, j) += scales_[i] * scales_[j] * value; }

  const Plan& plan_;
  const System& system_;
  FullPivotLU matrix_;
  std::vector<double> scales_, x_;
};

}  // namespace lieeuler
