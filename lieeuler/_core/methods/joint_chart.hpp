// The chart of states of a tree in the coordinates of its joints, by articulated bodies: equations (16.5) and (16.6) of
// docs/theory.md. Multipliers stay zero: the caller computes those of the samples.
//
// Twelve numbers of y belong to each node: a slide takes the first of x and v, a hinge the first of theta and w, a ball
// theta and w.
#pragma once

#include "methods/body_chart.hpp"
#include "methods/method.hpp"

namespace lieeuler {

class JointChart {
 public:
  struct Point : State {
    std::vector<Mat3> turn;          // of a hinge: attitude of its link relative to the parent's
    std::vector<double> q, rate;     // of slides; of hinges and slides
    std::vector<Vec3> acceleration;  // of a ball in the body, else the first number
    using State::State;
  };

  JointChart(const Plan& plan, const std::vector<JointNode>& nodes)
      : system_(plan.system),
        joints_(plan.system),
        most_turn_(most_turn(system_, 2 * std::numbers::pi)),
        force_(system_.n() + 1) {
    std::vector<Vec3> anchor(system_.n() + 1, Vec3::Zero());  // of each body's joint towards the ground
    for (const JointNode& node : nodes)
      if (node.last) anchor[system_.joints[node.joint].child] = system_.joints[node.joint].child_anchor;
    for (const JointNode& node : nodes) {
      const Joint& joint = system_.joints[node.joint];
      Link link{node};
      link.child = joint.child;
      if (node.parent < 0 || nodes[node.parent].joint != node.joint)
        link.offset = joint.parent_anchor - anchor[joint.parent];
      if (node.kind == JointNode::Kind::hinge) {
        link.turns = hat(node.axis), link.bends = link.turns * link.turns;
      }
      if (node.last) {
        const Body& body = system_.bodies[joint.child];
        link.mass = body.mass, link.centre = -joint.child_anchor;
        link.inertia = body.inertia + body.mass * (link.centre.squaredNorm() * Mat3::Identity() -
                                                   link.centre * link.centre.transpose());
      }
      links_.push_back(link);
    }
  }

  Point make() const {
    Point point(system_);
    point.turn.resize(links_.size(), Mat3::Identity());
    point.q.resize(links_.size()), point.rate.resize(links_.size());
    point.acceleration.resize(links_.size(), Vec3::Zero());
    return point;
  }
  int blocks() const { return static_cast<int>(links_.size()); }

  // A run that changes its step starts again from the point where it is.
  Status start(const State& given, Point& point, double length, Counters& counters) {
    if (started_) return Status::success;
    started_ = true;
    static_cast<State&>(point) = given;
    update_angles(system_, point.frames, point.u, point.angles);
    measure(given, point);
    const std::vector<double> still(12 * links_.size(), 0.0);
    std::vector<double> out(still);
    if (!configure(still.data(), Point(point), point, out.data())) return Status::map_domain;
    return settle(point, length, counters);
  }

  void renew() { started_ = false; }

