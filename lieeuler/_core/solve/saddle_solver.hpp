// The saddle-point system of every method at one configuration, (1.4) of docs/theory.md,
//
//   M y + G^T lam = f,   G y = rows
//
// by block elimination, either with all rows and the null space of redundant ones removed, or with independent rows
// only. If masses or moments differ too much for that, the whole matrix is factored.
#pragma once

#include <optional>

#include "model/mimic.hpp"
#include "model/plan.hpp"
#include "solve/independent_rows.hpp"

namespace lieeuler {

// Its matrix with the bodies eliminated, the Delassus matrix S = G A^-1 Gc^T, (8.1) of docs/theory.md.
//
// A is block diagonal: a mass and a 3 x 3 rotational matrix per body. Eliminating a body from A y + Gc^T lam = f,
// G y = g takes a few 3 x 3 products and couples the joints at that body. A body with many joints would couple all of
// them with each other: such a hub is kept among the unknowns, so that the cost stays proportional to the number of
// bodies. If joints close loops, all bodies are kept: S alone would lose digits near singular positions. With
// independent rows no body is kept; dependent rows are dropped and the others eliminated in the order of least fill.
//
// Eliminating a body divides by its mass and moments. If these span more than some six decades in directions that
// joints hold fast, refinement does not converge, however well the whole matrix is conditioned. It is then factored
// with pivots from all of it, whose cost is the cube of its size, for systems that no other elimination solves.
class Delassus {
 public:
  // One side of a part, at a body other than the ground.
  struct Place {
    int part, joint, body;
    Side side;
    const Part* part_data;
  };
  // G at one configuration.
  struct Jacobians {
    const Constraints& joints;
    Mat3 rotations(const Place& place) const { return joints[place.joint].anchor_jacobian(place.side); }
    Rows rows(const Place& place) const { return joints[place.joint].jacobian(*place.part_data, place.side); }
    // As rows of the caller (see assemble()).
    Mat3 rotations(const Place& place, const Mat3&) const { return rotations(place); }
    Rows rows(const Place& place, const Rows&) const { return rows(place); }
  };

  // independent: dependent rows of loops are dropped (see drop()) before the first assembly.
  // whole: the matrix is factored with pivots from all of it.
  enum class Kind { sparse, independent, whole };

  explicit Delassus(const Plan& plan, Kind kind = Kind::sparse)
      : plan_(plan), system_(plan.system), bodies_(system_.n()), hub_(system_.n(), -1), kind_(kind) {
    std::vector<std::vector<Place>> places_at(system_.n() + 1);
    for (int k = 0; k < parts(); ++k)
      for (Side side : kSides)
        places_at[plan.body(k, side)].push_back({k, plan.parts[k].joint, plan.body(k, side), side, &plan.part(k)});
    places_at.pop_back();
    for (int b = 0; b < system_.n(); ++b)
      if (kind == Kind::whole || (kind == Kind::sparse && (!plan.forest || places_at[b].size() > kMostEnds))) {
        hub_[b] = parts() + 2 * static_cast<int>(hubs_.size());
        hubs_.push_back({b});
      }
    lu_.follow(plan.blocks({Pattern::Matrix::mobility, kind == Kind::independent, kind == Kind::whole},
                           [&] { return eliminate_nodes(places_at); }));
    for (const std::vector<Place>& places : places_at) add_body(places);
    for (int k = 0; k < parts(); ++k) padding_.push_back(lu_.block(k, k));
    for (const PlacedMimic& mimic : plan.mimics)
      mimics_.emplace_back(mimic, [this](int i, int j) { return lu_.block(i, j); });
    for (Hub& hub : hubs_) {
      const int node = hub_[hub.body];
      hub.v = lu_.block(node, node), hub.w = lu_.block(node + 1, node + 1);
    }
    rhs_.assign(hubs_.empty() ? 0 : lu_.unknowns(), 0.0);
    for (int b = 0; b < system_.n(); ++b) {
      bodies_[b] = {1 / system_.bodies[b].mass, system_.bodies[b].inertia_inverse};
      if (hub_[b] >= 0) hub_of(b).inertia = system_.bodies[b].inertia;
    }
  }

  BlockLU& lu() { return lu_; }
  int unknowns() const { return lu_.unknowns(); }

