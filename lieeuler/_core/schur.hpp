// The saddle point of a tree with its bodies eliminated beforehand: S mu = G y - c, S = G M^-1 G^T, one block of S per
// pair of parts on a body. M is constant, and the rows of a spherical joint taken in the axes of its child make that
// body's share of S constant too: for small systems this is several times cheaper than the whole matrix.
#pragma once

#include "kinematics.hpp"

namespace lieeuler {

class SchurComplement {
 public:
  // Without loops no row can be redundant; a body with many parts would fill S.
  static bool fits(const System& system) {
    constexpr int kMostParts = 6;
    std::vector<int> parts(system.n() + 1, 0);
    for (const Joint& joint : system.joints)
      for (int body : {joint.parent, joint.child}) parts[body] += static_cast<int>(joint.parts.size());
    parts[system.n()] = 0;
    return elimination_order(system).loops.empty() && *std::max_element(parts.begin(), parts.end()) <= kMostParts;
  }

  explicit SchurComplement(const System& system) : system_(system), force_(system.n() + 1) {
    std::vector<std::vector<int>> parts_of(system.joints.size()), ends_on(system.n());
    for (int j = 0; j < static_cast<int>(system.joints.size()); ++j)
      for (int p = 0; p < static_cast<int>(system.joints[j].parts.size()); ++p) {
        parts_of[j].push_back(parts());
        parts_.push_back({j, p});
      }
    for (int k = 0; k < parts(); ++k)
      for (Side side : kSides) add_end(k, side, ends_on);
    std::vector<int> order;
    for (int item : elimination_order(system).tree)
      if (item >= system.n()) order.insert(order.end(), parts_of[item - system.n()].begin(), parts_of[item - system.n()].end());
    std::set<BlockLU::Entry> entries;
    for (const std::vector<int>& ends : ends_on)
      for (int a : ends)
        for (int b : ends)
          if (a != b) entries.insert({ends_[a].part, ends_[b].part});
    lu_.plan(order, 0, entries);
    rows_.assign(lu_.unknowns(), 0.0);
    for (int k = 0; k < parts(); ++k) diagonal_.push_back(lu_.block(k, k));
    for (const std::vector<int>& ends : ends_on)
      for (int a : ends)
        for (int b : ends)
          if (a < b) pairs_.push_back({a, b, lu_.block(ends_[a].part, ends_[b].part), lu_.block(ends_[b].part, ends_[a].part)});
  }

  bool find_redundancy(const Constraints& joints) { return factor(joints); }
  bool count_redundancy(const Constraints&, int& redundant) {
    redundant = 0;
    return true;
  }
  int redundant() const { return 0; }
  double smallest_pivot() const { return 1; }

  bool factor(const Constraints& joints) {
    assemble(joints);
    return lu_.factor();
  }

  // M d + G^T mu = 0, G d = -Phi
  void displace(const Constraints& joints, std::vector<Twist>& d) {
    for (int b = 0; b < system_.n(); ++b) d[b] = Twist{};
    for (int k = 0; k < parts(); ++k) store(in_axes(k, joint_of(k, joints).position(part(k))), &rows_[3 * k]);
    finish(d);
  }
  // u <- u - M^-1 G^T mu with G u = 0
  void project(std::vector<Twist>& u) {
    std::fill(rows_.begin(), rows_.end(), 0.0);
    finish(u);
  }
  // (a, lam) of the index-1 system.
  void accelerate(const Constraints& joints, State& state) {
    generalized_forces(system_, state.frames, state.u, state.angles, force_);
    for (int b = 0; b < system_.n(); ++b) state.a[b] = velocity(system_.bodies[b], force_[b]);
    for (int k = 0; k < parts(); ++k) {
      const Joint& joint = system_.joints[parts_[k].joint];
      store(in_axes(k, joint_of(k, joints).gamma(part(k), state.u[joint.parent], state.u[joint.child])), &rows_[3 * k]);
    }
    finish(state.a);
    for (int k = 0; k < parts(); ++k) {
      Vec3 lam = load3(&rows_[3 * k]);
      if (part(k).spherical) lam = *axes_[k] * lam;
      std::copy_n(lam.data(), part(k).rows(), state.lam.data() + part(k).row);
    }
  }