  bool configure(const double* y, const Point& base, Point& point, double* out) {
    for (size_t i = 0; i < links_.size(); ++i, y += 12, out += 12) {
      Link& link = links_[i];
      const Mat3& up = attitude(link.node.parent);
      link.d = link.node.parent < 0 ? link.offset : Vec3(times(up, link.offset));
      switch (link.node.kind) {
        case JointNode::Kind::ball: {
          const Vec3 w = base.u[link.child].w + load3(y + 9);
          if (!turn_by(load3(y + 3), base.frames[link.child].R, most_turn_, w, link.R, out + 3)) return false;
          link.w = times(link.R, w);
          break;
        }
        case JointNode::Kind::hinge: {
          if (!(std::abs(y[3]) < most_turn_)) return false;
          out[3] = point.rate[i] = base.rate[i] + y[9];
          const Mat3 turned = Mat3::Identity() + std::sin(y[3]) * link.turns + (1 - std::cos(y[3])) * link.bends;
          point.turn[i].noalias() = base.turn[i] * turned;
          link.R.noalias() = up * point.turn[i];
          link.axis = times(link.R, link.node.axis);
          link.w = rate(link.node.parent) + point.rate[i] * link.axis;
          break;
        }
        case JointNode::Kind::slide:
          point.q[i] = base.q[i] + y[0];
          out[0] = point.rate[i] = base.rate[i] + y[6];
          link.axis = times(up, link.node.axis);
          link.d += point.q[i] * link.axis;
          link.R.noalias() = up * link.node.turn;
          link.w = rate(link.node.parent);
      }
      const Vec3& swing = rate(link.node.parent);
      link.p = place(link.node.parent) + link.d;
      link.v = velocity(link.node.parent) + swing.cross(link.d);
      link.bent = swing.cross(swing.cross(link.d));
      link.turned.setZero();
      if (link.node.kind == JointNode::Kind::hinge) link.turned = point.rate[i] * swing.cross(link.axis);
      if (link.node.kind == JointNode::Kind::slide)
        link.v += point.rate[i] * link.axis, link.bent += 2 * point.rate[i] * swing.cross(link.axis);
      if (link.node.last) show(link, point);
    }
    return true;
  }
  void put_rates(const Point& point, double* out) const {
    for (size_t i = 0; i < links_.size(); ++i, out += 12) {
      if (links_[i].node.kind == JointNode::Kind::ball)
        store(point.u[links_[i].child].w, out + 3);
      else
        out[links_[i].node.kind == JointNode::Kind::hinge ? 3 : 0] = point.rate[i];
    }
  }
  void put_accelerations(const Point& point, double* out) const {
    for (size_t i = 0; i < links_.size(); ++i, out += 12) {
      if (links_[i].node.kind == JointNode::Kind::ball)
        store(point.acceleration[i], out + 9);
      else
        out[links_[i].node.kind == JointNode::Kind::hinge ? 9 : 6] = point.acceleration[i][0];
    }
  }

  // Of the point configured last.
  Status accelerate(Point& point) {
    generalized_forces(system_, point.frames, point.u, point.angles, force_);
    for (Link& link : links_) load(link);
    for (size_t i = links_.size(); i-- > 0;)
      if (!eliminate(links_[i])) return Status::singular_matrix;
    for (size_t i = 0; i < links_.size(); ++i) point.acceleration[i] = solve(links_[i]);
    return Status::success;
  }
  Status settle(Point& point, double, Counters& counters) {
    update_angles(system_, point.frames, point.u, point.angles);
    ++counters.force_evaluations;
    if (const Status status = accelerate(point); status != Status::success) return status;
    for (size_t i = 0; i < links_.size(); ++i) {
      const Link& link = links_[i];
      if (link.node.last) point.a[link.child] = acceleration(link);
      polish(link.node.kind == JointNode::Kind::ball ? point.frames[link.child].R : point.turn[i]);
    }
    return Status::success;
  }
  void return_to(const Point&) {}
  const State& state(const Point& point) const { return point; }
  const State& whole(const Point& point) {
    joints_.update(point.frames);
    return point;
  }

  Status confirm_rank() { return Status::success; }
  const Constraints& joints() const { return joints_; }
  int redundant_rows() const { return 0; }
  double smallest_pivot() const { return 1; }

