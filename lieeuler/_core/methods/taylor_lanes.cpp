// Taylor series of a tree of ball joints in lanes: the equations of MotionSeries, SmallSchur and TaylorStepper for
// these systems, in the same order of operations, so that a lane holds the numbers of a run by itself to the last bit.
// LIEEULER_CODE names the code, of LIEEULER_LANES lanes, for the instructions that this file is compiled with.
#include "methods/taylor_lanes.hpp"

#include "linalg/root.hpp"

namespace lieeuler {
namespace {

constexpr int kWidth = LIEEULER_LANES;
using Number = Registers<kWidth>::Number;
using Mask = Registers<kWidth>::Mask;
using Vec = Triple<Number>;
using Mat = ColumnStack<Number, 3>;
using Group = LaneGroup<kWidth>;
using Body = LaneBody<kWidth>;
using Joint = LaneJoint<kWidth>;
using Twist = LaneTwist<kWidth>;

constexpr double kGraded = 1e-3;  // as in SmallSchur, which refines below it
constexpr int kRows = 3 * kMostLaneBodies;
constexpr double kLarge = 1e100;  // accelerations might overflow beyond this

Vec vector(const Factors<Number>& a) { return {{a.component[0], a.component[1], a.component[2]}}; }
Factors<Number> factors(const Vec& a) { return {{a[0], a[1], a[2]}}; }
void put_momentum(ColumnStack<Number, 4>& A, const Vec& L) {
  for (int c = 0; c < 3; ++c) A.part[c][3] = L[c];
}
Vec transpose_times(const ColumnStack<Number, 4>* A, const Vec* V, int first, int k) {
  Vec total[3] = {};
  transpose_products(A, V, first, k, total);
  Vec y;
  for (int c = 0; c < 3; ++c) y[c] = (total[c][0] + total[c][2]) + total[c][1];
  return y;
}

void orthogonalise(Mat& R) {
  Mask rest = ~Mask{};
  for (int k = 0; k < 8 && any(rest); ++k) {
    Mat next = R;
    const Number before = polish(next);
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < 3; ++i) R.part[c][i] = rest ? next.part[c][i] : R.part[c][i];
    rest &= before >= 1e-8;
  }
}

// S = G M^-1 G^T at `state`, factored; lanes whose pivots need refinement are not fine.
void factor(Group& group) {
  const int rows = 3 * group.joints;
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < rows; ++i) group.schur[j][i] = Number{};
  for (int k = 0; k < group.joints; ++k) {
    Joint& joint = group.joint[k];
    for (int side = 0; side < 2; ++side) {
      const int b = joint.bodies[side];
      const Mat& R = group.state[b].R;
      Mat& G = joint.G[side];
      const Vec& s = joint.anchors[side];
      G = turned(R, side ? Vec{{-s[0], -s[1], -s[2]}} : s);
      if (group.body[b].pinned) {
        const Mat moved = turned(R, group.body[b].centre);
        for (int c = 0; c < 3; ++c)
          put_column(G, c, side ? column(G, c) - column(moved, c) : column(G, c) + column(moved, c));
      }
      joint.H[side] = product(group.body[b].inertia_inverse, transposed(G));
    }
  }
  for (int k = 0; k < group.joints; ++k)
    for (int side = 0; side < 2; ++side)
      for (int l = 0; l <= k; ++l)
        for (int other = 0; other < 2; ++other) {
          const Joint &row = group.joint[k], &col = group.joint[l];
          const int b = row.bodies[side];
          if (b != col.bodies[other]) continue;
          const Mat block = product(row.G[side], col.H[other]);
          for (int j = 0; j < 3; ++j)
            for (int i = 0; i < 3; ++i) {
              Number entry = block.part[j][i];
              if (i == j && !group.body[b].pinned)
                entry = side == other ? entry + group.body[b].mass_inverse : entry - group.body[b].mass_inverse;
              group.schur[3 * l + j][3 * k + i] += entry;
            }
        }
}

