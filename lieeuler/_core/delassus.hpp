// The Delassus matrix S = G M^-1 Gc^T: the mobility of the constraint rows, bodies eliminated.
//
// M is constant and block diagonal, so bodies leave  M y + Gc^T lam = f,  G y = g  at the cost of a few 3 x 3 products and
// what is left couples the joints that share a body. A body with many joints would tie each of them to every other: such a
// hub stays among the unknowns, and the cost stays proportional to the number of bodies. So do all bodies where joints
// close loops: S alone would lose digits there near singular positions.
#pragma once

#include "kinematics.hpp"

namespace lieeuler {

class Delassus {
 public:
  explicit Delassus(const System& system) : system_(system), nodes_(system, false) {
    hub_.assign(system.n() + 1, -1);
    std::vector<std::vector<int>> ends_at(system.n() + 1);
    for (int k = 0; k < nodes_.parts(); ++k)
      for (Side side : kSides) {
        const Joint& joint = system.joints[nodes_.part(k).joint];
        const int body = side == kChild ? joint.child : joint.parent;
        if (body == system.n()) continue;
        ends_at[body].push_back(static_cast<int>(ends_.size()));
        ends_.push_back(make_end(k, side, body));
      }
    int hubs = 0;
    const bool loops = !elimination_order(system).loops.empty();
    for (int b = 0; b < system.n(); ++b)
      if (loops || ends_at[b].size() > kMostEnds) hub_[b] = nodes_.parts() + 2 * hubs++;
    for (const std::vector<int>& ends : ends_at) write_out_translations(ends);
    plan(ends_at);
    for (int b = 0; b < system.n(); ++b)
      if (hub_[b] < 0)
        for (int row : ends_at[b])
          for (int column : ends_at[b])
            pairs_.push_back({row, column, lu_.block(ends_[row].part, ends_[column].part)});
    for (int k = 0; k < nodes_.parts(); ++k) padding_.push_back(lu_.block(k, k));
    hub_blocks_.resize(ends_.size());
    for (size_t e = 0; e < ends_.size(); ++e)
      if (const int hub = hub_[ends_[e].body]; hub >= 0)
        hub_blocks_[e] = SideBlocks::of(lu_, ends_[e].part, hub, hub + 1);
    rhs_.assign(lu_.unknowns(), 0.0);
  }

  int parts() const { return nodes_.parts(); }
  const Part& part(int k) const { return system_.joints[nodes_.part(k).joint].parts[nodes_.part(k).part]; }
  const PartIndex& index(int k) const { return nodes_.part(k); }
  BlockLU& lu() { return lu_; }
  int unknowns() const { return lu_.unknowns(); }

  // Rows of G at one configuration, the columns Gc^T at the same or another.
  void assemble(const Constraints& rows, const Constraints& columns) {
    lu_.set_zero();
    for (int k = 0; k < parts(); ++k)
      for (int r = part(k).rows(); r < 3; ++r) padding_[k][(kRow + 1) * r] = 1;
    const bool same = &rows == &columns;
    for (End& end : ends_) {
      if (end.part_data->spherical) {
        const Mat3 G = rows[end.joint].anchor_jacobian(end.side);
        put(end.G, G);
        put(end.W, system_.bodies[end.body].inertia_inverse *
                       (same ? G : columns[end.joint].anchor_jacobian(end.side)).transpose());
        continue;
      }
      const Rows G = rows[end.joint].jacobian(*end.part_data, end.side);
      set_columns(end, same ? G : columns[end.joint].jacobian(*end.part_data, end.side));
      put(end.G, G.w);
      if (end.translation == Translation::full) put(full_[end.full].Gv, G.v);
    }
    for (const Pair& pair : pairs_) {
      const End &row = ends_[pair.row], &column = ends_[pair.column];
      subtract_product(row.G, column.W, pair.block);
      if (row.translation == Translation::none || column.translation == Translation::none) continue;
      if (row.translation == Translation::unit && column.translation == Translation::unit)
        for (int i = 0; i < 3; ++i) pair.block[(kRow + 1) * i] -= row.sign * column.mobility;
      else
        subtract_product(full_[row.full].Gv, full_[column.full].Wv, pair.block);
    }
    assemble_hubs(rows, columns);
  }

  // M y + Gc^T lam = f, G y = g: f becomes y. `g` holds three values a part and becomes lam; adjust(values) may change
  // what stands on the right before and the multipliers after the solve.
  template <class Adjust>
  void solve(std::vector<Twist>& f, double* g, Adjust adjust) {
    std::copy_n(g, 3 * parts(), rhs_.data());
    for (int b = 0; b < system_.n(); ++b) {
      if (hub_[b] >= 0)
        store(f[b], rhs_.data() + 3 * hub_[b]);
      else
        f[b] = velocity(system_.bodies[b], f[b]);
    }
    adjust(rhs_.data());
    for (const End& end : ends_) {
      if (hub_[end.body] >= 0) continue;
      double* const row = rhs_.data() + 3 * end.part;
      subtract(end.G, f[end.body].w.data(), row);
      if (end.translation == Translation::unit)
        for (int i = 0; i < 3; ++i) row[i] -= end.sign * f[end.body].v[i];
      else if (end.translation == Translation::full)
        subtract(full_[end.full].Gv, f[end.body].v.data(), row);
    }
    lu_.solve(rhs_.data());
    adjust(rhs_.data());
    for (const End& end : ends_) {
      if (hub_[end.body] >= 0) continue;
      const double* const lam = rhs_.data() + 3 * end.part;
      subtract(end.W, lam, f[end.body].w.data());
      if (end.translation == Translation::unit)
        for (int i = 0; i < 3; ++i) f[end.body].v[i] -= end.mobility * lam[i];
      else if (end.translation == Translation::full)
        subtract(full_[end.full].Wv, lam, f[end.body].v.data());
    }
    for (int b = 0; b < system_.n(); ++b)
      if (hub_[b] >= 0) f[b] = load(rhs_.data() + 3 * hub_[b]);
    std::copy_n(rhs_.data(), 3 * parts(), g);
  }
  void solve(std::vector<Twist>& f, double* g) {
    solve(f, g, [](double*) {});
  }