 private:
  // A node with the link that it carries, in world axes, about the point p of the link.
  struct Link {
    JointNode node;
    int child = 0;  // body of the joint
    double mass = 0;
    Vec3 offset = Vec3::Zero();                       // of p from the parent's point, in the parent's link
    Vec3 centre = Vec3::Zero();                       // of mass from p, in the link
    Mat3 inertia = Mat3::Zero();                      // about p, in the link
    Mat3 turns = Mat3::Zero(), bends = Mat3::Zero();  // factors of sin and 1 - cos of its turn in a step
    Mat3 R = Mat3::Identity();
    Vec3 p = Vec3::Zero(), d = Vec3::Zero();  // p and its distance from the parent's point
    Vec3 v = Vec3::Zero(), w = Vec3::Zero();  // of p, of the link
    Vec3 axis = Vec3::Zero();
    Vec3 bent = Vec3::Zero(), turned = Vec3::Zero();  // accelerations of p and of the link without q''
    // Moment A alpha + B a + N and force B^T alpha + C a + F that its parent exerts, of the link and all behind it.
    Mat3 A = Mat3::Zero(), B = Mat3::Zero(), C = Mat3::Zero();
    Vec3 N = Vec3::Zero(), F = Vec3::Zero();
    Vec3 along = Vec3::Zero(), aside = Vec3::Zero();  // (A a; B^T a) of a hinge, (B a; C a) of a slide
    double share = 0, drive = 0;                      // 1 / D and the generalized force
    Vec3 alpha = Vec3::Zero(), a = Vec3::Zero();
  };

  const Mat3& attitude(int node) const { return node < 0 ? ground_.R : links_[node].R; }
  const Vec3& place(int node) const { return node < 0 ? ground_.p : links_[node].p; }
  const Vec3& rate(int node) const { return node < 0 ? ground_.w : links_[node].w; }
  const Vec3& velocity(int node) const { return node < 0 ? ground_.v : links_[node].v; }

  void show(const Link& link, Point& point) const {
    const Vec3 centre = times(link.R, link.centre);
    point.frames[link.child].R = link.R;
    point.frames[link.child].x = link.p + centre;
    point.u[link.child].w = transposed_times(link.R, link.w);
    point.u[link.child].v = link.v + link.w.cross(centre);
  }

  // Inertia and forces of the link alone.
  void load(Link& link) const {
    if (!link.node.last) {
      link.A.setZero(), link.B.setZero(), link.C.setZero(), link.N.setZero(), link.F.setZero();
      return;
    }
    const Vec3 centre = times(link.R, link.centre);
    const Twist& f = force_[link.child];
    Mat3 half;
    half.noalias() = link.R * link.inertia;
    link.A.noalias() = half * link.R.transpose();
    link.B = hat(Vec3(link.mass * centre));
    link.C = link.mass * Mat3::Identity();
    link.F = link.mass * link.w.cross(link.w.cross(centre)) - f.v;
    link.N = centre.cross(link.F) - times(link.R, f.w);
  }
  // Eliminates the coordinates of the node, and adds what is left to the parent.
  bool eliminate(Link& link) {
    const bool grounded = link.node.parent < 0;
    if (link.node.kind == JointNode::Kind::ball) {
      link.A = Mat3(link.A.inverse());
      if (!link.A.allFinite()) return false;
      if (grounded) return true;
      const Mat3 K = link.A * link.B;
      const Mat3 C = link.C - link.B.transpose() * K;
      const Vec3 F = link.F - K.transpose() * link.N + C * link.bent;
      return hang(links_[link.node.parent], link.d, C, F), true;
    }
    const bool turns = link.node.kind == JointNode::Kind::hinge;
    link.along.noalias() = (turns ? link.A : link.B) * link.axis;
    if (turns)
      link.aside.noalias() = link.B.transpose() * link.axis;
    else
      link.aside.noalias() = link.C * link.axis;
    const double D = link.axis.dot(turns ? link.along : link.aside) + link.node.armature;
    if (!(D > 0)) return false;
    link.share = 1 / D, link.drive = -link.axis.dot(turns ? link.N : link.F);
    if (grounded) return true;
    const Vec3 along = link.share * link.along, aside = link.share * link.aside;
    const Mat3 A = link.A - along * link.along.transpose(), B = link.B - along * link.aside.transpose(),
               C = link.C - aside * link.aside.transpose();
    const Vec3 N = link.N + A * link.turned + B * link.bent + link.drive * along;
    const Vec3 F = link.F + B.transpose() * link.turned + C * link.bent + link.drive * aside;
    return hang(links_[link.node.parent], link.d, A, B, C, N, F), true;
  }
  // hat(d) times the transpose of M.
  static Mat3 crossed(const Vec3& d, const Mat3& M) {
    Mat3 all;
    for (int i = 0; i < 3; ++i) all.col(i) = d.cross(Vec3(M.row(i)));
    return all;
  }
  // Adds an inertia and forces about a point at d from that of the link. C is symmetric.
  static void hang(Link& link, const Vec3& d, const Mat3& C, const Vec3& F) {
    const Mat3 lever = crossed(d, C);
    link.A += crossed(d, lever);
    link.B += lever;
    link.C += C;
    link.N += d.cross(F);
    link.F += F;
  }
  static void hang(Link& link, const Vec3& d, const Mat3& A, const Mat3& B, const Mat3& C, const Vec3& N,
                   const Vec3& F) {
    hang(link, d, C, F);
    const Mat3 swept = crossed(d, B);
    link.A += A + swept + swept.transpose();
    link.B += B;
    link.N += N;
  }
  // Accelerations of the link from those of its parent; returns those of the coordinates.
  Vec3 solve(Link& link) {
    const Link& up = link.node.parent < 0 ? ground_ : links_[link.node.parent];
    link.a = up.a + up.alpha.cross(link.d) + link.bent;
    link.alpha = up.alpha + link.turned;
    if (link.node.kind == JointNode::Kind::ball) {
      link.alpha = -(link.A * (link.N + link.B * link.a));
      return transposed_times(link.R, link.alpha);
    }
    const double q = link.share * (link.drive - link.along.dot(link.alpha) - link.aside.dot(link.a));
    (link.node.kind == JointNode::Kind::hinge ? link.alpha : link.a) += q * link.axis;
    return {q, 0, 0};
  }

