// The saddle point of a tree with its bodies eliminated beforehand (docs/theory.md, section 10): S mu = G y - c,
// S = G M^-1 G^T, with one block of S per pair of parts on a body. M is constant. The rows of a spherical joint are
// written in the axes of its child, which makes that body's part of S constant too. For small systems this is several
// times cheaper than the whole matrix.
#pragma once

#include "solve/world_rows.hpp"

namespace lieeuler {

class TreeSchur : public FullRank {
 public:
  // One side of a part, with its rows V, W against (v, w) of the body, and N = W J^-1.
  //   spherical, child    V = R^T, W = -hat(s): W and N are constant
  //   spherical, parent   V = -R^T, W = T hat(s), T = R^T R_parent
  //   dots                from the joint
  enum class Kind { child_point, parent_point, dots };
  struct End {
    Kind kind;
    int part, body;
    Side side;
    double inverse_mass;
    bool whole;  // whether a point needs V, W and N as matrices
    Vec3 s;
    Mat3 V = Mat3::Zero(), W = V, N = V;
    Mat3 own = V;  // child_point: its block of S; parent_point: that block without T
  };
  // The two blocks of S for two ends on one body. chain: share * T^T, for a child_point and a parent_point.
  struct Pair {
    int a, b;
    double *ab, *ba;
    bool chain;
    Mat3 share;
  };

  explicit TreeSchur(const Plan& plan) : plan_(plan), system_(plan.system) {
    std::vector<std::vector<int>> ends_on(system_.n());
    for (int k = 0; k < plan.count(); ++k)
      for (Side side : kSides) add_end(k, side, ends_on);
    lu_.follow(plan.blocks({Pattern::Matrix::tree}, [&] { return eliminate_parts(ends_on); }));
    for (int k = 0; k < plan.count(); ++k)
      diagonal_.push_back(lu_.block(k, k)), axes_.push_back(nullptr), turns_.push_back(Mat3::Zero());
    for (const std::vector<int>& ends : ends_on)
      for (int a : ends)
        for (int b : ends)
          if (a < b) add_pair(a, b);
  }

  bool find_redundancy(const Constraints& joints) { return factor(joints, true); }
  double smallest_pivot() const { return 1; }

  const std::vector<End>& ends() const { return ends_; }
  const std::vector<Pair>& pairs() const { return pairs_; }
  const BlockPlan& elimination() const { return lu_.plan(); }

  bool factor(const Constraints& joints, bool) {
    assemble(joints);
    return lu_.factor();
  }

  // Turn rows into the axes of S, and multipliers back: the axes of the child for a spherical part.
  Vec3 own(int k, const Vec3& rows) const { return plan_.part(k).spherical ? transposed_times(*axes_[k], rows) : rows; }
  Vec3 in_world(int k, const Vec3& lam) const { return plan_.part(k).spherical ? times(*axes_[k], lam) : lam; }
  Vec3 gamma(int k, const Constraints& joints, const std::vector<Twist>& u) const {
    const Joint& joint = plan_.joint(k);
    const Vec3 &w = u[joint.child].w, &w_parent = u[joint.parent].w;
    if (!plan_.part(k).spherical) return joints.gamma(plan_.parts[k], u);
    const Vec3 at_child = w.cross(w.cross(joint.child_anchor));
    if (joint.parent == system_.n()) return at_child;
    return at_child - times(turns_[k], w_parent.cross(w_parent.cross(joint.parent_anchor)));
  }

  // Solve from forces, and from velocities without multipliers.
  void solve(std::vector<Twist>& f, std::vector<Vec3>& rows, bool) {
    for (int b = 0; b < system_.n(); ++b) f[b] = velocity(system_.bodies[b], f[b]);
    correct(f, rows);
  }
  [[gnu::flatten]] void correct(std::vector<Twist>& y, std::vector<Vec3>& rows, bool = false) {
    for (const End& end : ends_) {
      const Twist& t = y[end.body];
      Vec3& sum = rows[end.part];
      switch (end.kind) {
        case Kind::child_point:
          sum -= transposed_times(*axes_[end.part], t.v) - end.s.cross(t.w);
          break;
        case Kind::parent_point:
          sum -= times(turns_[end.part], end.s.cross(t.w)) - transposed_times(*axes_[end.part], t.v);
          break;
        case Kind::dots:
          sum -= times(end.V, t.v) + times(end.W, t.w);
          break;
      }
    }
    lu_.solve(rows.data()->data());
    for (const End& end : ends_) {
      Twist& t = y[end.body];
      const Mat3& J_inverse = system_.bodies[end.body].inertia_inverse;
      const Vec3& mu = rows[end.part];
      switch (end.kind) {
        case Kind::child_point:
          t.v -= end.inverse_mass * times(*axes_[end.part], mu);
          t.w -= times(J_inverse, end.s.cross(mu));
          break;
        case Kind::parent_point:
          t.v += end.inverse_mass * times(*axes_[end.part], mu);
          t.w += times(J_inverse, end.s.cross(transposed_times(turns_[end.part], mu)));
          break;
        case Kind::dots:
          t.v -= end.inverse_mass * transposed_times(end.V, mu);
          t.w -= transposed_times(end.N, mu);
          break;
      }
    }
  }

