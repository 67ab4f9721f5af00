// Configurations, constraints and the index-1 system: what all methods share.
#pragma once

#include "forces.hpp"
#include "nodes.hpp"

namespace lieeuler {

// A point of the trajectory. frames, u and a have one entry more than bodies: the ground, at rest.
struct State {
  std::vector<Frame> frames;
  std::vector<Twist> u, a;
  std::vector<double> lam;
  std::vector<double> angles;  // of the torsional springs, one place per force

  explicit State(const System& system)
      : frames(system.n() + 1), u(system.n() + 1), a(system.n() + 1), lam(system.rows(), 0.0),
        angles(system.forces.size(), 0.0) {}
};

EIGEN_ALWAYS_INLINE Vec3 load3(const double* at) { return {at[0], at[1], at[2]}; }
EIGEN_ALWAYS_INLINE Twist load(const double* at) { return {load3(at), load3(at + 3)}; }
EIGEN_ALWAYS_INLINE void store(const Vec3& value, double* at) { at[0] = value[0], at[1] = value[1], at[2] = value[2]; }
EIGEN_ALWAYS_INLINE void store(const Twist& twist, double* at) { store(twist.v, at), store(twist.w, at + 3); }

// All joints at one configuration.
class Constraints {
 public:
  explicit Constraints(const System& system) : system_(&system), states_(system.joints.size()) {}

  void update(const std::vector<Frame>& frames) {
    for (size_t j = 0; j < states_.size(); ++j) states_[j].update(system_->joints[j], frames);
  }
  const JointState& operator[](int joint) const { return states_[joint]; }

 private:
  const System* system_;
  std::vector<JointState> states_;
};

// The saddle-point system [M G^T; G 0] at one configuration: projection of velocities and index-1 accelerations.
class SaddlePoint {
 public:
  explicit SaddlePoint(const System& system) : system_(system), nodes_(system, false) {
    int tail;
    const std::vector<int> order = nodes_.order(system, tail);
    lu_.plan(order, tail, nodes_.entries(system, false));
    rhs_.assign(lu_.unknowns(), 0.0);
    force_.resize(system.n() + 1);
    for (int b = 0; b < system.n(); ++b)
      diagonals_.push_back({lu_.block(nodes_.v(b), nodes_.v(b)), lu_.block(nodes_.w(b), nodes_.w(b))});
    for (int k = 0; k < nodes_.parts(); ++k) {
      padding_.push_back(lu_.block(nodes_.lam(k), nodes_.lam(k)));
      for (Side side : kSides) {
        const int body = body_of(k, side);
        SideBlocks blocks;
        if (body != system.n())
          blocks = SideBlocks::of(lu_, nodes_.lam(k), nodes_.v(body), nodes_.w(body));
        blocks_.push_back(blocks);
      }
    }
  }

  // Counts the redundant rows at this configuration. False where the rest is singular.
  bool count_redundancy(const Constraints& joints, int& redundant) {
    constexpr double kTolerance = 1e-11;  // of pivots of order one, which go as squares of singular values of G
    assemble(joints);
    return lu_.find_deficiency(kTolerance, redundant);
  }
  // 1 / sqrt of the diagonal of G M^-1 G^T, by node: with it constraint rows are of order one in any units.
  std::vector<double> row_scales(const Constraints& joints, const Nodes& nodes) const {
    std::vector<double> scales(3 * nodes.count(), 1.0);
    for (int k = 0; k < nodes.parts(); ++k) {
      Vec3 mobility = Vec3::Zero();
      for (Side side : kSides) {
        if (body_of(k, side) == system_.n()) continue;
        const Body& body = system_.bodies[body_of(k, side)];
        const Rows G = joints[nodes.part(k).joint].jacobian(part_of(k), side);
        mobility += (G.v * G.v.transpose() / body.mass + G.w * body.inertia_inverse * G.w.transpose()).diagonal();
      }
      for (int r = 0; r < part_of(k).rows(); ++r)
        scales[3 * nodes.lam(k) + r] = scales[3 * nodes.mu(k) + r] = 1 / std::sqrt(mobility[r]);
    }
    return scales;
  }

  // Counts the redundant rows, and expects as many from then on.
  bool find_redundancy(const Constraints& joints) {
    int redundant;
    lu_.scale_tail(row_scales(joints, nodes_));
    if (!count_redundancy(joints, redundant)) return false;
    lu_.expect_deficiency(redundant);
    null_.assign(redundant, std::vector<double>(lu_.unknowns(), 0.0));
    return true;
  }
  int redundant() const { return static_cast<int>(null_.size()); }
  // Near a singular position of a loop it goes to zero, as the square of the distance.
  double smallest_pivot() { return lu_.smallest_tail_pivot(); }