 private:
  // One side of a part: its rows V, W against (v, w) of the body, and W J^-1.
  struct End {
    int part, body;
    Side side;
    double inverse_mass;
    Mat3 V, W, N;
  };
  struct Pair {
    int a, b;
    double *ab, *ba;
  };

  int parts() const { return static_cast<int>(parts_.size()); }
  const Part& part(int k) const { return system_.joints[parts_[k].joint].parts[parts_[k].part]; }
  const JointState& joint_of(int k, const Constraints& joints) const { return joints[parts_[k].joint]; }
  Vec3 in_axes(int k, const Vec3& rows) const { return part(k).spherical ? Vec3(axes_[k]->transpose() * rows) : rows; }

  void add_end(int k, Side side, std::vector<std::vector<int>>& ends_on) {
    const Joint& joint = system_.joints[parts_[k].joint];
    const int b = side == kChild ? joint.child : joint.parent;
    Mat3 own = Mat3::Zero();
    if (b != system_.n()) {
      End end{k, b, side, 1 / system_.bodies[b].mass, Mat3::Zero(), Mat3::Zero(), Mat3::Zero()};
      if (part(k).spherical && side == kChild) {
        end.W = -hat(joint.child_anchor);
        end.N = end.W * system_.bodies[b].inertia_inverse;
        own = end.inverse_mass * Mat3::Identity() + end.N * end.W.transpose();
      }
      ends_on[b].push_back(static_cast<int>(ends_.size()));
      ends_.push_back(end);
    }
    if (side == kChild) constant_.push_back(own), axes_.push_back(nullptr);
  }

  void assemble(const Constraints& joints) {
    lu_.set_zero();
    for (int k = 0; k < parts(); ++k) {
      axes_[k] = &joint_of(k, joints).attitude(kChild);
      put(diagonal_[k], constant_[k]);
      for (int r = part(k).rows(); r < 3; ++r) diagonal_[k][(kRow + 1) * r] = 1;
    }
    for (End& end : ends_) {
      const JointState& joint = joint_of(end.part, joints);
      const Mat3& J_inverse = system_.bodies[end.body].inertia_inverse;
      if (part(end.part).spherical) {
        const Mat3& axes = *axes_[end.part];
        if (end.side == kChild) {
          end.V = axes.transpose();
          continue;
        }
        end.V = -axes.transpose();
        end.W.noalias() = axes.transpose() * (joint.attitude(kParent) * hat(joint.anchor(kParent)));
        end.N.noalias() = end.W * J_inverse;
        Mat3 share = end.N * end.W.transpose();
        share.diagonal().array() += end.inverse_mass;
        add(diagonal_[end.part], share);
        continue;
      }
      const Rows G = joint.jacobian(part(end.part), end.side);
      end.V = G.v, end.W = G.w;
      end.N.noalias() = end.W * J_inverse;
      add(diagonal_[end.part], end.inverse_mass * end.V * end.V.transpose() + end.N * end.W.transpose());
    }
    for (const Pair& pair : pairs_) {
      const End &a = ends_[pair.a], &b = ends_[pair.b];
      const Mat3 block = a.inverse_mass * a.V * b.V.transpose() + a.N * b.W.transpose();
      add(pair.ab, block), add(pair.ba, block.transpose());
    }
  }

  // From y and the rows -c: mu of S mu = G y - c, and y <- y - M^-1 G^T mu.
  void finish(std::vector<Twist>& y) {
    for (const End& end : ends_) {
      const Twist& t = y[end.body];
      store(Vec3(load3(&rows_[3 * end.part]) + end.V * t.v + end.W * t.w), &rows_[3 * end.part]);
    }
    lu_.solve(rows_.data());
    for (const End& end : ends_) {
      Twist& t = y[end.body];
      const Vec3 mu = load3(&rows_[3 * end.part]);
      t.v -= end.inverse_mass * (end.V.transpose() * mu);
      t.w -= end.N.transpose() * mu;
    }
  }

  const System& system_;
  std::vector<PartIndex> parts_;
  std::vector<End> ends_;
  std::vector<Mat3> constant_;      // what the child adds to its spherical part's diagonal block
  std::vector<const Mat3*> axes_;   // attitude of each part's child, the axes of spherical rows
  std::vector<double*> diagonal_;
  std::vector<Pair> pairs_;
  std::vector<double> rows_;
  std::vector<Twist> force_;
  BlockLU lu_;
};

}  // namespace lieeuler
