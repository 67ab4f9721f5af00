// Saddle-point systems with the bodies eliminated: the Delassus matrix S = G A^-1 Gc^T, (8.1) of docs/theory.md.
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
#pragma once

#include "model/mimic.hpp"
#include "model/plan.hpp"

namespace lieeuler {

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

}  // namespace lieeuler
