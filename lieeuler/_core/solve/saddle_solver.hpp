// The saddle-point system of every method at one configuration,
//
//   M y + G^T lam = f,   G y = rows
//
// by the elimination that the plan of the system names. Each of these supplies
//
//   bool find_redundancy(joints), count_redundancy(joints, int&); int redundant(); double smallest_pivot()
//   bool factor(joints, on_constraints)
//   void solve(f, rows, to_rounding)      f becomes y, rows become lam, in the axes of the elimination's own rows
//   void correct(y, rows, to_rounding)    the same from y = M^-1 f
//   Vec3 own(k, rows), in_world(k, lam)   between its rows of part k and those of the joint
//   Vec3 gamma(k, joints, u)              of its rows
#pragma once

#include <variant>

#include "solve/small_schur.hpp"
#include "solve/sparse_saddle.hpp"
#include "solve/tree_schur.hpp"

namespace lieeuler {

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

  // Finds how many rows depend on others, and expects as many from then on. False where the rest is singular.
  bool find_redundancy(const Constraints& joints) {
    return each([&](auto& by) { return by.find_redundancy(joints); });
  }
  // Counts them anew.
  bool count_redundancy(const Constraints& joints, int& redundant) {
    return each([&](auto& by) { return by.count_redundancy(joints, redundant); });
  }
  int redundant() const {
    return std::visit([](const auto& by) { return by.redundant(); }, by_);
  }
  // Of the joints that close loops: near a singular position it goes to zero, as the square of the distance.
  double smallest_pivot() {
    return each([](auto& by) { return by.smallest_pivot(); });
  }

  // False where the rows have become dependent. on_constraints: other rows may be chosen.
  bool factor(const Constraints& joints, bool on_constraints = true) {
    return each([&](auto& by) { return by.factor(joints, on_constraints); });
  }

  // At the joints factored last: takes f and the rows of each part, leaves y and lam in their places. to_rounding: what
  // redundant rows cost in digits matters. Inlined: series call it for every order.
  [[gnu::always_inline]] void solve(std::vector<Twist>& f, std::vector<Vec3>& rows, bool to_rounding) {
    if (auto* small = std::get_if<SmallSchur>(&by_)) return small->solve(f, rows, to_rounding);
    std::get<SparseSaddle>(by_).solve(f, rows, to_rounding);
  }

  // The least displacement that closes the joints to first order: M d + G^T mu = 0, G d = -Phi.
  void displace(const Constraints& joints, std::vector<Twist>& d) {
    std::fill(d.begin(), d.end(), Twist{});
    each([&](auto& by) {
      for (int k = 0; k < plan_.count(); ++k) rows_[k] = by.own(k, -at(joints, k).position(plan_.part(k)));
      for (int k : plan_.rotors) rows_[k].setZero();
      by.correct(d, rows_, false);  // repeated: what this leaves is rounding of a small displacement
    });
  }
  // u <- u - M^-1 G^T mu with G u + dPhi/dt = 0
  void project(const Constraints& joints, std::vector<Twist>& u) {
    put_drift(joints);
    for (int k : plan_.rotors) rows_[k][0] = rotor_rate(joints, k, u);
    each([&](auto& by) { by.correct(u, rows_, true); });
  }
  // From the momentum p, with the bodies' spin: u = M^-1 (p - G^T mu) with G u + dPhi/dt = 0; -G^T mu is added to
  // `change`, which may be p. rates: of the rotors by their own momenta, which change by mu.
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
    for (int k = 0; k < plan_.count(); ++k)
      at(joints, k).subtract_reaction(plan_.part(k), rows_[k], change[plan_.body(k, kParent)],
                                      change[plan_.body(k, kChild)]);
  }
  // (a, lam) of the index-1 system: M a + G^T lam = f, G a + gamma = 0.
  void accelerate(const Constraints& joints, State& state) {
    generalized_forces(system_, state.frames, state.u, state.angles, state.a);
    each([&](auto& by) {
      for (int k = 0; k < plan_.count(); ++k) rows_[k] = -by.gamma(k, joints, state.u);
      by.solve(state.a, rows_, true);
      put_multipliers(by, state.lam.data());
    });
    state.a[system_.n()] = Twist{};
  }

  // Of the rotor that is the part k, at velocities u.
  double rotor_rate(const Constraints& joints, int k, const std::vector<Twist>& u) const {
    return at(joints, k).velocity(plan_.part(k), u[plan_.body(k, kParent)], u[plan_.body(k, kChild)])[0];
  }

  // The least-norm multipliers that act as these do.
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
  const JointState& at(const Constraints& joints, int k) const { return joints[plan_.parts[k].joint]; }

  // -dPhi/dt, zero but for driven rows.
  void put_drift(const Constraints& joints) {
    std::fill(rows_.begin(), rows_.end(), Vec3::Zero());
    for (int k : driven_) rows_[k] = -at(joints, k).drift(plan_.part(k));
  }
  // Out of rows_, in the order of lam.
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
