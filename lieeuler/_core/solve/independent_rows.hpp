// Independent constraint rows of joints that close loops, chosen loop by loop, and the least-norm multipliers (8.2) of
// docs/theory.md of all rows.
//
// All of it is a function of the rows' Jacobian alone. What was found where a run starts is kept in the plan and taken
// wherever the Jacobian has the same bits.
#pragma once

#include <Eigen/Dense>
#include <cstring>

#include "model/joints.hpp"
#include "model/plan.hpp"

namespace lieeuler {

class IndependentRows {
 public:
  explicit IndependentRows(const Plan& plan) : plan_(plan), system_(plan.system) {
    for (const Body& body : system_.bodies) roots_.push_back(Mat3(body.inertia_inverse.llt().matrixL()).transpose());
  }

  // Marks the rows to drop at this configuration, by their places in lam, and returns their number.
  int choose(const Constraints& joints, std::vector<char>& dropped, bool at_start = false) const {
    dropped.assign(system_.rows() + plan_.rotors.size(), 0);
    for (size_t k = 0; k < plan_.loops.size(); ++k) {
      const Found found = find(k, joints, at_start);
      for (int row : found->dropped) dropped[row] = 1;
      if (at_start) plan_.keep(k, found);
    }
    return static_cast<int>(std::count(dropped.begin(), dropped.end(), 1));
  }

  // Replaces the multipliers by those of least norm with the same effect.
  void make_least_norm(const Constraints& joints, std::vector<double>& lam) const {
    std::vector<Sparse> null;
    for (size_t k = 0; k < plan_.loops.size(); ++k) {
      const Found found = find(k, joints, true);
      null.insert(null.end(), found->null.begin(), found->null.end());
    }
    const Eigen::Index count = static_cast<Eigen::Index>(null.size());
    Eigen::VectorXd wanted(count), y = Eigen::VectorXd::Zero(count);
    for (Eigen::Index i = 0; i < count; ++i) wanted[i] = product(null[i], lam);
    // Conjugate gradients for N^T N, which is well conditioned as long as loops share few joints.
    Eigen::VectorXd r = wanted, p = r;
    std::vector<double> spread(lam.size());
    const double small = 1e-32 * wanted.squaredNorm();
    double square = r.squaredNorm();
    for (Eigen::Index k = 0; k < 4 * count && square > small; ++k) {
      std::fill(spread.begin(), spread.end(), 0.0);
      for (Eigen::Index i = 0; i < count; ++i) add(p[i], null[i], spread);
      Eigen::VectorXd q(count);
      for (Eigen::Index i = 0; i < count; ++i) q[i] = product(null[i], spread);
      const double step = square / p.dot(q);
      y += step * p, r -= step * q;
      const double last = std::exchange(square, r.squaredNorm());
      p = r + square / last * p;
    }
    for (Eigen::Index i = 0; i < count; ++i) add(-y[i], null[i], lam);
  }

 private:
  // If less than this part of a row's length is independent of the others, it is rounding or a singular position.
  static constexpr double kDependent = 3e-6;
  using Sparse = LoopChoice::Sparse;
  using Found = std::shared_ptr<const LoopChoice>;

  static double product(const Sparse& n, const std::vector<double>& values) {
    double sum = 0;
    for (const auto& [row, value] : n) sum += value * values[row];
    return sum;
  }
  static void add(double factor, const Sparse& n, std::vector<double>& values) {
    for (const auto& [row, value] : n) values[row] += factor * value;
  }