  bool factor(const Constraints& joints) {
    assemble(joints);
    if (!lu_.factor()) return false;
    find_null_space(joints);
    return true;
  }

  // Takes the multiplier directions without effect, G^T w = 0, out of values laid out in nodes from `first` on: of
  // residuals, where they are the rows' own contradiction, and of multipliers, which become those of least norm.
  void remove_null_space(double* first) const {
    const int start = 3 * nodes_.lam(0), end = 3 * (nodes_.lam(0) + nodes_.parts());
    for (const std::vector<double>& w : null_) {
      double product = 0;
      for (int i = start; i < end; ++i) product += w[i] * first[i - start];
      for (int i = start; i < end; ++i) first[i - start] -= product * w[i];
    }
  }

  // The least-norm part of multipliers in the order of lam.
  void make_least_norm(std::vector<double>& lam) const {
    for (const std::vector<double>& w : null_) {
      double product = 0;
      for_rows([&](int row, int node) { product += w[node] * lam[row]; });
      for_rows([&](int row, int node) { lam[row] -= product * w[node]; });
    }
  }

  // Takes from the momentum p what violates the velocity constraints: p <- p - G^T mu and u = M^-1 p with G u = 0.
  void project(const Constraints& joints, std::vector<Twist>& p, std::vector<Twist>& u, double* mu) {
    for (int b = 0; b < system_.n(); ++b) store(p[b], rhs_.data() + 3 * nodes_.v(b));
    for (int k = 0; k < nodes_.parts(); ++k) store(Vec3(Vec3::Zero()), rhs_.data() + 3 * nodes_.lam(k));
    finish(u, mu);
    for (int k = 0; k < nodes_.parts(); ++k) {
      const Joint& joint = system_.joints[nodes_.part(k).joint];
      joints[nodes_.part(k).joint].subtract_reaction(part_of(k), load3(rhs_.data() + 3 * nodes_.lam(k)), p[joint.parent],
                                                     p[joint.child]);
    }
  }

  // The least displacement that closes the joints to first order: M d + G^T mu = 0, G d = -Phi.
  void displace(const Constraints& joints, std::vector<Twist>& d) {
    std::fill_n(rhs_.begin(), 3 * nodes_.lam(0), 0.0);
    for (int k = 0; k < nodes_.parts(); ++k)
      store(Vec3(-joints[nodes_.part(k).joint].position(part_of(k))), rhs_.data() + 3 * nodes_.lam(k));
    finish(d, nullptr);
  }

  // M y + G^T lam = f, G y = rows: takes f and the rows of each part, leaves y and lam in their places.
  void solve(std::vector<Twist>& f, std::vector<Vec3>& rows) {
    for (int b = 0; b < system_.n(); ++b) store(f[b], rhs_.data() + 3 * nodes_.v(b));
    for (int k = 0; k < nodes_.parts(); ++k) store(rows[k], rhs_.data() + 3 * nodes_.lam(k));
    solve_rhs();
    for (int b = 0; b < system_.n(); ++b) f[b] = load(rhs_.data() + 3 * nodes_.v(b));
    for (int k = 0; k < nodes_.parts(); ++k) rows[k] = load3(rhs_.data() + 3 * nodes_.lam(k));
  }

  // (a, lam) of the index-1 system: M a + G^T lam = f, G a + gamma = 0.
  void accelerate(const Constraints& joints, State& state) {
    generalized_forces(system_, state.frames, state.u, state.angles, force_);
    for (int b = 0; b < system_.n(); ++b) store(force_[b], rhs_.data() + 3 * nodes_.v(b));
    for (int k = 0; k < nodes_.parts(); ++k) {
      const auto [j, p] = nodes_.part(k);
      const Joint& joint = system_.joints[j];
      store(Vec3(-joints[j].gamma(joint.parts[p], state.u[joint.parent], state.u[joint.child])),
            rhs_.data() + 3 * nodes_.lam(k));
    }
    finish(state.a, state.lam.data());
  }

 private:
  void assemble(const Constraints& joints) {
    lu_.set_zero();
    for (int b = 0; b < system_.n(); ++b) {
      put_diagonal(diagonals_[b].first, system_.bodies[b].mass);
      put(diagonals_[b].second, system_.bodies[b].inertia);
    }
    for (int k = 0; k < nodes_.parts(); ++k) {
      const Part& part = part_of(k);
      for (int r = part.rows(); r < 3; ++r) padding_[k][(kRow + 1) * r] = 1;
      for (Side side : kSides) {
        const SideBlocks& blocks = blocks_[2 * k + side];
        if (!blocks.row_w) continue;  // the ground
        const Rows G = joints[nodes_.part(k).joint].jacobian(part, side);
        blocks.put_rows(G.v, G.w);
        blocks.put_columns(G);
      }
    }
  }