// As SmallSchur::invert_block for one joint: the inverse takes the place of S.
void invert(Group& group) {
  Vec c[3], inverse[3];
  for (int j = 0; j < 3; ++j) c[j] = {{group.schur[j][0], group.schur[j][1], group.schur[j][2]}};
  inverse[0] = cross(c[1], c[2]), inverse[1] = cross(c[2], c[0]), inverse[2] = cross(c[0], c[1]);
  const Number volume = dot(c[0], inverse[0]), size = c[0][0] * c[1][1] * c[2][2];
  group.fine &= volume >= kGraded * size;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) group.schur[j][i] = inverse[i][j] / volume;
}
void solve_single(const Group& group, Number* lam) {
  const Vec r{{lam[0], lam[1], lam[2]}};
  for (int i = 0; i < 3; ++i) lam[i] = group.schur[0][i] * r[0] + group.schur[1][i] * r[1] + group.schur[2][i] * r[2];
}

// G y = rows: adds -M^-1 G^T lam to y, and writes lam of order k.
void correct(Group& group, Twist* y, const Vec* rows, int k) {
  Number lam[3 * kMostLaneBodies];
  for (int j = 0; j < group.joints; ++j) {
    const Joint& joint = group.joint[j];
    Vec r = Vec{{-rows[j][0], -rows[j][1], -rows[j][2]}};
    for (int side = 0; side < 2; ++side) {
      const int b = joint.bodies[side];
      Vec rate = times(joint.G[side], y[b].w);
      if (!group.body[b].pinned) rate = side ? rate + y[b].v : rate - y[b].v;
      r = r + rate;
    }
    for (int i = 0; i < 3; ++i) lam[3 * j + i] = r[i];
  }
  if (group.joints == 1)
    solve_single(group, lam);
  else
    solve_dense<kRows>(&group.schur[0][0], 3 * group.joints, group.pivot_inverse, lam);
  for (int j = 0; j < group.joints; ++j) {
    Joint& joint = group.joint[j];
    const Vec own{{lam[3 * j], lam[3 * j + 1], lam[3 * j + 2]}};
    for (int side = 0; side < 2; ++side) {
      const int b = joint.bodies[side];
      y[b].w = y[b].w - times(joint.H[side], own);
      if (group.body[b].pinned) continue;
      const Vec push = group.body[b].mass_inverse * own;
      y[b].v = side ? y[b].v - push : y[b].v + push;
    }
    joint.lam[k] = own;
  }
}

void start(Group& group) {
  for (int b = 0; b < group.bodies; ++b) {
    Body& body = group.body[b];
    const LaneState<kWidth>& state = group.state[b];
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < 3; ++i) body.R[0].part[c][i] = state.R.part[c][i];
    body.w[0] = factors(state.u.w);
    body.R[1] = {};
    add_turned(body.R[1], body.R[0], body.w[0]);
    put_momentum(body.R[1], times(body.deviation, state.u.w) + body.spin);
    body.x[0] = body.pinned ? body.place : state.x;
    body.x[1] = body.pinned ? Vec{} : state.u.v;
  }
}

// Accelerations of order k, w of order k + 1, configurations of order k + 2.
void extend(Group& group, int k) {
  ColumnStack<Number, 4> R_turned[kMostLaneBodies];
  Twist y[kMostLaneBodies];
  for (int b = 0; b < group.bodies; ++b) {
    Body& body = group.body[b];
    R_turned[b] = lieeuler::turned(body.R, body.w, k);
    y[b].w = {{R_turned[b].part[0][3], R_turned[b].part[1][3], R_turned[b].part[2][3]}};
    y[b].v = body.pinned || k > 0 ? Vec{} : body.weight;
    if (body.pinned) y[b].w = y[b].w + cross(body.lever, transposed_times(body.R[k], group.gravity));
  }
  Vec rows[kMostLaneBodies];
  for (int j = 0; j < group.joints; ++j) {
    const Joint& joint = group.joint[j];
    const int p = joint.bodies[0], c = joint.bodies[1];
    const Vec& arm = joint.points[1];
    y[c].w = y[c].w + cross(Vec{{-arm[0], -arm[1], -arm[2]}}, transpose_times(group.body[c].R, joint.lam, 1, k));
    y[p].w = y[p].w + cross(joint.points[0], transpose_times(group.body[p].R, joint.lam, 1, k));
    rows[j] = all<Number>(-(k + 1)) * (times(R_turned[c], joint.points[1]) - times(R_turned[p], joint.points[0]));
  }
  for (int b = 0; b < group.bodies; ++b) {
    y[b].v = group.body[b].mass_inverse * y[b].v;
    y[b].w = times(group.body[b].inertia_inverse, y[b].w);
  }
  correct(group, y, rows, k);
  const double share = 1.0 / (k + 1), next_share = 1.0 / (k + 2);
  for (int b = 0; b < group.bodies; ++b) {
    Body& body = group.body[b];
    const Vec rate = all<Number>(share) * y[b].w;
    body.w[k + 1] = factors(rate);
    body.x[k + 2] = body.pinned ? Vec{} : all<Number>(share * next_share) * y[b].v;
    ColumnStack<Number, 4>& next = R_turned[b];
    add_turned(next, body.R[0], body.w[k + 1]);
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < 3; ++i) next.part[c][i] *= next_share;
    put_momentum(next, times(body.deviation, rate));
    body.R[k + 2] = next;
  }
}

