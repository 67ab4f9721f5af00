// Series of the terms of a motion, (12.1) of docs/theory.md: bodies, carried vectors, reactions, springs.
#pragma once

#include "linalg/series.hpp"
#include "model/reference_points.hpp"

namespace lieeuler {

inline constexpr int kMostOrder = 40;

// Attitudes, angular velocities, and positions of the reference points of all bodies; last the ground, at rest.
class BodySeries {
 public:
  // R: its fourth row of order j + 1 is order j of the angular momentum about the reference point in body axes, minus a
  // multiple of w that has no effect on the torque (see deviation).
  std::vector<std::vector<Columns>> R;
  std::vector<std::vector<Doubled>> w;
  std::vector<std::vector<Quad>> x;

  BodySeries(const System& system, const ReferencePoints& points)
      : R(system.n() + 1, std::vector<Columns>(kMostOrder + 3)),
        w(system.n() + 1, std::vector<Doubled>(kMostOrder + 3)),
        x(system.n() + 1, std::vector<Quad>(kMostOrder + 3)),
        system_(system),
        points_(points) {
    put_upper(R.back()[0], Mat3::Identity());
    for (int b = 0; b < system.n(); ++b) inertia_.push_back(points.deviation(b));
  }

  void start(const State& state) {
    for (int b = 0; b < system_.n(); ++b) {
      const Vec3& rate = state.u[b].w;
      put_upper(R[b][0], state.frames[b].R);
      w[b][0] = doubled(rate);
      R[b][1] = {};
      add_turned(R[b][1], R[b][0], w[b][0]);
      put_momentum(R[b][1], times(inertia_[b], rate) + system_.bodies[b].spin);
      x[b][0] = quad(points_.position(b, state)), x[b][1] = quad(points_.velocity(b, state));
    }
  }

  // `turned` is order k + 1 of R hat(w) without the term with wdot.
  void extend(int b, int k, const Columns& turned, const Twist& acceleration) {
    const double share = 1.0 / (k + 1), next_share = 1.0 / (k + 2);
    const Vec3 rate = share * acceleration.w;
    w[b][k + 1] = doubled(rate);
    if (!points_.pinned(b)) x[b][k + 2] = quad(share * next_share * acceleration.v);
    Columns next = turned;
    add_turned(next, R[b][0], w[b][k + 1]);
    const Pair shrink = both(next_share);
    for (auto& column : next.part) column[0] *= shrink, column[1] *= shrink;
    put_momentum(next, times(inertia_[b], rate));
    R[b][k + 2] = next;
  }

  // Leaves out positions that follow from `tree` because it has all constraints.
  void evaluate(double h, int order, const HingeTree& tree, State& state) const {
    for (int b = 0; b < system_.n(); ++b) {
      Frame& frame = state.frames[b];
      Twist& u = state.u[b];
      frame.R = upper(lieeuler::evaluate(R[b].data(), order + 1, h));
      u.w = vector(lieeuler::evaluate(w[b].data(), order, h));
      if (tree.complete && tree.hangs[b]) continue;
      const Vec3& c = points_.centre(b);
      Vec3 v = (order + 1) * vector(x[b][order + 1]);
      for (int k = order; k > 0; --k) v = h * v + k * vector(x[b][k]);
      frame.x = vector(lieeuler::evaluate(x[b].data(), order + 1, h)) + frame.R * c;
      u.v = v + frame.R * u.w.cross(c);
    }
  }

 private:
  static void put_momentum(Columns& A, const Vec3& L) {
    for (int c = 0; c < 3; ++c) A.part[c][1][1] = L[c];
  }
  const System& system_;
  const ReferencePoints& points_;
  std::vector<Mat3> inertia_;
};

// The series of a carried vector (see Carrier).
class CarriedSeries {
 public:
  std::vector<Quad> value;