  // Leaves rows out of S, given by their places in lam; their multipliers are zero.
  void drop(const std::vector<char>& rows) {
    dropped_.clear(), cuts_.clear();
    std::vector<char> cut(parts(), 0);
    plan_.for_rows([&](int row, int place) {
      if (rows[row]) dropped_.push_back(place), cut[place / 3] = 1;
    });
    std::set<double*> seen;
    for (const Pair& pair : pairs_) {
      const int row = ends_[pair.row].part, column = ends_[pair.column].part;
      if (!(cut[row] || cut[column]) || !seen.insert(pair.block).second) continue;
      Cut found{pair.block, row == column, {}, {}};
      for (int place : dropped_) {
        if (place / 3 == row) found.rows[place % 3] = true;
        if (place / 3 == column) found.columns[place % 3] = true;
      }
      cuts_.push_back(found);
    }
  }
  // The largest entry of the inverted pivots of the last factorization, rows scaled.
  double largest_inverse(const std::vector<double>& scales) const {
    double largest = 0;
    for (int k = 0; k < parts(); ++k)
      for (int c = 0; c < 3; ++c)
        for (int r = 0; r < plan_.part(k).rows(); ++r)
          largest = std::max(largest, std::abs(padding_[k][kColumn * c + r]) / (scales[3 * k + r] * scales[3 * k + c]));
    return largest;
  }
  void zero_dropped(double* rows) const {
    for (int place : dropped_) rows[place] = 0;
  }

  // Sets the rotational block of A, which is J otherwise; false if it is singular.
  bool set_rotational(int body, const Mat3& A) {
    if (hub_[body] < 0) return invert(A, bodies_[body].rotational);
    hub_of(body).inertia = A;
    return true;
  }

  // Rows and columns at the same configuration, or at two.
  void assemble(const Constraints& joints) {
    struct Same {
      const Mat3& rotations(const Place&, const Mat3& G) const { return G; }
      const Rows& rows(const Place&, const Rows& G) const { return G; }
    };
    assemble(Same{}, Jacobians{joints});
  }
  void assemble(const Constraints& rows, const Constraints& columns) { assemble(Jacobians{rows}, Jacobians{columns}); }
  // Rows of the caller: rotations(place, C) gives the rotational rows of a spherical part, rows(place, C) those of
  // other parts, where C is the columns' Jacobian at that place.
  template <class RowsOf>
  void assemble(const RowsOf& rows, const Jacobians& columns) {
    lu_.set_zero();
    for (int k = 0; k < parts(); ++k)
      for (int r = plan_.part(k).rows(); r < 3; ++r) padding_[k][(kColumn + 1) * r] = 1;
    for (int k : plan_.rotors) padding_[k][0] = -plan_.part(k).compliance;
    for (const MimicBlocks& mimic : mimics_) mimic.put();
    for (End& end : ends_) {
      const Mobility& body = bodies_[end.body];
      if (end.part_data->spherical) {
        const Mat3 C = columns.rotations(end);
        put(end.G, rows.rotations(end, C));
        put(end.W, body.rotational * C.transpose());
        continue;
      }
      const Rows C = columns.rows(end), G = rows.rows(end, C);
      put(end.G, G.w);
      put(end.W, body.rotational * C.w.transpose());
      if (end.translation != Translation::full) continue;
      put(full_[end.full].Gv, G.v);
      put(full_[end.full].Wv, C.v.transpose() * body.translational);
    }
    for (const Pair& pair : pairs_) {
      const End &row = ends_[pair.row], &column = ends_[pair.column];
      subtract_product(row.G, column.W, pair.block);
      if (row.translation == Translation::none || column.translation == Translation::none) continue;
      if (row.translation == Translation::unit && column.translation == Translation::unit)
        for (int i = 0; i < 3; ++i) pair.block[(kColumn + 1) * i] -= row.sign * column.mobility;
      else
        subtract_product(full_[row.full].Gv, full_[column.full].Wv, pair.block);
    }
    for (const Cut& cut : cuts_)
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
          if (cut.rows[r] || cut.columns[c]) cut.block[kColumn * c + r] = cut.diagonal && r == c ? 1 : 0;
    for (const Hub& hub : hubs_) put_diagonal(hub.v, system_.bodies[hub.body].mass), put(hub.w, hub.inertia);
    for (const HubEnd& end : hub_ends_) {
      const Rows C = columns.rows(end), G = rows.rows(end, C);
      end.blocks.put_rows(G.v, G.w);
      end.blocks.put_columns(C);
    }
  }

