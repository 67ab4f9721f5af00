// What the structure of a system determines, computed once for all its runs: the order of elimination, the loops, which
// elimination suits the system, and the symbolic factorizations.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>

#include "linalg/block_lu.hpp"
#include "model/graph.hpp"

namespace lieeuler {

// A mimic by its parts.
struct PlacedMimic : Mimic {
  int follower, leader;
};

// A matrix of 3 x 3 blocks: G M^-1 G^T, or the matrix of a step.
struct Pattern {
  enum class Matrix { mobility, step } matrix;
  bool first = false, second = false;  // independent rows; doubled unknowns, second derivatives
  auto operator<=>(const Pattern&) const = default;
};

// Which rows of the joint that closes a loop depend on the others at one configuration.
struct LoopChoice {
  using Sparse = std::vector<std::pair<int, double>>;  // row in lam, value
  std::vector<double> jacobian;                        // of the loop's rows there
  std::vector<int> dropped;                            // rows in lam
  std::vector<Sparse> null;                            // for every row dropped: multipliers without effect
};

class Plan {
 public:
  static constexpr int kMostSmallParts = 4;

  explicit Plan(System given)
      : system(std::move(given)),
        jumps(system.jumps()),
        parts(number_parts(system)),
        rotors(find_parts([](const Part& part) { return part.compliance > 0; })),
        slips(find_parts([](const Part& part) { return part.slips; })),
        mimics(find_mimics(system, parts)),
        order(elimination_order(system)),
        loops(find_loops(system, order)),
        hinges(system),
        forest(loops.empty()),
        graded(system.graded()),
        thin(system.thin()),
        whole(fits_whole()),
        independent(!forest && !whole && mimics.empty()),
        small(fits_small()) {}
  Plan(const Plan&) = delete;  // its members hold pointers into it

  const System system;
  const std::vector<double> jumps;  // times at which accelerations do
  const std::vector<PlacedPart> parts;
  const std::vector<int> rotors, slips;  // among the parts
  const std::vector<PlacedMimic> mimics;
  const EliminationOrder order;
  const std::vector<Loop> loops;
  const HingeTree hinges;
  const bool forest;  // joints close no loop
  const bool graded, thin;
  const bool whole;                      // masses or moments differ so much that only the whole matrix keeps its digits
  const bool independent;                // loops are solved with independent rows
  const bool small;                      // a tree of so few rows that series are solved by a dense factorization
  const std::uint64_t serial = ++made_;  // tells it from others that had its address
  bool turns_about_pins = false;  // the maker of the system knows that every body only turns about the third axis

  // Whether accelerations jump at the end of the step that ends at this moment.
  bool jumps_at(const Moment& end) const {
    if (jumps.empty()) return false;
    const auto next = std::upper_bound(jumps.begin(), jumps.end(), end.to);
    return next != jumps.end() && end.ends_at(*next);
  }
  // Every row is a constraint of the two bodies of its joint.
  bool plain() const { return rotors.empty() && mimics.empty(); }
  const Joint& joint(int k) const { return system.joints[parts[k].joint]; }
  const Part& part(int k) const { return *parts[k].part; }
  int count() const { return static_cast<int>(parts.size()); }
  int body(int k, Side side) const { return parts[k].bodies[side]; }
  // Nodes in the order of elimination, and how many of them, the last ones, belong to joints that close loops.
  // of_body(body, nodes) and of_joint(its parts, nodes) append those of each.
  template <class OfBody, class OfJoint>
  std::pair<std::vector<int>, int> arrange(const OfBody& of_body, const OfJoint& of_joint) const {
    std::vector<std::vector<int>> parts_of(system.joints.size());
    for (int k = 0; k < count(); ++k) parts_of[parts[k].joint].push_back(k);
    std::vector<int> nodes;
    for (int item : order.tree) item < system.n() ? of_body(item, nodes) : of_joint(parts_of[item - system.n()], nodes);
    const size_t of_tree = nodes.size();
    for (int item : order.loops) of_joint(parts_of[item - system.n()], nodes);
    return {nodes, static_cast<int>(nodes.size() - of_tree)};
  }
  // Calls visit(row in lam, place among three values a part) for every constraint row.
  template <class Visit>
  void for_rows(const Visit& visit) const {
    for (int k = 0; k < count(); ++k)
      for (int r = 0; r < part(k).rows(); ++r) visit(part(k).row + r, 3 * k + r);
  }

