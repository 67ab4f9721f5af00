// Explicit Runge-Kutta-Munthe-Kaas steps of chains of ball joints in lanes: the equations of MuntheKaas, Projection and
// TreeSchur for these systems, in the same order of operations, so that a lane holds the numbers of a run by itself to
// the last bit. LIEEULER_CHAINS names the code, of LIEEULER_LANES lanes, for the instructions that this file is
// compiled with.
#include "methods/chain_lanes.hpp"

#include "linalg/chart_series.hpp"

namespace lieeuler {
namespace {

constexpr int kWidth = LIEEULER_LANES;
using Number = Registers<kWidth>::Number;
using Mask = Registers<kWidth>::Mask;
using Vec = Triple<Number>;
using Mat = ColumnStack<Number, 3>;
using Group = ChainGroup<kWidth>;
using State = LaneState<kWidth>;
using Twist = LaneTwist<kWidth>;

constexpr double kEps = 0x1p-52, kFloor = 4 * kEps, kNoise = 1e3 * kEps;  // as in Projection
constexpr int kMostIterations = 12;
constexpr double kLarge = 1e100;  // products might overflow beyond this

void add(Mat& sum, const Mat& m) {
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < 3; ++i) sum.part[c][i] += m.part[c][i];
}
Number total(const Vec& a) { return absolute(a[0]) + absolute(a[1]) + absolute(a[2]); }
// a^T b
Mat transposed_product(const Mat& a, const Mat& b) {
  Mat m;
  for (int c = 0; c < 3; ++c) put_column(m, c, transposed_times(a, column(b, c)));
  return m;
}
// a b, every column by itself.
Mat by_columns(const Mat& a, const Mat& b) {
  Mat m;
  for (int c = 0; c < 3; ++c) put_column(m, c, times(a, column(b, c)));
  return m;
}

// -S by blocks at the attitudes of `at`, as TreeSchur::assemble.
void assemble(Group& group, const State* at) {
  for (int k = 0; k < group.blocks; ++k) group.block[k] = {};
  for (int k = 0; k < group.joints; ++k) {
    const ChainJoint<kWidth>& joint = group.joint[k];
    const Mat& axes = group.axes[k] = at[joint.child].R;
    if (joint.parent < group.bodies) {
      const Mat& turn = group.turns[k] = transposed_product(axes, at[joint.parent].R);
      add(group.block[joint.diagonal], product(product(turn, joint.blocks[0]), transposed(turn)));
    }
    add(group.block[joint.diagonal], joint.blocks[1]);
  }
  for (int k = 0; k < group.pairs; ++k) {
    const ChainPair<kWidth>& pair = group.pair[k];
    const Mat block = product(pair.share, transposed(group.turns[pair.turn]));
    add(group.block[pair.blocks[0]], block);
    add(group.block[pair.blocks[1]], transposed(block));
  }
}

// For the loops over the steps of the elimination.
struct OfBlocks {
  Group& group;
  Mat& at(int block) const { return group.block[block / kBlock]; }
  bool invert(int block) const {
    Number* const values = &at(block).part[0][0];
    group.fine &= invert_by_cofactors<3>(values, values);
    return true;
  }
  void multiply(int a, int b) const { at(b) = by_columns(at(a), at(b)); }
  void subtract(int a, int b, int c) const {
    const Mat change = by_columns(at(a), at(b));
    for (int k = 0; k < 3; ++k) put_column(at(c), k, column(at(c), k) - column(change, k));
  }
};
struct OfUnknowns {
  const Group& group;
  Vec* rows;
  void multiply(int block, int x) const { rows[x / 3] = times(group.block[block / kBlock], rows[x / 3]); }
  void subtract(int block, int x, int y) const {
    rows[y / 3] = rows[y / 3] - times(group.block[block / kBlock], rows[x / 3]);
  }
};
void factor(Group& group, const State* at) {
  assemble(group, at);
  factor_blocks(group.elimination, OfBlocks{group});
}
// G y = rows: adds -M^-1 G^T lam to y, and lam takes the place of the rows. As TreeSchur::correct.
template <class Motion>
void correct(const Group& group, const Motion& y, Vec* rows) {
  for (int k = 0; k < group.joints; ++k) {
    const ChainJoint<kWidth>& joint = group.joint[k];
    if (joint.parent < group.bodies) {
      const Twist& t = y(joint.parent);
      rows[k] = rows[k] - (times(group.turns[k], cross(joint.anchors[0], t.w)) - transposed_times(group.axes[k], t.v));
    }
    const Twist& t = y(joint.child);
    rows[k] = rows[k] - (transposed_times(group.axes[k], t.v) - cross(joint.anchors[1], t.w));
  }
  substitute_forward(group.elimination, OfUnknowns{group, rows});
  substitute_back(group.elimination, OfUnknowns{group, rows});
  for (int k = 0; k < group.joints; ++k) {
    const ChainJoint<kWidth>& joint = group.joint[k];
    const Vec force = times(group.axes[k], rows[k]);
    if (joint.parent < group.bodies) {
      Twist& t = y(joint.parent);
      const ChainBody<kWidth>& body = group.body[joint.parent];
      t.v = t.v + body.mass_inverse * force;
      const Vec own = transposed_times(group.turns[k], rows[k]);
      t.w = t.w + times(body.inertia_inverse, cross(joint.anchors[0], own));
    }
    Twist& t = y(joint.child);
    const ChainBody<kWidth>& body = group.body[joint.child];
    t.v = t.v - body.mass_inverse * force;
    t.w = t.w - times(body.inertia_inverse, cross(joint.anchors[1], rows[k]));
  }
}

// (a, lam) of the index-1 system at the matrix factored last; lam in `rows`.
void accelerate(Group& group, const State* at, Vec* rows) {
  for (int b = 0; b < group.bodies; ++b) {
    const ChainBody<kWidth>& body = group.body[b];
    const Vec& w = at[b].u.w;
    for (int i = 0; i < 3; ++i) group.a[b].v[i] = body.weight[i] / body.mass;
    group.a[b].w = times(body.inertia_inverse, cross(times(body.deviation, w) + body.spin, w));
  }
  for (int k = 0; k < group.joints; ++k) {
    const ChainJoint<kWidth>& joint = group.joint[k];
    const Vec& w = at[joint.child].u.w;
    Vec gamma = cross(w, cross(w, joint.anchors[1]));
    if (joint.parent < group.bodies) {
      const Vec& above = at[joint.parent].u.w;
      gamma = gamma - times(group.turns[k], cross(above, cross(above, joint.anchors[0])));
    }
    rows[k] = -gamma;
  }
  correct(group, [&](int b) -> Twist& { return group.a[b]; }, rows);
}

// h times the weighted sum of slopes of a body.
void combine(const Group& group, const LaneTerms& terms, double h, int b, Vec* y) {
  for (int i = 0; i < 4; ++i) y[i] = {};
  for (int k = 0; k < terms.count; ++k) {
    const Number factor = all<Number>(h * terms.weights[k]);
    const Vec* const slope = group.slopes[terms.slopes[k]][b];
    for (int i = 0; i < 4; ++i) y[i] = y[i] + factor * slope[i];
  }
}
// The state at the point of the chart that a row of the tableau gives, and the slopes of x and theta there.
void configure(Group& group, const LaneTerms& terms, double h, int next) {
  for (int b = 0; b < group.bodies; ++b) {
    Vec y[4];
    combine(group, terms, h, b, y);
    const State& base = group.state[b];
    State& out = group.trial[b];
    const Vec& theta = y[1];
    const Number s = dot(theta, theta);
    group.fine &= s < kSeriesLimit;
    const Mask small = s < kShortSeriesLimit;
    const auto series = [&](const auto& coefficients) {
      return small ? polynomial<4>(coefficients, s) : polynomial<8>(coefficients, s);
    };
    const Number sinc = series(kSincSeries), cosc = series(kCoscSeries), inverse = series(kInverseTangentSeries);
    out.u.v = base.u.v + y[2], out.u.w = base.u.w + y[3];
    out.x = base.x + y[0];
    out.R = product(base.R, quadratic(theta, 1 - cosc * s, sinc, cosc));
    const Vec turned = cross(theta, out.u.w);
    group.slopes[next][b][0] = out.u.v;
    group.slopes[next][b][1] = out.u.w + all<Number>(0.5) * turned + inverse * cross(theta, turned);
  }
}

// Moves `trial` until its joints close, with the matrix factored last. As Projection::close.
void close(Group& group, const Number& length) {
  Mask active = group.fine;
  Number last = all<Number>(1);
  for (int k = 0; k < kMostIterations && any(active); ++k) {
    Twist change[kMostChainBodies] = {};
    Vec rows[kMostChainBodies];
    for (int j = 0; j < group.joints; ++j) {
      const ChainJoint<kWidth>& joint = group.joint[j];
      const State &parent = group.trial[joint.parent], &child = group.trial[joint.child];
      const Vec gap = (child.x - parent.x) + (times(child.R, joint.anchors[1]) - times(parent.R, joint.anchors[0]));
      rows[j] = transposed_times(group.axes[j], -gap);
    }
    correct(group, [&](int b) -> Twist& { return change[b]; }, rows);
    Number size{}, sum{};
    for (int b = 0; b < group.bodies; ++b) {
      const Vec &v = change[b].v, &w = change[b].w;
      size = larger(size, larger(largest(v) / length, largest(w)));
      sum += total(v) + total(w);
    }
    group.fine &= sum < kLarge;  // false for a NaN
    if (k > 0) group.fine &= ~(active & (size > kNoise) & (size > 0.5 * last));
    active &= group.fine;
    for (int b = 0; b < group.bodies; ++b) {
      State& body = group.trial[b];
      Mat R = body.R;
      add(R, turned(body.R, change[b].w));
      polish(R);
      for (int i = 0; i < 3; ++i) {
        body.x[i] = active ? body.x[i] + change[b].v[i] : body.x[i];
        for (int c = 0; c < 3; ++c) body.R.part[c][i] = active ? R.part[c][i] : body.R.part[c][i];
      }
    }
    Mask done = size <= kFloor;
    if (k > 0) done |= (size * size <= kFloor * last) | (size <= kNoise);
    active &= ~done;
    last = size;
  }
  group.fine &= ~active;
}

void put_accelerations(Group& group, int stage) {
  for (int b = 0; b < group.bodies; ++b)
    group.slopes[stage][b][2] = group.a[b].v, group.slopes[stage][b][3] = group.a[b].w;
}

void step(Group& group, double h) {
  Vec rows[kMostChainBodies];
  for (int b = 0; b < group.bodies; ++b)
    group.slopes[0][b][0] = group.state[b].u.v, group.slopes[0][b][1] = group.state[b].u.w;
  put_accelerations(group, 0);
  for (int i = 0; i < group.stages; ++i) {
    configure(group, group.rows[i], h, i + 1);
    factor(group, group.trial);
    accelerate(group, group.trial, rows);
    put_accelerations(group, i + 1);
  }
  configure(group, group.rows[group.stages], h, group.stages + 1);
  Number length = group.length;
  for (int b = 0; b < group.bodies; ++b) length = larger(length, largest(group.state[b].x));
  close(group, length);
  factor(group, group.trial);
  for (int k = 0; k < group.joints; ++k) rows[k] = {};
  correct(group, [&](int b) -> Twist& { return group.trial[b].u; }, rows);
  accelerate(group, group.trial, rows);
  Number sum{};
  for (int b = 0; b < group.bodies; ++b) {
    const State& body = group.state[b] = group.trial[b];
    sum += total(body.x) + total(body.u.v) + total(body.u.w) + total(group.a[b].v) + total(group.a[b].w);
  }
  for (int k = 0; k < group.joints; ++k) sum += total(rows[k]);
  group.fine &= sum < kLarge;
}

}  // namespace

const ChainCode<kWidth> LIEEULER_CHAINS{step};

}  // namespace lieeuler