  // Solves A y + Gc^T lam = f, G y = g. The six values of a body in `f` become y, the three of a part in `g` become
  // lam. adjust(values) may change the right-hand side before the solve and the multipliers after it.
  template <class Adjust>
  void solve(double* f, double* g, Adjust adjust) {
    double* const rhs = hubs_.empty() ? g : rhs_.data();
    if (rhs != g) std::copy_n(g, 3 * parts(), rhs);
    for (int b = 0; b < system_.n(); ++b) {
      double* const y = f + 6 * b;
      if (hub_[b] >= 0) {
        std::copy_n(y, 6, rhs + 3 * hub_[b]);
        continue;
      }
      for (int i = 0; i < 3; ++i) y[i] *= bodies_[b].translational;
      store(times(bodies_[b].rotational, load3(y + 3)), y + 3);
    }
    adjust(rhs);
    subtract_rates(f, rhs);
    zero_dropped(rhs);
    lu_.solve(rhs);
    adjust(rhs);
    respond(rhs, f);
    if (rhs != g) std::copy_n(rhs, 3 * parts(), g);
  }
  void solve(double* f, double* g) {
    solve(f, g, [](double*) {});
  }
  // rows -= G y, without the columns of hubs.
  void subtract_rates(const double* y, double* rows) const {
    for (const End& end : ends_) {
      const double* const own = y + 6 * end.body;
      double* const row = rows + 3 * end.part;
      subtract(end.G, own + 3, row);
      if (end.translation == Translation::unit)
        for (int i = 0; i < 3; ++i) row[i] -= end.sign * own[i];
      else if (end.translation == Translation::full)
        subtract(full_[end.full].Gv, own, row);
    }
  }
  // solve() with f = 0. `y` becomes -A^-1 Gc^T lam with the columns given last, whatever rows S was assembled with.
  void solve_rows(double* g, double* y) {
    std::fill_n(y, 6 * system_.n(), 0.0);
    double* const rhs = hubs_.empty() ? g : rhs_.data();
    if (rhs != g) {
      std::fill(rhs_.begin(), rhs_.end(), 0.0);
      std::copy_n(g, 3 * parts(), rhs);
    }
    zero_dropped(rhs);
    lu_.solve(rhs);
    respond(rhs, y);
    if (rhs != g) std::copy_n(rhs, 3 * parts(), g);
  }

 private:
  int parts() const { return plan_.count(); }

  static constexpr size_t kMostEnds = 4;  // a body between two revolute joints; above, a hub is cheaper

  // How the rows of a part depend on a body's translation: not at all, by plus or minus the identity, or by a matrix.
  enum class Translation { none, unit, full };
  // An end at a body to be eliminated: the rows G and W = A^-1 Gc^T.
  struct End : Place {
    Translation translation = Translation::none;
    double G[kBlock] = {}, W[kBlock] = {};
    double sign = 0, mobility = 0;  // of a unit translation; mobility = sign / mass
    int full = -1;                  // index in full_ of a matrix for the translation
  };
  // The translational rows V and M^-1 Vc^T of an end.
  struct Full {
    double Gv[kBlock] = {}, Wv[kBlock] = {};
  };
  struct Pair {
    int row, column;
    double* block;
  };
  // A block of S with rows and columns that are dropped.
  struct Cut {
    double* block;
    bool diagonal, rows[3], columns[3];
  };
  // A^-1 of a body to be eliminated.
  struct Mobility {
    double translational = 0;
    Mat3 rotational = Mat3::Zero();
  };
  struct Hub {
    int body;
    Mat3 inertia = Mat3::Zero();
    double *v = nullptr, *w = nullptr;  // its diagonal blocks
  };
  struct HubEnd : Place {
    SideBlocks blocks;
  };

  // y -= A^-1 Gc^T lam, and y of the hubs, from the solution of lu_.
  void respond(const double* solution, double* y) const {
    for (const End& end : ends_) {
      double* const own = y + 6 * end.body;
      const double* const lam = solution + 3 * end.part;
      subtract(end.W, lam, own + 3);
      if (end.translation == Translation::unit)
        for (int i = 0; i < 3; ++i) own[i] -= end.mobility * lam[i];
      else if (end.translation == Translation::full)
        subtract(full_[end.full].Wv, lam, own);
    }
    for (const Hub& hub : hubs_) std::copy_n(solution + 3 * hub_[hub.body], 6, y + 6 * hub.body);
  }