  // The symbolic factorization of a matrix, made on first use; other threads may use it too.
  template <class Make>
  const BlockPlan& blocks(const Pattern& pattern, const Make& make) const {
    const std::lock_guard lock(guard_);
    std::unique_ptr<const BlockPlan>& found = blocks_[pattern];
    if (!found) found = std::make_unique<const BlockPlan>(make());
    return *found;
  }

  // What was found of a loop where a run started last, or nullptr: a run asks thrice there, and so does the next one.
  std::shared_ptr<const LoopChoice> choice(size_t loop) const {
    const std::lock_guard lock(guard_);
    return choices_[loop];
  }
  void keep(size_t loop, std::shared_ptr<const LoopChoice> choice) const {
    const std::lock_guard lock(guard_);
    choices_[loop] = std::move(choice);
  }

 private:
  static inline std::atomic<std::uint64_t> made_ = 0;
  static std::vector<PlacedPart> number_parts(const System& system) {
    std::vector<PlacedPart> all;
    for (int j = 0; j < static_cast<int>(system.joints.size()); ++j)
      for (const Part& part : system.joints[j].parts)
        all.push_back({j, {system.joints[j].parent, system.joints[j].child}, &part});
    return all;
  }
  template <class Is>
  std::vector<int> find_parts(const Is& is) const {
    std::vector<int> found;
    for (int k = 0; k < count(); ++k)
      if (is(part(k))) found.push_back(k);
    return found;
  }
  static std::vector<PlacedMimic> find_mimics(const System& system, const std::vector<PlacedPart>& parts) {
    std::vector<PlacedMimic> found;
    for (const Mimic& mimic : system.mimics) found.push_back({mimic, -1, -1});
    for (int k = 0; k < static_cast<int>(parts.size()); ++k)
      if (const Part& part = *parts[k].part; part.mimic >= 0)
        (part.row < system.rows() ? found[part.mimic].follower : found[part.mimic].leader) = k;
    return found;
  }
  bool fits_whole() const {
    constexpr double kThin = 1e5, kGraded = 1e6;
    constexpr int kMostUnknowns = 96;
    return plain() && (system.thin(kThin) || system.graded(kGraded)) && 6 * system.n() + system.rows() <= kMostUnknowns;
  }
  // Trees of few rows, those of pins on the ground not counted, if refinement can correct the Schur complement; of pins
  // alone there is none.
  bool fits_small() const {
    const auto pins = std::count_if(hinges.hinges.begin(), hinges.hinges.end(),
                                    [this](const Hinge& hinge) { return hinge.base == system.n(); });
    return plain() && forest && count() - pins <= (whole ? 0 : kMostSmallParts);
  }

  mutable std::mutex guard_;
  mutable std::map<Pattern, std::unique_ptr<const BlockPlan>> blocks_;
  mutable std::vector<std::shared_ptr<const LoopChoice>> choices_ =
      std::vector<std::shared_ptr<const LoopChoice>>(loops.size());
};

// The unknowns of a step as nodes of three, and the order in which they are eliminated.

// Numbering of nodes. Bodies come first, each with v, w and, when doubled, xi_v, xi_w; then the multipliers of all
// parts; then, when doubled, their second set.
class Nodes {
 public:
  Nodes(const Plan& plan, bool doubled) : plan_(&plan), bodies_(plan.system.n()), doubled_(doubled) {}
  int v(int body) const { return stride() * body; }
  int w(int body) const { return v(body) + 1; }
  int xi_v(int body) const { return doubled_ ? v(body) + 2 : v(body); }
  int xi_w(int body) const { return doubled_ ? v(body) + 3 : w(body); }
  int lam(int part) const { return stride() * bodies_ + part; }
  int mu(int part) const { return doubled_ ? lam(part) + parts() : lam(part); }
  int parts() const { return plan_->count(); }
  bool doubled() const { return doubled_; }
  int count() const { return lam(0) + parts() * (doubled_ ? 2 : 1); }

  // The symbolic factorization of a matrix of these nodes. second_order: with the second derivatives of the
  // constraints.
  const BlockPlan& blocks(bool second_order) const {
    return plan_->blocks({Pattern::Matrix::step, doubled_, second_order}, [&] {
      const auto [nodes, tail] = order();
      return BlockPlan(nodes, tail, entries(second_order));
    });
  }

 private:
  int stride() const { return doubled_ ? 4 : 2; }