// The step for which the last two terms of w, v and dR/dt are at most rtol times their size, as in TaylorStepper.
void choose_step(Group& group) {
  Number length = group.length, rate{}, square{}, sum{};
  for (int b = 0; b < group.bodies; ++b) length = larger(length, largest(group.state[b].x));
  for (int b = 0; b < group.bodies; ++b) {
    const Body& body = group.body[b];
    rate = larger(rate, larger(largest(group.state[b].u.v) / length, largest(group.state[b].u.w)));
    square = larger(square, larger(largest(all<Number>(2) * body.x[2]) / length, largest(vector(body.w[1]))));
  }
  rate = larger(rate, square_root(square));
  group.fine &= rate < kLarge && length < kLarge;
  group.step = group.remaining;
  for (int i = 0; i < 2; ++i) {
    const int k = group.order - 1 + i;
    Number most{};
    for (int b = 0; b < group.bodies; ++b) {
      const Body& body = group.body[b];
      const Vec w = vector(body.w[k]), v = (all<Number>(k + 1) / length) * body.x[k + 1];
      most = larger(most, larger(largest(w), largest(v)));
      for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) {
          const Number turn = (k + 1) * body.R[k + 1].part[c][r];
          most = larger(most, absolute(turn));
          sum += absolute(turn);
        }
      for (int r = 0; r < 3; ++r) sum += absolute(w[r]) + absolute(v[r]);
    }
    const Number step = root<Number, Registers<kWidth>::Bits>(group.rtol * rate / most, all<Number>(1.0 / k));
    group.step = most > 0 ? smaller(group.step, step) : group.step;
  }
  group.fine &= sum < kLarge;  // false for a NaN
}

void expand(Group& group) {
  group.fine = ~Mask{};
  factor(group);
  if (group.joints == 1) invert(group);
  if (group.joints > 1)
    group.fine &= factor_dense<kRows>(&group.schur[0][0], 3 * group.joints, group.pivot_inverse) >= kGraded;
  start(group);
  for (int k = 0; k < group.order; ++k) extend(group, k);
  choose_step(group);
}

// The state at `step`: attitudes are made rotations, and positions follow along the hinges.
void evaluate(Group& group, LaneState<kWidth>* out) {
  const Number h = group.step;
  for (int b = 0; b < group.bodies; ++b) {
    const Body& body = group.body[b];
    const ColumnStack<Number, 4> R = horner(body.R, group.order + 1, h);
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < 3; ++i) out[b].R.part[c][i] = R.part[c][i];
    out[b].u.w = vector(horner(body.w, group.order, h));
    orthogonalise(out[b].R);
    if (body.pinned) continue;
    out[b].x = horner(body.x, group.order + 1, h);
    out[b].u.v = all<Number>(group.order + 1) * body.x[group.order + 1];
    for (int k = group.order; k > 0; --k) out[b].u.v = h * out[b].u.v + all<Number>(k) * body.x[k];
  }
  for (int k = 0; k < group.hinges; ++k) {
    const LaneHinge<kWidth>& hinge = group.hinge[k];
    const LaneState<kWidth>& base = out[hinge.base];
    LaneState<kWidth>& body = out[hinge.body];
    body.x = base.x + times(base.R, hinge.base_anchor) - times(body.R, hinge.body_anchor);
    body.u.v = base.u.v + times(base.R, cross(base.u.w, hinge.base_anchor)) -
               times(body.R, cross(body.u.w, hinge.body_anchor));
  }
}

}  // namespace

const LaneCode<kWidth> LIEEULER_CODE{expand, evaluate};

}  // namespace lieeuler