 private:
  BlockPlan eliminate_parts(const std::vector<std::vector<int>>& ends_on) const {
    const auto append = [](const std::vector<int>& parts, std::vector<int>& nodes) {
      nodes.insert(nodes.end(), parts.begin(), parts.end());
    };
    const auto [order, loops] = plan_.arrange([](int, std::vector<int>&) {}, append);
    std::set<BlockPlan::Entry> entries;
    for (const std::vector<int>& ends : ends_on)
      for (int a : ends)
        for (int b : ends)
          if (a != b) entries.insert({ends_[a].part, ends_[b].part});
    return BlockPlan(order, loops, entries);  // no loops
  }
  void add_end(int k, Side side, std::vector<std::vector<int>>& ends_on) {
    const Joint& joint = plan_.joint(k);
    const int b = plan_.body(k, side);
    if (b == system_.n()) return;
    const Kind kind = !plan_.part(k).spherical ? Kind::dots : (side == kChild ? Kind::child_point : Kind::parent_point);
    End end{kind,
            k,
            b,
            side,
            1 / system_.bodies[b].mass,
            false,
            kind == Kind::parent_point ? joint.parent_anchor : joint.child_anchor};
    if (kind != Kind::dots) {
      end.W = -hat(end.s);
      end.N = end.W * system_.bodies[b].inertia_inverse;
      end.own = -end.inverse_mass * Mat3::Identity() - end.N * end.W.transpose();
    }
    ends_on[b].push_back(static_cast<int>(ends_.size()));
    ends_.push_back(end);
  }
  void add_pair(int a, int b) {
    if (ends_[a].kind == Kind::parent_point) std::swap(a, b);
    End &first = ends_[a], &second = ends_[b];
    Pair pair{a, b, lu_.block(first.part, second.part), lu_.block(second.part, first.part), false, Mat3::Zero()};
    if (first.kind == Kind::child_point && second.kind == Kind::parent_point) {
      pair.chain = true;
      pair.share = first.inverse_mass * Mat3::Identity() + first.N * hat(second.s);
    } else {
      first.whole = second.whole = true;
    }
    pairs_.push_back(pair);
  }

  void assemble(const Constraints& joints) {
    lu_.set_zero();
    for (int k = 0; k < plan_.count(); ++k) {
      axes_[k] = &joints[plan_.parts[k]].attitude(kChild);
      for (int r = plan_.part(k).rows(); r < 3; ++r) diagonal_[k][(kColumn + 1) * r] = 1;
    }
    for (End& end : ends_) update(end, joints[plan_.parts[end.part]]);
    for (const Pair& pair : pairs_) {
      const End &a = ends_[pair.a], &b = ends_[pair.b];
      Mat3 block;
      if (pair.chain) {
        block.noalias() = pair.share * turns_[b.part].transpose();
      } else {
        block.noalias() = -a.inverse_mass * a.V * b.V.transpose();
        block.noalias() -= a.N * b.W.transpose();
      }
      add(pair.ab, block), add(pair.ba, block.transpose());
    }
  }
  // The rows of an end, and its diagonal block.
  void update(End& end, const JointState& joint) {
    double* const diagonal = diagonal_[end.part];
    if (end.kind == Kind::child_point) {
      if (end.whole) end.V = axes_[end.part]->transpose();
      return add(diagonal, end.own);
    }
    if (end.kind == Kind::parent_point) {
      Mat3& turn = turns_[end.part];
      turn.noalias() = axes_[end.part]->transpose() * joint.attitude(kParent);
      Mat3 half, block;
      half.noalias() = turn * end.own;
      block.noalias() = half * turn.transpose();
      add(diagonal, block);
      if (!end.whole) return;
      end.V = -axes_[end.part]->transpose();
      end.W.noalias() = turn * hat(end.s);
    } else {
      const Rows G = joint.jacobian(plan_.part(end.part), end.side);
      end.V = G.v, end.W = G.w;
    }
    end.N.noalias() = end.W * system_.bodies[end.body].inertia_inverse;
    if (end.kind == Kind::dots)
      add(diagonal, -end.inverse_mass * end.V * end.V.transpose() - end.N * end.W.transpose());
  }

  const Plan& plan_;
  const System& system_;
  std::vector<End> ends_;
  std::vector<const Mat3*> axes_;  // attitude of each part's child, the axes of spherical rows
  std::vector<Mat3> turns_;        // attitude of its parent relative to its child
  std::vector<double*> diagonal_;
  std::vector<Pair> pairs_;
  BlockLU lu_;  // of -S
};

}  // namespace lieeuler