  // Orthonormal vectors of multipliers w with G^T w = 0.
  void find_null_space(const Constraints& joints) {
    for (int k = 0; k < redundant(); ++k) {
      lu_.null_vector(k, null_[k].data());
      std::fill_n(null_[k].begin(), 3 * nodes_.lam(0), 0.0);  // null vectors have no part in the bodies
      refine(joints, null_[k]);
      for (int pass = 0; pass < 2; ++pass)  // Gram and Schmidt, twice is enough
        for (int i = 0; i < k; ++i) {
          double product = 0;
          for (size_t j = 0; j < null_[k].size(); ++j) product += null_[i][j] * null_[k][j];
          for (size_t j = 0; j < null_[k].size(); ++j) null_[k][j] -= product * null_[i][j];
        }
      double square = 0;
      for (double value : null_[k]) square += value * value;
      for (double& value : null_[k]) value /= std::sqrt(square);
    }
  }
  // What G^T w is not zero by, M y + G^T m = G^T w with G y = 0, belongs to m: w <- w - m.
  void refine(const Constraints& joints, std::vector<double>& w) {
    std::fill(force_.begin(), force_.end(), Twist{});
    for (int k = 0; k < nodes_.parts(); ++k) {
      const Joint& joint = system_.joints[nodes_.part(k).joint];
      joints[nodes_.part(k).joint].subtract_reaction(part_of(k), -load3(&w[3 * nodes_.lam(k)]), force_[joint.parent],
                                                     force_[joint.child]);
    }
    std::fill(rhs_.begin(), rhs_.end(), 0.0);
    for (int b = 0; b < system_.n(); ++b) store(force_[b], rhs_.data() + 3 * nodes_.v(b));
    lu_.solve(rhs_.data());
    for (size_t i = 3 * nodes_.lam(0); i < w.size(); ++i) w[i] -= rhs_[i];
  }

  const Part& part_of(int k) const { return system_.joints[nodes_.part(k).joint].parts[nodes_.part(k).part]; }
  int body_of(int k, Side side) const {
    const Joint& joint = system_.joints[nodes_.part(k).joint];
    return side == kChild ? joint.child : joint.parent;
  }
  void solve_rhs() {
    double* const rows = rhs_.data() + 3 * nodes_.lam(0);
    remove_null_space(rows);
    lu_.solve(rhs_.data());
    remove_null_space(rows);
  }
  void finish(std::vector<Twist>& y, double* multipliers) {
    solve_rhs();
    for (int b = 0; b < system_.n(); ++b) y[b] = load(rhs_.data() + 3 * nodes_.v(b));
    if (multipliers) for_rows([&](int row, int node) { multipliers[row] = rhs_[node]; });
  }
  // Calls visit(row in lam, place among the unknowns) for every constraint row.
  template <class Visit>
  void for_rows(Visit visit) const {
    for (int k = 0; k < nodes_.parts(); ++k)
      for (int r = 0; r < part_of(k).rows(); ++r) visit(part_of(k).row + r, 3 * nodes_.lam(k) + r);
  }

  const System& system_;
  Nodes nodes_;
  BlockLU lu_;
  std::vector<double> rhs_;
  std::vector<std::vector<double>> null_;  // orthonormal vectors w with G^T w = 0, in nodes
  std::vector<Twist> force_;
  std::vector<std::pair<double*, double*>> diagonals_;
  std::vector<double*> padding_;
  std::vector<SideBlocks> blocks_;
};

// a = M^-1 (f - G^T lam) with the multipliers a method found itself.
inline void accelerations_from_multipliers(const System& system, const Constraints& joints, State& state) {
  generalized_forces(system, state.frames, state.u, state.angles, state.a);
  for (size_t j = 0; j < system.joints.size(); ++j) {
    const Joint& joint = system.joints[j];
    for (const Part& part : joint.parts) {
      Vec3 lam = Vec3::Zero();
      for (int r = 0; r < part.rows(); ++r) lam[r] = state.lam[part.row + r];
      joints[static_cast<int>(j)].subtract_reaction(part, lam, state.a[joint.parent], state.a[joint.child]);
    }
  }
  for (int b = 0; b < system.n(); ++b) state.a[b] = velocity(system.bodies[b], state.a[b]);
  state.a[system.n()] = Twist{};
}

}  // namespace lieeuler