  // Of the body that the link carries.
  static Twist acceleration(const Link& link) {
    const Vec3 centre = times(link.R, link.centre);
    return {link.a + link.alpha.cross(centre) + link.w.cross(link.w.cross(centre)),
            transposed_times(link.R, link.alpha)};
  }

  // The coordinates and rates at the start of a run, where the angles of hinges are zero.
  void measure(const State& given, Point& point) const {
    for (size_t i = 0; i < links_.size(); ++i) {
      const Link& link = links_[i];
      const Joint& joint = system_.joints[link.node.joint];
      const Frame &up = given.frames[joint.parent], &down = given.frames[joint.child];
      const Twist &u = given.u[joint.parent], &below = given.u[joint.child];
      const Vec3 w = up.R * u.w, turning = down.R * below.w;
      if (link.node.kind == JointNode::Kind::slide) {
        const Vec3 axis = up.R * link.node.axis, s = down.R * joint.child_anchor, to = down.x + s;
        point.q[i] = axis.dot(to - up.x - up.R * joint.parent_anchor);
        point.rate[i] = axis.dot(below.v + turning.cross(s) - u.v - w.cross(to - up.x));
      } else if (link.node.kind == JointNode::Kind::hinge) {
        const Vec3 axis = hinge(i, given);
        Vec3 alone = axis;  // its part normal to the joint's other hinge
        for (size_t k : {i - 1, i + 1})
          if (k < links_.size() && links_[k].node.joint == link.node.joint &&
              links_[k].node.kind == JointNode::Kind::hinge)
            alone -= axis.dot(hinge(k, given)) * hinge(k, given);
        point.turn[i] = link.node.turn, point.rate[i] = alone.dot(turning - w) / alone.dot(axis);
      }
    }
  }
  Vec3 hinge(size_t i, const State& given) const {
    const JointNode& node = links_[i].node;
    if (node.last) return given.frames[system_.joints[node.joint].child].R * node.axis;
    return given.frames[system_.joints[node.joint].parent].R * (node.turn * node.axis);
  }

  const System& system_;
  Constraints joints_;
  bool started_ = false;
  const double most_turn_;
  std::vector<Twist> force_;
  std::vector<Link> links_;
  const Link ground_{};
};

}  // namespace lieeuler