  Hub& hub_of(int body) { return hubs_[(hub_[body] - parts()) / 2]; }

  // Adds the ends at one body, and the blocks of S for their pairs.
  void add_body(const std::vector<Place>& places) {
    const int first = static_cast<int>(ends_.size());
    for (const Place& place : places) {
      if (const int hub = hub_[place.body]; hub >= 0) {
        hub_ends_.push_back({place, SideBlocks::of(lu_, place.part, hub, hub + 1)});
        continue;
      }
      End end{place};
      if (place.part_data->translational())
        end.translation = place.part_data->spherical ? Translation::unit : Translation::full;
      if (place.part_data->spherical) {
        end.sign = place.side == kChild ? 1 : -1;
        end.mobility = end.sign / system_.bodies[place.body].mass;
      }
      ends_.push_back(end);
    }
    const int last = static_cast<int>(ends_.size());
    write_out_translations(first, last);
    for (int row = first; row < last; ++row)
      for (int column = first; column < last; ++column)
        pairs_.push_back({row, column, lu_.block(ends_[row].part, ends_[column].part)});
  }

  // If one end of a body needs a matrix for its translation, all ends of that body need one.
  void write_out_translations(int first, int last) {
    const auto is_full = [](const End& end) { return end.translation == Translation::full; };
    if (std::none_of(ends_.begin() + first, ends_.begin() + last, is_full)) return;
    for (int e = first; e < last; ++e) {
      if (ends_[e].translation == Translation::none) continue;
      ends_[e].full = static_cast<int>(full_.size());
      full_.emplace_back();
      put_diagonal(full_.back().Gv, ends_[e].sign);
      put_diagonal(full_.back().Wv, ends_[e].mobility);
    }
  }

  BlockPlan eliminate_nodes(const std::vector<std::vector<Place>>& places_at) const {
    std::set<BlockPlan::Entry> entries;
    for (int b = 0; b < system_.n(); ++b)
      for (const Place& row : places_at[b]) {
        if (hub_[b] >= 0)
          for (int node : {hub_[b], hub_[b] + 1}) entries.insert({row.part, node}), entries.insert({node, row.part});
        else
          for (const Place& column : places_at[b]) entries.insert({row.part, column.part});
      }
    for (const PlacedMimic& mimic : plan_.mimics)
      entries.insert({mimic.follower, mimic.leader}), entries.insert({mimic.leader, mimic.follower});
    std::erase_if(entries, [](const BlockPlan::Entry& entry) { return entry.first == entry.second; });
    if (kind_ == Kind::independent) return BlockPlan(minimum_degree_order(parts(), entries), 0, entries);
    const auto of_body = [&](int body, std::vector<int>& nodes) {
      if (hub_[body] >= 0) nodes.insert(nodes.end(), {hub_[body], hub_[body] + 1});
    };
    const auto [order, tail] = plan_.arrange(of_body, [](const std::vector<int>& parts, std::vector<int>& nodes) {
      nodes.insert(nodes.end(), parts.begin(), parts.end());
    });
    return BlockPlan(order, kind_ == Kind::whole ? static_cast<int>(order.size()) : tail, entries);
  }

  const Plan& plan_;
  const System& system_;
  BlockLU lu_;  // of -S: parts first, then v and w of every hub
  std::vector<Mobility> bodies_;
  std::vector<int> hub_;  // first node of a body that is a hub, else -1
  std::vector<Hub> hubs_;
  std::vector<End> ends_;
  std::vector<HubEnd> hub_ends_;
  std::vector<Full> full_;
  std::vector<Pair> pairs_;
  const Kind kind_;
  std::vector<int> dropped_;  // places of rows, three a part
  std::vector<Cut> cuts_;
  std::vector<double*> padding_;
  std::vector<MimicBlocks> mimics_;
  std::vector<double> rhs_;
};

// A method that fails with a scaled pivot below this is within about 1e-3 of a singular position.
inline constexpr double kNearlySingular = 1e-6;

class SaddleSolver {
 public:
  // independent: leaves out the rows of loops that depend on others.
  SaddleSolver(const Plan& plan, bool independent)
      : plan_(plan),
        delassus_(std::in_place, plan, independent ? Delassus::Kind::independent : Delassus::Kind::sparse),
        leaves_out_(independent) {
    if (independent) independent_.emplace(plan);
    if (plan.whole) whole_.emplace(plan, Delassus::Kind::whole);
    for (int k = 0; k < plan.count(); ++k)
      if (plan.part(k).drive) driven_.push_back(k);
  }