  // Blocks that can be nonzero.
  std::set<BlockPlan::Entry> entries(bool second_order) const {
    std::set<BlockPlan::Entry> found;
    auto both = [&](int a, int b) { found.insert({a, b}), found.insert({b, a}); };
    if (doubled_)
      for (int b = 0; b < bodies_; ++b) found.insert({xi_v(b), v(b)}), found.insert({xi_w(b), w(b)});
    for (int k = 0; k < parts(); ++k) {
      const Joint& joint = plan_->joint(k);
      const Part& part = plan_->part(k);
      for (int body : {joint.parent, joint.child}) {
        if (body == bodies_) continue;
        both(lam(k), w(body));
        if (doubled_) both(mu(k), xi_w(body)), found.insert({lam(k), xi_w(body)});
        if (!part.translational()) continue;
        both(lam(k), v(body));
        if (doubled_) both(mu(k), xi_v(body));
        if (doubled_ && !part.spherical) found.insert({lam(k), xi_v(body)});
      }
      if (second_order) stiffness_entries(joint, part, found);
    }
    for (const PlacedMimic& mimic : plan_->mimics) {
      both(lam(mimic.follower), lam(mimic.leader));
      both(mu(mimic.follower), mu(mimic.leader));
    }
    for (const Force& force : plan_->system.forces) force_entries(force, found);
    std::erase_if(found, [](const BlockPlan::Entry& entry) { return entry.first == entry.second; });
    return found;
  }

  // Nodes in elimination order, and how many multipliers of joints that close loops end it.
  std::pair<std::vector<int>, int> order() const {
    const auto of_body = [&](int body, std::vector<int>& nodes) {
      for (int node = v(body); node < v(body + 1); ++node) nodes.push_back(node);
    };
    return plan_->arrange(of_body, [&](const std::vector<int>& parts, std::vector<int>& nodes) {
      for (int k : parts) nodes.push_back(lam(k));
      for (int k : parts)
        if (doubled_) nodes.push_back(mu(k));
    });
  }

  void stiffness_entries(const Joint& joint, const Part& part, std::set<BlockPlan::Entry>& found) const {
    for (int row : {joint.parent, joint.child})
      for (int column : {joint.parent, joint.child}) {
        if (row == bodies_ || column == bodies_) continue;
        if (part.spherical && row != column) continue;  // an anchor's stiffness acts on its own body only
        found.insert({w(row), xi_w(column)});
        if (part.spherical || !part.translational()) continue;
        found.insert({v(row), xi_v(column)}), found.insert({v(row), xi_w(column)}),
            found.insert({w(row), xi_v(column)});
      }
  }

  // Every node of one side with every node of the other: springs depend on q, dampers on u.
  void force_entries(const Force& force, std::set<BlockPlan::Entry>& found) const {
    for (int row : {force.parent, force.child})
      for (int column : {force.parent, force.child}) {
        if (row == bodies_ || column == bodies_) continue;
        for (int i : {v(row), w(row)})
          for (int j : {v(column), w(column), xi_v(column), xi_w(column)}) found.insert({i, j});
      }
  }

  const Plan* plan_;
  int bodies_;
  bool doubled_;
};

// Blocks of the force on one body against the position or velocity of another.
struct PairBlocks {
  double *vv = nullptr, *vw = nullptr, *wv = nullptr, *ww = nullptr;

  static PairBlocks of(BlockLU& lu, int v, int w, int column_v, int column_w) {
    return {lu.block(v, column_v), lu.block(v, column_w), lu.block(w, column_v), lu.block(w, column_w)};
  }
  // Adds factor times K, its rotational columns times T.
  void add(double factor, const Stiffness& K, const Mat3& T) const {
    if (ww) lieeuler::add(ww, factor * K.ww * T);
    if (vv) lieeuler::add(vv, factor * K.vv);
    if (vw) lieeuler::add(vw, factor * K.vw * T);
    if (wv) lieeuler::add(wv, factor * K.wv);
  }
};

// Blocks of one side of a part: its rows and the body's columns, and the body's rows and its columns. A block that is
// zero by structure is nullptr.
struct SideBlocks {
  double *row_v = nullptr, *row_w = nullptr, *column_v = nullptr, *column_w = nullptr;

  static SideBlocks of(BlockLU& lu, int part, int v, int w) {
    return {lu.block(part, v), lu.block(part, w), lu.block(v, part), lu.block(w, part)};
  }
  void put_rows(const Mat3& v, const Mat3& w) const {
    if (row_v) put(row_v, v);
    if (row_w) put(row_w, w);
  }
  void put_columns(const Rows& G) const {  // G^T
    if (column_v) put(column_v, G.v.transpose());
    if (column_w) put(column_w, G.w.transpose());
  }
};

}  // namespace lieeuler