 private:
  static constexpr size_t kMostEnds = 4;  // a body between two revolute joints; above, a hub is cheaper

  // What the rows of a part say of a body's translation: nothing, plus or minus the translation itself, or more.
  enum class Translation { none, unit, full };
  // One side of a part: its rows G at that body and W = M^-1 Gc^T.
  struct End {
    int part, joint, body;
    Side side;
    const Part* part_data;
    Translation translation;
    double G[kBlock] = {}, W[kBlock] = {};
    double sign = 0, mobility = 0;  // a unit translation's, and over the mass
    int full = -1;                  // place of the translations that are more than that
  };
  // V and M^-1 Vc^T of an end.
  struct Full {
    double Gv[kBlock] = {}, Wv[kBlock] = {};
  };
  struct Pair {
    int row, column;
    double* block;
  };

  End make_end(int k, Side side, int body) const {
    End end{k, nodes_.part(k).joint, body, side, &part(k), Translation::none};
    if (part(k).translational()) end.translation = part(k).spherical ? Translation::unit : Translation::full;
    if (part(k).spherical) {
      end.sign = side == kChild ? 1 : -1;
      end.mobility = end.sign / system_.bodies[body].mass;
    }
    return end;
  }

  // Where one end of a body has more than a unit translation, all that meet it need theirs as matrices.
  void write_out_translations(const std::vector<int>& ends) {
    const auto is_full = [this](int e) { return ends_[e].translation == Translation::full; };
    if (std::none_of(ends.begin(), ends.end(), is_full)) return;
    for (int e : ends) {
      if (ends_[e].translation == Translation::none) continue;
      ends_[e].full = static_cast<int>(full_.size());
      full_.emplace_back();
      put_diagonal(full_.back().Gv, ends_[e].sign);
      put_diagonal(full_.back().Wv, ends_[e].mobility);
    }
  }

  void set_columns(End& end, const Rows& G) {
    const Body& body = system_.bodies[end.body];
    put(end.W, body.inertia_inverse * G.w.transpose());
    if (end.translation == Translation::full) put(full_[end.full].Wv, G.v.transpose() / body.mass);
  }

  void plan(const std::vector<std::vector<int>>& ends_at) {
    std::vector<std::vector<int>> parts_of(system_.joints.size());
    for (int k = 0; k < parts(); ++k) parts_of[nodes_.part(k).joint].push_back(k);
    std::set<BlockLU::Entry> entries;
    for (int b = 0; b < system_.n(); ++b)
      for (int row : ends_at[b]) {
        if (hub_[b] >= 0)
          for (int node : {hub_[b], hub_[b] + 1}) entries.insert({ends_[row].part, node}), entries.insert({node, ends_[row].part});
        else
          for (int column : ends_at[b]) entries.insert({ends_[row].part, ends_[column].part});
      }
    std::erase_if(entries, [](const BlockLU::Entry& entry) { return entry.first == entry.second; });
    std::vector<int> order;
    auto append = [&](int item) {
      if (item >= system_.n())
        order.insert(order.end(), parts_of[item - system_.n()].begin(), parts_of[item - system_.n()].end());
      else if (hub_[item] >= 0)
        order.insert(order.end(), {hub_[item], hub_[item] + 1});
    };
    const EliminationOrder items = elimination_order(system_);
    for (int item : items.tree) append(item);
    const size_t sparse = order.size();
    for (int item : items.loops) append(item);
    lu_.plan(order, static_cast<int>(order.size() - sparse), entries);
  }

  void assemble_hubs(const Constraints& rows, const Constraints& columns) {
    for (int b = 0; b < system_.n(); ++b) {
      if (hub_[b] < 0) continue;
      put_diagonal(lu_.block(hub_[b], hub_[b]), system_.bodies[b].mass);
      put(lu_.block(hub_[b] + 1, hub_[b] + 1), system_.bodies[b].inertia);
    }
    for (size_t e = 0; e < ends_.size(); ++e) {
      if (!hub_blocks_[e].row_w) continue;
      const Rows G = rows[ends_[e].joint].jacobian(*ends_[e].part_data, ends_[e].side);
      hub_blocks_[e].put_rows(G.v, G.w);
      hub_blocks_[e].put_columns(columns[ends_[e].joint].jacobian(*ends_[e].part_data, ends_[e].side));
    }
  }

  const System& system_;
  Nodes nodes_;
  BlockLU lu_;  // of -S: parts first, then v and w of every hub
  std::vector<int> hub_;  // first node of a body that is a hub, else -1
  std::vector<End> ends_;
  std::vector<Full> full_;
  std::vector<Pair> pairs_;
  std::vector<double*> padding_;
  std::vector<SideBlocks> hub_blocks_;
  std::vector<double> rhs_;
};

}  // namespace lieeuler
