// The saddle-point system of every method at one configuration,
//
//   M y + G^T lam = f,   G y = rows
//
// by the elimination that the plan of the system chooses. Each elimination supplies
//
//   bool find_redundancy(joints), count_redundancy(joints, int&); int redundant(); double smallest_pivot()
//   bool factor(joints, on_constraints)
//   void solve(f, rows, to_rounding)      f becomes y, rows become lam, in the axes of the elimination's rows
//   void correct(y, rows, to_rounding)    the same from y = M^-1 f
//   Vec3 own(k, rows), in_world(k, lam)   convert between its rows of part k and those of the joint
//   Vec3 gamma(k, joints, u)              gamma of its rows
#pragma once

#include <variant>

#include "solve/small_schur.hpp"
#include "solve/sparse_saddle.hpp"
#include "solve/tree_schur.hpp"

namespace lieeuler {

// A method that fails with a scaled pivot below this is within about 1e-3 of a singular position.
inline constexpr double kNearlySingular = 1e-6;

class SaddleSolver {
  template <class Use>
  auto each(const Use& use) {
    return std::visit(use, by_);
  }

 public:
  SaddleSolver(const Plan& plan, Elimination by)
      : plan_(plan), system_(plan.system), by_(make(plan, by)), force_(system_.n() + 1), rows_(plan.count()) {
    for (int k = 0; k < plan.count(); ++k)
      if (plan.part(k).drive) driven_.push_back(k);
  }

  // Counts the rows that depend on others and expects that number from then on. False if the rest is singular.
  bool find_redundancy(const Constraints& joints) {
    return each([&](auto& by) { return by.find_redundancy(joints); });
  }
  // Counts them again, without expecting the new number.
  bool count_redundancy(const Constraints& joints, int& redundant) {
    return each([&](auto& by) { return by.count_redundancy(joints, redundant); });
  }
  int redundant() const {
    return std::visit([](const auto& by) { return by.redundant(); }, by_);
  }
  // That of the joints that close loops: near a singular position it is proportional to the square of the distance.
  double smallest_pivot() {
    return each([](auto& by) { return by.smallest_pivot(); });
  }

  // False if rows have become dependent. on_constraints: other independent rows may be chosen here.
  bool factor(const Constraints& joints, bool on_constraints = true) {
    return each([&](auto& by) { return by.factor(joints, on_constraints); });
  }

  // Solves at the joints factored last; y and lam replace f and the rows of each part. to_rounding: recover the digits
  // that redundant rows lose. Inlined, because series call it for every order.
  [[gnu::always_inline]] void solve(std::vector<Twist>& f, std::vector<Vec3>& rows, bool to_rounding) {
    if (auto* small = std::get_if<SmallSchur>(&by_)) return small->solve(f, rows, to_rounding);
    std::get<SparseSaddle>(by_).solve(f, rows, to_rounding);
  }

  // The least displacement that closes the joints to first order: M d + G^T mu = 0, G d = -Phi. angles: of forces.
  void displace(const Constraints& joints, const std::vector<double>& angles, std::vector<Twist>& d) {
    std::fill(d.begin(), d.end(), Twist{});
    each([&](auto& by) {
      for (int k = 0; k < plan_.count(); ++k) rows_[k] = by.own(k, -joints[plan_.parts[k]].position(plan_.part(k)));
      for (int k : plan_.rotors) rows_[k].setZero();
      combine(plan_, rows_.data()->data());
      for (const PlacedMimic& mimic : plan_.mimics) rows_[mimic.follower][0] = -gap(plan_, mimic, joints, angles);
      by.correct(d, rows_, false);  // the caller iterates, so the lost digits do not matter
    });
  }
  // u <- u - M^-1 G^T mu with G u + dPhi/dt = 0
  void project(const Constraints& joints, std::vector<Twist>& u) {
    put_drift(joints);
    for (int k : plan_.rotors) rows_[k][0] = joints.velocity(plan_.parts[k], u)[0];
    each([&](auto& by) { by.correct(u, rows_, true); });
  }
  // From the momentum p, spins included: u = M^-1 (p - G^T mu) with G u + dPhi/dt = 0. Adds -G^T mu to `change`, which
  // may be p. `rates` are those of the rotors from their momenta, which change by mu.
  void project(const Constraints& joints, const std::vector<Twist>& p, std::vector<Twist>& u, double* mu,
               std::vector<Twist>& change, const std::vector<double>& rates) {
    for (int b = 0; b < system_.n(); ++b) force_[b] = {p[b].v, p[b].w - system_.bodies[b].spin};
    put_drift(joints);
    for (size_t i = 0; i < rates.size(); ++i) rows_[plan_.rotors[i]][0] = rates[i];
    each([&](auto& by) {
      by.solve(force_, rows_, true);
      put_multipliers(by, mu);
    });
    std::copy_n(force_.begin(), system_.n(), u.begin());
    for (int k = 0; k < plan_.count(); ++k) joints.subtract_reaction(plan_.parts[k], rows_[k], change);
  }
  // (a, lam) of the index-1 system: M a + G^T lam = f, G a + gamma = 0.
  void accelerate(const Constraints& joints, State& state) {
    generalized_forces(system_, state.frames, state.u, state.angles, state.a);
    each([&](auto& by) {
      for (int k = 0; k < plan_.count(); ++k) rows_[k] = -by.gamma(k, joints, state.u);
      combine(plan_, rows_.data()->data());
      by.solve(state.a, rows_, true);
      put_multipliers(by, state.lam.data());
    });
    state.a[system_.n()] = Twist{};
  }

  // Replaces the multipliers by those of least norm with the same effect.
  void make_least_norm(const Constraints& joints, std::vector<double>& lam) {
    if (auto* sparse = std::get_if<SparseSaddle>(&by_)) sparse->make_least_norm(joints, lam);
  }

  // The elimination of a step, whose rows Newton's matrix shares.
  SparseSaddle& sparse() { return std::get<SparseSaddle>(by_); }
  const SparseSaddle& sparse() const { return std::get<SparseSaddle>(by_); }

 private:
  using Any = std::variant<TreeSchur, SmallSchur, SparseSaddle>;
  static Any make(const Plan& plan, Elimination by) {
    if (by == Elimination::tree) return Any(std::in_place_type<TreeSchur>, plan);
    if (by == Elimination::small) return Any(std::in_place_type<SmallSchur>, plan);
    return Any(std::in_place_type<SparseSaddle>, plan, by == Elimination::independent);
  }

  // rows_ = -dPhi/dt, which is zero except for driven rows.
  void put_drift(const Constraints& joints) {
    std::fill(rows_.begin(), rows_.end(), Vec3::Zero());
    for (int k : driven_) rows_[k] = -joints[plan_.parts[k]].drift(plan_.part(k));
  }
  // Copies multipliers from rows_, in the order of lam.
  template <class By>
  void put_multipliers(const By& by, double* lam) const {
    for (int k = 0; k < plan_.count(); ++k) {
      const Vec3 own = by.in_world(k, rows_[k]);
      const Part& part = plan_.part(k);
      for (int r = 0; r < part.rows(); ++r) lam[part.row + r] = own[r];
    }
  }

  const Plan& plan_;
  const System& system_;
  Any by_;
  std::vector<int> driven_;  // parts with a drive
  std::vector<Twist> force_;
  std::vector<Vec3> rows_;  // of each part: right-hand sides, then multipliers
};

}  // namespace lieeuler