  Delassus& delassus() { return *delassus_; }

  // Counts the redundant rows at this configuration. False if the rest is singular.
  bool count_redundancy(const Constraints& joints, int& redundant) {
    if (independent_) {
      std::vector<char> dropped;
      redundant = independent_->choose(joints, dropped);
      return true;
    }
    if (whole_) {
      redundant = dependent_rows(joints);
      whole_->assemble(joints);
      whole_->lu().equilibrate_tail();
      return true;
    }
    constexpr double kTolerance = 1e-11;  // of pivots of order one, which go as squares of singular values of G
    delassus_->assemble(joints);
    return delassus_->lu().find_deficiency(kTolerance, redundant);
  }
  // 1 / sqrt of the diagonal of G M^-1 G^T, three values a part; it scales constraint rows to order one in any units.
  std::vector<double> row_scales(const Constraints& joints) const {
    std::vector<double> scales(3 * plan_.count(), 1.0);
    for (int k = 0; k < plan_.count(); ++k) {
      Vec3 mobility = Vec3::Zero();
      for (Side side : kSides) {
        const int b = plan_.body(k, side);
        if (b == system_.n()) continue;
        const Body& body = system_.bodies[b];
        const Rows G = joints[plan_.parts[k]].jacobian(plan_.part(k), side);
        mobility += (G.v * G.v.transpose() / body.mass + G.w * body.inertia_inverse * G.w.transpose()).diagonal();
      }
      mobility[0] += plan_.part(k).compliance;
      for (int r = 0; r < plan_.part(k).rows(); ++r) scales[3 * k + r] = 1 / std::sqrt(mobility[r]);
    }
    for (const PlacedMimic& mimic : plan_.mimics) scales[3 * mimic.leader + 1] = 1 / scales[3 * mimic.leader];
    return scales;
  }

  // Counts the redundant rows and expects that number from then on.
  bool find_redundancy(const Constraints& joints) {
    int redundant;
    if (leaves_out_ && !independent_)
      independent_.emplace(plan_), delassus_.emplace(plan_, Delassus::Kind::independent);
    if (independent_) {
      scales_ = row_scales(joints);
      redundant_ = independent_->choose(joints, dropped_, true);
      if (take_choice(joints) && regular()) return true;
      independent_.reset();  // a row depends on several loops together
      delassus_.emplace(plan_);
    }
    std::vector<double> scales = row_scales(joints);
    scales.resize(delassus_->unknowns(), 1.0);
    delassus_->lu().scale_tail(scales);
    if (!count_redundancy(joints, redundant)) return false;
    delassus_->lu().expect_deficiency(redundant);
    redundant_ = redundant;
    if (whole_) whole_->lu().expect_deficiency(redundant);
    null_.assign(redundant, std::vector<double>((whole_ ? *whole_ : *delassus_).unknowns(), 0.0));
    return true;
  }
  int redundant() const { return redundant_; }
  // Marks the rows left out by their places in lam; nullptr if none are.
  const std::vector<char>* dropped() const { return independent_ ? &dropped_ : nullptr; }
  // Near a singular position of a loop it is proportional to the square of the distance.
  double smallest_pivot() {
    return independent_ ? 1 / delassus_->largest_inverse(scales_) : delassus_->lu().smallest_tail_pivot();
  }

  // False if rows have become dependent. on_constraints: other independent rows may be chosen here.
  bool factor(const Constraints& joints, bool on_constraints = true) {
    factored_ = &joints;
    delassus_->assemble(joints);
    const bool regular = delassus_->lu().factor();
    if (independent_) {
      if (regular && !on_constraints) return true;
      const double inverse = delassus_->largest_inverse(scales_);
      if (regular && inverse < kWorse * inverse_at_choice_) {
        inverse_at_choice_ = std::min(inverse_at_choice_, kWorse * inverse);  // it was chosen near a singular position
        return true;
      }
      return independent_->choose(joints, dropped_) == redundant_ && take_choice(joints);
    }
    if (whole_) whole_->assemble(joints);
    solves_whole_ = whole_ && whole_->lu().factor();
    if (!regular && !solves_whole_) return false;
    find_null_space(joints);
    return true;
  }
  // How many times independent rows have been chosen.
  int choice() const { return choice_; }