  CarriedSeries(const Joint& joint, Carrier carrier, const Vec3& local, const ReferencePoints& points)
      : value(kMostOrder + 3), carrier_(carrier) {
    const int on = carrier == Carrier::child_axis ? joint.child : joint.parent;
    constant_ = carrier != Carrier::difference && on == points.ground();
    if (carrier == Carrier::difference)
      ends_[kParent] = {joint.parent, points.local(joint.parent, joint.parent_anchor)},
      ends_[kChild] = {joint.child, points.local(joint.child, joint.child_anchor)};
    else
      ends_[kChild] = {on, local};
  }
  // An axis of the ground, of which only order zero is not zero.
  bool constant() const { return constant_; }
  bool same_as(const CarriedSeries& other) const {
    for (Side side : kSides)
      if (ends_[side].body != other.ends_[side].body || ends_[side].local != other.ends_[side].local) return false;
    return (carrier_ == Carrier::difference) == (other.carrier_ == Carrier::difference);
  }

  void extend(const BodySeries& bodies, int k) {
    if (constant_ && k > 0) return;
    const End &child = ends_[kChild], &parent = ends_[kParent];
    Quad sum = times(bodies.R[child.body][k], child.local);
    if (carrier_ == Carrier::difference) {
      const Quad back = times(bodies.R[parent.body][k], parent.local);
      for (int i = 0; i < 2; ++i)
        sum.part[i] += bodies.x[child.body][k].part[i] - bodies.x[parent.body][k].part[i] - back.part[i];
    }
    put(value[k], sum);
  }
  // Order k + 2 without the accelerations of order k, which are not known yet.
  void guess(const std::vector<Columns>& turned, int k) {
    const End &child = ends_[kChild], &parent = ends_[kParent];
    Quad sum = times(turned[child.body], child.local);
    if (carrier_ == Carrier::difference) {
      const Quad back = times(turned[parent.body], parent.local);
      for (int i = 0; i < 2; ++i) sum.part[i] -= back.part[i];
    }
    const Pair shrink = both(1.0 / (k + 2));
    for (Pair& part : sum.part) part *= shrink;
    put(value[k + 2], sum);
  }

 private:
  struct End {
    int body = 0;
    Vec3 local = Vec3::Zero();
  };
  Carrier carrier_;
  bool constant_ = false;
  End ends_[2];
};

// The reaction on one carried vector: the sum of multipliers times other carried vectors.
struct ReactionSeries {
  struct Term {
    int row, other;
    double scale;
  };
  Carrier on;
  Vec3 local;
  std::vector<Term> terms;
  std::vector<Quad> value;
};

// The multipliers of a part and, for dot rows, their reactions.
class PartSeries {
 public:
  struct Row {
    int a, b;
    double scale;
  };
  const Part* part;
  int index;  // among all parts
  int parent, child;
  Vec3 parent_point, child_point;  // anchors, from the reference points
  std::vector<Row> rows;
  std::vector<ReactionSeries> reactions;
  std::vector<Quad> lam;

  PartSeries(const Joint& joint, const Part& part, int index, const ReferencePoints& points)
      : part(&part),
        index(index),
        parent(joint.parent),
        child(joint.child),
        parent_point(points.local(parent, joint.parent_anchor)),
        child_point(points.local(child, joint.child_anchor)),
        lam(kMostOrder + 3) {}

  // Order k of the reactions without lam_k.
  void begin(const std::vector<CarriedSeries>& carried, int k) {
    for (ReactionSeries& reaction : reactions) {
      Quad total{};
      for (const ReactionSeries::Term& term : reaction.terms) {
        const CarriedSeries& other = carried[term.other];
        if (!other.constant()) add_scaled(total, term.scale, component(term.row), other.value.data(), k, k);
      }
      put(reaction.value[k], total);
    }
  }
  void finish(const std::vector<CarriedSeries>& carried, int k, const Vec3& multipliers) {
    lam[k] = quad(multipliers);
    for (ReactionSeries& reaction : reactions) {
      Quad total = reaction.value[k];
      for (const ReactionSeries::Term& term : reaction.terms) {
        const Pair factor = both(term.scale * multipliers[term.row]);
        const Quad& other = carried[term.other].value[0];
        for (int i = 0; i < 2; ++i) total.part[i] += factor * other.part[i];
      }
      put(reaction.value[k], total);
    }
  }

 private:
  const double* component(int row) const { return reinterpret_cast<const double*>(lam.data()) + row; }
};

// Linear spring-damper: pulls the ends of d together by  e d,  e = (stiffness (L - rest) + damping dL/dt) / L,
// L^2 = d . d.
class SpringSeries {
 public:
  const Force* spring;
  int line;  // d among the carried vectors
  std::vector<Quad> force;