  Found find(size_t k, const Constraints& joints, bool with_null) const {
    std::vector<double> jacobian = jacobian_of(plan_.loops[k], joints);
    if (Found kept = plan_.choice(k);
        kept && std::memcmp(kept->jacobian.data(), jacobian.data(), jacobian.size() * sizeof(double)) == 0)
      return kept;
    LoopChoice found = choose_in(plan_.loops[k], joints, with_null);
    found.jacobian = std::move(jacobian);
    return std::make_shared<const LoopChoice>(std::move(found));
  }
  std::vector<double> jacobian_of(const Loop& loop, const Constraints& joints) const {
    std::vector<double> values;
    for (int j : loop)
      for (const Part& part : system_.joints[j].constraints())
        for (Side side : kSides) {
          const Rows G = joints[j].jacobian(part, side);
          for (const auto* rows : {&G.v, &G.w}) values.insert(values.end(), rows->data(), rows->data() + 9);
        }
    return values;
  }
  LoopChoice choose_in(const Loop& loop, const Constraints& joints, bool with_null) const {
    LoopChoice choice;
    std::vector<int> bodies, rows;
    for (int j : loop)
      for (int body : {system_.joints[j].parent, system_.joints[j].child})
        if (body != system_.n() && std::find(bodies.begin(), bodies.end(), body) == bodies.end())
          bodies.push_back(body);
    Eigen::Index known = 0;  // rows before those of the joint that closes the loop
    for (int j : loop) {
      known = static_cast<Eigen::Index>(rows.size());
      for (const Part& part : system_.joints[j].constraints())
        for (int r = 0; r < part.rows(); ++r) rows.push_back(part.row + r);
    }
    // Columns: rows of G over the roots of the masses and inertias, scaled to length one.
    Eigen::MatrixXd A =
        Eigen::MatrixXd::Zero(6 * static_cast<Eigen::Index>(bodies.size()), static_cast<Eigen::Index>(rows.size()));
    Eigen::Index column = 0;
    for (int j : loop) column = fill(A, column, bodies, j, joints);
    const Eigen::VectorXd lengths = A.colwise().norm();
    A = A * lengths.cwiseInverse().asDiagonal();
    Eigen::MatrixXd basis(A.rows(), A.cols()), rest = A;
    Eigen::MatrixXd triangle = Eigen::MatrixXd::Zero(A.cols(), A.cols());  // the rows kept by the basis
    std::vector<Eigen::Index> kept, open;
    Eigen::Index rank = 0;
    const auto accept = [&](Eigen::Index c) {  // Gram and Schmidt, twice is enough
      for (int pass = 0; pass < 2; ++pass)
        rest.col(c) -= basis.leftCols(rank) * (basis.leftCols(rank).transpose() * rest.col(c));
      const double length = rest.col(c).norm();
      if (!(length > kDependent)) return false;
      triangle.col(rank).head(rank) = basis.leftCols(rank).transpose() * A.col(c);
      triangle(rank, rank) = length;
      basis.col(rank++) = rest.col(c) / length;
      kept.push_back(c);
      return true;
    };
    for (Eigen::Index c = 0; c < known; ++c) accept(c);
    auto closing = rest.rightCols(A.cols() - known);
    closing -= basis.leftCols(rank) * (basis.leftCols(rank).transpose() * closing);
    for (Eigen::Index c = known; c < A.cols(); ++c) open.push_back(c);
    while (!open.empty()) {  // always accept the row that is farthest from the span of the others
      const auto furthest = std::max_element(open.begin(), open.end(), [&](Eigen::Index a, Eigen::Index b) {
        return rest.col(a).squaredNorm() < rest.col(b).squaredNorm();
      });
      if (!accept(*furthest)) break;
      closing -= basis.col(rank - 1) * (basis.col(rank - 1).transpose() * closing);
      open.erase(furthest);
    }
    for (Eigen::Index c : open) choice.dropped.push_back(rows[c]);
    if (open.empty() || !with_null) return choice;
    for (Eigen::Index c : open) {
      Eigen::VectorXd weights = basis.leftCols(rank).transpose() * A.col(c);
      triangle.topLeftCorner(rank, rank).triangularView<Eigen::Upper>().solveInPlace(weights);
      Sparse found{{rows[c], 1.0}};
      for (size_t k = 0; k < kept.size(); ++k)
        found.push_back({rows[kept[k]], -weights[static_cast<Eigen::Index>(k)] * lengths[c] / lengths[kept[k]]});
      choice.null.push_back(std::move(found));
    }
    return choice;
  }
  Eigen::Index fill(Eigen::MatrixXd& A, Eigen::Index column, const std::vector<int>& bodies, int j,
                    const Constraints& joints) const {
    const Joint& joint = system_.joints[j];
    for (const Part& part : joint.constraints()) {
      for (Side side : kSides) {
        const int body = side == kChild ? joint.child : joint.parent;
        if (body == system_.n()) continue;
        const Eigen::Index at = 6 * (std::find(bodies.begin(), bodies.end(), body) - bodies.begin());
        const Rows G = joints[j].jacobian(part, side);
        for (int r = 0; r < part.rows(); ++r) {
          A.block<3, 1>(at, column + r) = G.v.row(r).transpose() / std::sqrt(system_.bodies[body].mass);
          A.block<3, 1>(at + 3, column + r) = roots_[body] * G.w.row(r).transpose();
        }
      }
      column += part.rows();
    }
    return column;
  }

  const Plan& plan_;
  const System& system_;
  std::vector<Mat3> roots_;  // R with R^T R = J^-1
};

}  // namespace lieeuler