  // Removes the multiplier directions without effect, G^T w = 0, from three values a part: from residuals, where they
  // are contradictions between redundant rows, and from multipliers, which become those of least norm.
  void remove_null_space(double* values) const {
    for (const std::vector<double>& w : null_) subtract_component(w, values);
  }

  // Replaces the multipliers of all rows by those of least norm with the same effect, at the joints factored last.
  void make_least_norm(const Constraints& joints, std::vector<double>& lam) {
    if (independent_) return independent_->make_least_norm(joints, lam);
    for (const std::vector<double>& w : null_) {
      double product = 0;
      plan_.for_rows([&](int row, int place) { product += w[place] * lam[row]; });
      plan_.for_rows([&](int row, int place) { lam[row] -= product * w[place]; });
    }
  }

  // Solves M y + G^T lam = f, G y = rows; y and lam replace f and the rows of each part. Almost dependent rows and very
  // different masses lose digits of the rows in the first pass, thin bodies also digits of the balance of forces; the
  // residual is then solved for again. to_rounding: do so for redundant rows and mimics too. Not inlined: series of
  // small trees would have to save its registers.
  [[gnu::noinline]] void solve(std::vector<Twist>& y, std::vector<Vec3>& rows, bool to_rounding) {
    const bool always = plan_.graded || thin_ || !plan_.rotors.empty();
    const bool again = always || (to_rounding && (redundant_ > 0 || independent_ || !plan_.mimics.empty()));
    if (again) wanted_ = rows;
    if (thin_) forces_ = y;
    solve_once(y, rows);
    double last = std::numeric_limits<double>::infinity();
    for (int pass = 0; again && pass < (thin_ ? kMostPasses : 1); ++pass) {
      const double change = refine(y, rows);
      if (!(change < kSlow * last)) break;
      last = change;
    }
  }

  // The least displacement that closes the joints to first order: M d + G^T mu = 0, G d = -Phi. angles: of forces.
  void displace(const Constraints& joints, const std::vector<double>& angles, std::vector<Twist>& d) {
    std::fill(d.begin(), d.end(), Twist{});
    for (int k = 0; k < plan_.count(); ++k) rows_[k] = -joints[plan_.parts[k]].position(plan_.part(k));
    for (int k : plan_.rotors) rows_[k].setZero();
    combine(plan_, rows_.data()->data());
    for (const PlacedMimic& mimic : plan_.mimics) rows_[mimic.follower][0] = -gap(plan_, mimic, joints, angles);
    solve(d, rows_, false);  // the caller iterates, so the lost digits do not matter
  }
  // u <- u - M^-1 G^T mu with G u + dPhi/dt = 0. Solves for the change: M^-1 (M u) would lose a rounding of u each
  // time, always in the same direction where u is steady.
  void project(const Constraints& joints, std::vector<Twist>& u) {
    put_drift(joints);
    for (int k = 0; k < plan_.count(); ++k) rows_[k] -= joints.velocity(plan_.parts[k], u);
    for (int k : plan_.rotors) rows_[k].setZero();
    combine(plan_, rows_.data()->data());
    std::fill(force_.begin(), force_.end(), Twist{});
    solve(force_, rows_, true);
    for (int b = 0; b < system_.n(); ++b) u[b] += force_[b];
  }
  // From the momentum p, spins included: u = M^-1 (p - G^T mu) with G u + dPhi/dt = 0. Adds -G^T mu to `change`, which
  // may be p. `rates` are those of the rotors from their momenta, which change by mu.
  void project(const Constraints& joints, const std::vector<Twist>& p, std::vector<Twist>& u, double* mu,
               std::vector<Twist>& change, const std::vector<double>& rates) {
    for (int b = 0; b < system_.n(); ++b) force_[b] = {p[b].v, p[b].w - system_.bodies[b].spin};
    put_drift(joints);
    for (size_t i = 0; i < rates.size(); ++i) rows_[plan_.rotors[i]][0] = rates[i];
    solve(force_, rows_, true);
    put_multipliers(mu);
    std::copy_n(force_.begin(), system_.n(), u.begin());
    for (int k = 0; k < plan_.count(); ++k) joints.subtract_reaction(plan_.parts[k], rows_[k], change);
  }
  // (a, lam) of the index-1 system: M a + G^T lam = f, G a + gamma = 0.
  void accelerate(const Constraints& joints, State& state) {
    generalized_forces(system_, state.frames, state.u, state.angles, state.a);
    for (int k = 0; k < plan_.count(); ++k) rows_[k] = -joints.gamma(plan_.parts[k], state.u);
    combine(plan_, rows_.data()->data());
    solve(state.a, rows_, true);
    put_multipliers(state.lam.data());
    state.a[system_.n()] = Twist{};
  }