  SpringSeries(const Force& spring, int line)
      : spring(&spring), line(line), force(kMostOrder + 3), length_(kMostOrder + 3), ratio_(4 * (kMostOrder + 3)) {}

  void start() { known_ = 0; }

  // Order k of the force; false if the length is zero, where the force has no series.
  bool extend(const Quad* d, int k) {
    double& ratio = ratio_[4 * k];
    if (spring->rest == 0 && spring->damping == 0) {
      ratio = k == 0 ? spring->stiffness : 0;  // linear in d: smooth through length zero
    } else {
      for (; known_ <= k + 1; ++known_)
        if (!extend_length(d, known_)) return false;
      ratio =
          spring->stiffness * (length_[k] - (k == 0 ? spring->rest : 0)) + spring->damping * (k + 1) * length_[k + 1];
      for (int j = 1; j <= k; ++j) ratio -= length_[j] * ratio_[4 * (k - j)];
      ratio /= length_[0];
    }
    Quad total{};
    add_scaled(total, 1, ratio_.data(), d, k + 1, k);
    put(force[k], total);
    return true;
  }

 private:
  bool extend_length(const Quad* d, int k) {
    double square = dot(d, d, k);
    if (k == 0) {
      length_[0] = std::sqrt(square);
      return length_[0] > 0;
    }
    for (int j = 1; j < k; ++j) square -= length_[j] * length_[k - j];
    length_[k] = square / (2 * length_[0]);
    return true;
  }

  int known_ = 0;
  std::vector<double> length_, ratio_;  // ratio_ in strides of four, as add_scaled takes it
};

// Torsional spring-damper. Its axis is constant in both bodies, because the joint keeps it so.
class TorsionSeries {
 public:
  const Force* force;
  Vec3 seen = Vec3::Zero();  // the axis in the child

  TorsionSeries(const Force& force, int index) : force(&force), index_(index), angle_(kMostOrder + 3) {}

  void start(const State& state) {
    seen = state.frames[force->child].R.transpose() * (state.frames[force->parent].R * force->axis);
    angle_[0] = state.angles[index_];
  }
  // Order k of the restoring torque on the child.
  double extend(const BodySeries& bodies, int k) {
    const double rate =
        seen.dot(vector(bodies.w[force->child][k])) - force->axis.dot(vector(bodies.w[force->parent][k]));
    angle_[k + 1] = rate / (k + 1);
    return force->stiffness * (angle_[k] - (k == 0 ? force->rest : 0)) + force->damping * rate;
  }
  void evaluate(double h, int order, State& state) const {
    double angle = angle_[order];
    for (int k = order - 1; k >= 0; --k) angle = h * angle + angle_[k];
    state.angles[index_] = angle;
  }

 private:
  int index_;
  std::vector<double> angle_;
};

// The function of time in a force; of a slide force also its spring and damper, and the force that pulls the anchors
// towards each other. The slide is axis . d, with d from anchor to anchor.
class DriveSeries {
 public:
  const Force* given;
  int line;          // index of the axis among the carried vectors, or of the spring among the torsional ones
  int between = -1;  // index of d among the carried vectors
  std::vector<Quad> force;

  DriveSeries(const Force& given, int line, int between = -1)
      : given(&given), line(line), between(between), force(kMostOrder + 3), drive_(4 * (kMostOrder + 3)) {}

  void start(const Moment& at) {
    given->drive->expand(at, kMostOrder + 3, drive_.data());
    for (int k = kMostOrder + 2; k > 0; --k) drive_[4 * k] = drive_[k];
  }
  double operator[](int k) const { return drive_[4 * k]; }
  void extend(const Quad* axis, const Quad* d, int k) {
    const double slide = given->stiffness == 0 ? 0 : dot(axis, d, k) - (k == 0 ? given->rest : 0);
    drive_[4 * k] -= given->stiffness * slide;
    if (given->damping != 0) drive_[4 * k] -= given->damping * (k + 1) * dot(axis, d, k + 1);
    Quad total{};
    add_scaled(total, -1, drive_.data(), axis, k + 1, k);
    put(force[k], total);
  }

 private:
  std::vector<double> drive_;  // in strides of four, as add_scaled takes it
};

}  // namespace lieeuler