 private:
  static constexpr double kWorse = 4;         // growth of the inverted pivots at which other rows are chosen
  static constexpr double kDependent = 1e10;  // inverse of an eigenvalue that is rounding
  static constexpr int kMostPasses = 8;       // each pass gains a digit or more if moments span eight decades
  static constexpr double kSlow = 0.3;        // corrections that shrink less than this are rounding

  // rows_ = -dPhi/dt, which is zero except for driven rows.
  void put_drift(const Constraints& joints) {
    std::fill(rows_.begin(), rows_.end(), Vec3::Zero());
    for (int k : driven_) rows_[k] = -joints[plan_.parts[k]].drift(plan_.part(k));
  }
  // Copies multipliers from rows_, in the order of lam.
  void put_multipliers(double* lam) const {
    for (int k = 0; k < plan_.count(); ++k) {
      const Part& part = plan_.part(k);
      for (int r = 0; r < part.rows(); ++r) lam[part.row + r] = rows_[k][r];
    }
  }

  Delassus& factored() { return solves_whole_ ? *whole_ : *delassus_; }

  // Number of rows that depend on others, whatever the masses.
  int dependent_rows(const Constraints& joints) const {
    constexpr double kDependent = 1e-11;  // pivots go as squares of singular values of G
    const int rows = system_.rows();
    Eigen::MatrixXd G = Eigen::MatrixXd::Zero(rows, 6 * system_.n());
    for (const auto& [joint, bodies, part] : plan_.parts)
      for (Side side : kSides) {
        if (bodies[side] == system_.n()) continue;
        const Rows own = joints[joint].jacobian(*part, side);
        G.block(part->row, 6 * bodies[side], part->rows(), 3) = own.v.topRows(part->rows());
        G.block(part->row, 6 * bodies[side] + 3, part->rows(), 3) = own.w.topRows(part->rows()) / system_.length;
      }
    G.rowwise().normalize();
    const Eigen::MatrixXd S = G * G.transpose();
    FullPivotLU independent;
    independent.resize(rows);
    for (int i = 0; i < rows; ++i)
      for (int j = 0; j < rows; ++j) independent(i, j) = S(i, j);
    return rows - independent.rank(kDependent);
  }
  bool take_choice(const Constraints& joints) {
    ++choice_;
    delassus_->drop(dropped_);
    delassus_->assemble(joints);
    if (!delassus_->lu().factor()) return false;
    inverse_at_choice_ = delassus_->largest_inverse(scales_);
    return true;
  }
  // Whether the rows chosen loop by loop are independent together, by a few steps of inverse iteration.
  bool regular() {
    std::vector<double> x(scales_.size());
    std::vector<Twist> response(system_.n());
    for (size_t i = 0; i < x.size(); ++i) x[i] = std::sin(1.0 + static_cast<double>(i));
    for (int pass = 0; pass < 4; ++pass) {
      double square = 0;
      for (double value : x) square += value * value;
      for (size_t i = 0; i < x.size(); ++i) x[i] /= std::sqrt(square) * scales_[i];
      delassus_->solve_rows(x.data(), flat(response));
      square = 0;
      for (size_t i = 0; i < x.size(); ++i) x[i] /= scales_[i], square += x[i] * x[i];
      if (!(square < kDependent * kDependent)) return false;
    }
    return true;
  }
  void solve_once(std::vector<Twist>& y, std::vector<Vec3>& rows) {
    factored().solve(flat(y), rows.data()->data(), [this](double* values) { remove_null_space(values); });
  }
  // Adds the correction of the residual of the whole system to y and rows; returns its largest rate.
  double refine(std::vector<Twist>& y, std::vector<Vec3>& rows) {
    const Constraints& joints = *factored_;
    y[system_.n()] = Twist{};
    correction_.assign(system_.n() + 1, Twist{});
    if (thin_) {
      for (int b = 0; b < system_.n(); ++b) correction_[b] = forces_[b] - momentum(system_.bodies[b], y[b]);
      for (int k = 0; k < plan_.count(); ++k) joints.subtract_reaction(plan_.parts[k], rows[k], correction_);
    }
    if (independent_) {
      residual_ = wanted_;
      delassus_->subtract_rates(flat(y), residual_.data()->data());
    }
    for (int k = 0; !independent_ && k < plan_.count(); ++k)
      residual_[k] = wanted_[k] - joints.velocity(plan_.parts[k], y);
    combine(plan_, residual_.data()->data());
    for (int k : plan_.rotors) residual_[k][0] += plan_.part(k).compliance * rows[k][0];
    solve_once(correction_, residual_);
    const Scales scales{system_.length};
    double change = 0;
    for (int b = 0; b < system_.n(); ++b) {
      y[b] += correction_[b];
      change = std::max(change, scales.rate_of(correction_[b]));
    }
    for (int k = 0; k < plan_.count(); ++k) rows[k] += residual_[k];
    return change;
  }

  // Orthonormal vectors of multipliers w with G^T w = 0.
  void find_null_space(const Constraints& joints) {
    for (int k = 0; k < static_cast<int>(null_.size()); ++k) {
      std::vector<double>& w = null_[k];
      factored().lu().null_vector(k, w.data());
      std::fill(w.begin() + 3 * plan_.count(), w.end(), 0.0);  // null vectors are zero for the hubs
      cleanse(joints, w);
      for (int pass = 0; pass < 2; ++pass)  // Gram and Schmidt, twice is enough
        for (int i = 0; i < k; ++i) subtract_component(null_[i], w.data());
      double square = 0;
      for (double value : w) square += value * value;
      for (double& value : w) value /= std::sqrt(square);
    }
  }
  // Corrects w so that G^T w = 0: solves M y + G^T m = G^T w, G y = 0 and replaces w by w - m.
  void cleanse(const Constraints& joints, std::vector<double>& w) {
    correction_.assign(system_.n() + 1, Twist{});
    for (int k = 0; k < plan_.count(); ++k) joints.subtract_reaction(plan_.parts[k], -load3(&w[3 * k]), correction_);
    std::fill(residual_.begin(), residual_.end(), Vec3::Zero());
    factored().solve(flat(correction_), residual_.data()->data());
    for (int k = 0; k < plan_.count(); ++k) store(Vec3(load3(&w[3 * k]) - residual_[k]), &w[3 * k]);
  }
  void subtract_component(const std::vector<double>& w, double* values) const {
    const size_t count = 3 * residual_.size();
    double product = 0;
    for (size_t i = 0; i < count; ++i) product += w[i] * values[i];
    for (size_t i = 0; i < count; ++i) values[i] -= product * w[i];
  }

  const Plan& plan_;
  const System& system_ = plan_.system;
  std::optional<Delassus> delassus_;
  const bool thin_ = plan_.thin || plan_.whole, leaves_out_;
  std::optional<IndependentRows> independent_;
  std::optional<Delassus> whole_;
  bool solves_whole_ = false;  // at the joints factored last
  std::vector<char> dropped_;
  std::vector<double> scales_;  // of the rows, for the choice
  double inverse_at_choice_ = 0;
  int redundant_ = 0, choice_ = 0;
  const Constraints* factored_ = nullptr;
  std::vector<int> driven_;  // parts with a drive
  std::vector<Twist> force_ = std::vector<Twist>(system_.n() + 1);
  std::vector<Vec3> rows_ = std::vector<Vec3>(plan_.count());  // of each part: right-hand sides, then multipliers
  std::vector<Vec3> residual_ = rows_, wanted_;                // for refinement
  std::vector<Twist> forces_, correction_;
  std::vector<std::vector<double>> null_;  // orthonormal vectors w with G^T w = 0, three values a part
};

}  // namespace lieeuler
