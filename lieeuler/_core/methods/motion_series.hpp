// Taylor coefficients of the motion, order by order, from the index-1 system: equation (12.1) of docs/theory.md.
#pragma once

#include "methods/contact_series.hpp"
#include "model/mimic.hpp"

namespace lieeuler {

class MotionSeries {
 public:
  MotionSeries(const Plan& plan, const ReferencePoints& points)
      : plan_(plan), system_(plan.system), points_(points), body_(system_, points) {
    force_.resize(system_.n() + 1);
    rows_.resize(plan.count());
    turned_.resize(system_.n() + 1);
    for (int b = 0; b < system_.n(); ++b) lever_.push_back(system_.bodies[b].mass * points.centre(b));
    parts_.reserve(plan.count());
    for (int k = 0; k < plan.count(); ++k)
      if (!points.holds(plan.parts[k])) plan_part(k);
    for (const Force& force : system_.forces) plan_force(force);
    has_others_ = !row_drives_.empty() || !contacts_.empty() || !plan.mimics.empty();
  }

  // Computes coefficients of order zero, and those of order one that do not depend on forces.
  void start(const State& state) {
    body_.start(state);
    for (CarriedSeries& z : carried_) z.extend(body_, 0), z.extend(body_, 1);
    for (SpringSeries& spring : springs_) spring.start();
    for (size_t k = 0; k < torsions_.size(); ++k) torsions_[k].start(state);
    for (DriveSeries& drive : drives_) drive.start(state.frames);
    for (ContactSeries& contact : contacts_) contact.start();
    for (RowDrive& drive : row_drives_) {
      drive.series.resize(kMostOrder + 3);
      drive.function->expand(state.frames, kMostOrder + 3, drive.series.data());
    }
  }

  // Computes accelerations and multipliers of orders below `order`, velocities up to it, configurations up to the next.
  // False if a force has no series.
#if defined(__x86_64__)
  template <class Solver>
  bool extend(int order, Solver& saddle) {
    return wide_ ? extend_wide(order, saddle) : extend_by(order, saddle);
  }
#else
  template <class Solver>
  [[gnu::flatten]] bool extend(int order, Solver& saddle) {
    return extend_by(order, saddle);
  }
#endif

  // Frames, u and torsion angles at time h from the centre of the series, with accelerations of orders below `order`.
  void evaluate(double h, int order, const HingeTree& tree, State& state) const {
    body_.evaluate(h, order, tree, state);
    for (const TorsionSeries& torsion : torsions_) torsion.evaluate(h, order, state);
  }
  const BodySeries& bodies() const { return body_; }

  struct Coefficient {
    Vec3 x;  // centre of mass
    Mat3 R;
    Vec3 w;
  };
  Coefficient coefficient(int body, int k) const {
    const Mat3 R = upper(body_.R[body][k]);
    return {vector(body_.x[body][k]) + R * points_.centre(body), R, vector(body_.w[body][k])};
  }

 private:
  template <class Solver>
  [[gnu::always_inline]] bool extend_by(int order, Solver& saddle) {
    for (int k = 0; k < order; ++k)
      if (!extend_one(k, saddle)) return false;
    return true;
  }
  template <class Solver>
  [[gnu::always_inline]] bool extend_one(int k, Solver& saddle) {
    for (int b = 0; b < system_.n(); ++b) {
      const Columns* const R = body_.R[b].data();
      turn(R, body_.w[b].data(), k, turned_[b]);
      force_[b].w = row(turned_[b], 3);
      force_[b].v.setZero();
      if (points_.pinned(b))
        force_[b].w += lever_[b].cross(seen_from(R[k], system_.gravity));
      else if (k == 0)
        force_[b].v = system_.bodies[b].mass * system_.gravity;
    }
    force_[system_.n()] = {};
    if (!system_.forces.empty() && !add_forces(k)) return false;
    for (PartSeries& part : parts_) part.begin(carried_, k);
    for (const Arm& arm : arms_) add_arm(arm, k);
    for (PartSeries& part : parts_) subtract_gamma(part, k);
    if (has_others_) begin_others(k);
    saddle.solve(force_, rows_, k < kLowOrders);
    for (int b = 0; b < system_.n(); ++b) body_.extend(b, k, turned_[b], force_[b]);
    for (PartSeries& part : parts_) part.finish(carried_, k, rows_[part.index]);
    if (has_others_)
      for (ContactSeries& contact : contacts_) contact.finish(k, rows_[contact.index]);
    for (CarriedSeries& z : carried_) z.extend(body_, k + 2);
    return true;
  }
#if defined(__x86_64__)
  template <class Solver>
  [[gnu::flatten, gnu::target("avx2")]] bool extend_wide(int order, Solver& saddle) {
    return extend_by(order, saddle);
  }
#endif

  static constexpr int kLowOrders = 5;  // errors of higher orders are multiplied by high powers of the step

  // The torque lever x R^T V of a force V in world axes at a point of a body, or of a vector V on an axis of the body.
  struct Arm {
    int body;
    Vec3 lever;  // times sign
    double sign;
    const Quad* force;
    bool acts_on_translation, starts_at_one;
  };

  void plan_part(int k) {
    const Joint& joint = plan_.joint(k);
    const Part& part = plan_.part(k);
    if (part.contact) return void(contacts_.emplace_back(joint, part, k, points_));
    parts_.emplace_back(joint, part, k, points_);
    PartSeries& series = parts_.back();
    if (part.drive) row_drives_.push_back({static_cast<int>(parts_.size()) - 1, &*part.drive, {}});
    if (part.turn) return;  // its rows and torques are constant in both bodies
    if (part.spherical) {
      add_arms(joint.parent, joint.child, joint.parent_anchor, joint.child_anchor, series.lam.data(), false, true);
      return;
    }
    for (int r = 0; r < part.rows(); ++r) {
      const DotRow& dot = part.dots[r];
      const int a = carried(joint, dot.a, dot.a_local), b = carried(joint, dot.b, dot.b_local);
      series.rows.push_back({a, b, dot.scale});
      plan_reaction(joint, series, dot.a, dot.a_local, r, b, dot.scale);
      plan_reaction(joint, series, dot.b, dot.b_local, r, a, dot.scale);
    }
  }
  // Plans the reaction on `on` of multiplier r times the other carried vector; reactions on one vector share a series.
  void plan_reaction(const Joint& joint, PartSeries& part, Carrier on, const Vec3& local, int r, int other,
                     double scale) {
    if (on != Carrier::difference && (on == Carrier::child_axis ? joint.child : joint.parent) == system_.n()) return;
    for (ReactionSeries& reaction : part.reactions)
      if (reaction.on == on && (on == Carrier::difference || reaction.local == local)) {
        reaction.terms.push_back({r, other, scale});
        return;
      }
    part.reactions.push_back({on, local, {{r, other, scale}}, std::vector<Quad>(kMostOrder + 3)});
    const Quad* const force = part.reactions.back().value.data();
    if (on == Carrier::difference)
      add_arms(joint.parent, joint.child, joint.parent_anchor, joint.child_anchor, force, true, false);
    else
      add_arm_of(on == Carrier::child_axis ? joint.child : joint.parent, local, -1, force, false, false);
  }
  void plan_force(const Force& force) {
    if (force.kind == Force::Kind::torsional_spring)
      torsions_.emplace_back(force, static_cast<int>(&force - system_.forces.data()));
    const bool pulls = force.kind == Force::Kind::linear_spring, pushes = force.kind == Force::Kind::slide_force;
    const Joint ends{force.parent, force.child, force.parent_point, force.child_point, {}};
    if (pulls) springs_.emplace_back(force, carried(ends, Carrier::difference, Vec3::Zero()));
    if (pushes) {
      const int axis = carried(ends, Carrier::parent_axis, force.axis);
      drives_.emplace_back(force, axis, carried(ends, Carrier::difference, Vec3::Zero()));
    }
    if (pulls || pushes)
      add_arms(force.parent, force.child, force.parent_point, force.child_point,
               pulls ? springs_.back().force.data() : drives_.back().force.data(), true, false);
    if (force.drive && !pushes) drives_.emplace_back(force, static_cast<int>(torsions_.size()) - 1);
  }
  // Adds a force V that pulls the anchors towards each other.
  void add_arms(int parent, int child, const Vec3& parent_anchor, const Vec3& child_anchor, const Quad* force,
                bool acts_on_translation, bool starts_at_one) {
    add_arm_of(child, points_.local(child, child_anchor), -1, force, acts_on_translation, starts_at_one);
    add_arm_of(parent, points_.local(parent, parent_anchor), 1, force, acts_on_translation, starts_at_one);
  }
  void add_arm_of(int body, const Vec3& local, double sign, const Quad* force, bool acts_on_translation,
                  bool starts_at_one) {
    if (body == system_.n()) return;
    arms_.push_back({body, sign * local, sign, force, acts_on_translation, starts_at_one});
  }
  int carried(const Joint& joint, Carrier carrier, const Vec3& local) {
    const CarriedSeries wanted(joint, carrier, local, points_);
    for (size_t k = 0; k < carried_.size(); ++k)
      if (carried_[k].same_as(wanted)) return static_cast<int>(k);
    carried_.push_back(wanted);
    return static_cast<int>(carried_.size()) - 1;
  }

  // Rows that only some systems have; one test for all of them keeps the others fast.
  [[gnu::noinline, gnu::cold]] void begin_others(int k) {
    for (const RowDrive& drive : row_drives_)
      rows_[parts_[drive.part].index][0] += (k + 1) * (k + 2) * drive.series[k + 2];
    for (ContactSeries& contact : contacts_) rows_[contact.index] = contact.begin(body_, k, force_[contact.body]);
    combine(plan_, rows_.data()->data());
  }
  bool add_forces(int k) {
    for (SpringSeries& spring : springs_)
      if (!spring.extend(carried_[spring.line].value.data(), k)) return false;
    for (TorsionSeries& torsion : torsions_) {
      const double torque = torsion.extend(body_, k);
      force_[torsion.force->parent].w += torque * torsion.force->axis;
      force_[torsion.force->child].w -= torque * torsion.seen;
    }
    for (const Force& force : system_.forces)
      if (force.kind == Force::Kind::load && !force.drive) add_load(force, body_.R[force.child][k], k == 0);
    for (DriveSeries& drive : drives_) add_drive(drive, k);
    return true;
  }
  void add_drive(DriveSeries& drive, int k) {
    const Force& force = *drive.given;
    switch (force.kind) {
      case Force::Kind::torsional_spring:
        force_[force.parent].w -= drive[k] * force.axis;
        force_[force.child].w += drive[k] * torsions_[drive.line].seen;
        break;
      case Force::Kind::load: {
        Columns R{};
        for (int j = 0; j <= k; ++j) add_scaled(R, drive[j], body_.R[force.child][k - j]);
        add_load(force, R, drive[k]);
        break;
      }
      default:
        drive.extend(carried_[drive.line].value.data(), carried_[drive.between].value.data(), k);
    }
  }
  // R and `factor` are this order of the attitude and of one, both times the load's factor.
  void add_load(const Force& load, const Columns& R, double factor) {
    Twist& target = force_[load.child];
    const Vec3 point = points_.local(load.child, load.child_point);
    if (load.in_world) {
      target.w += point.cross(seen_from(R, load.force)) + seen_from(R, load.torque);
      if (factor != 0) target.v += factor * load.force;
    } else {
      target.v += vector(times(R, load.force));
      if (factor != 0) target.w += factor * (point.cross(load.force) + load.torque);
    }
  }
  void add_arm(const Arm& arm, int k) {
    const Vec3 seen = transpose_times(body_.R[arm.body].data(), arm.force, arm.starts_at_one ? 1 : 0, k);
    force_[arm.body].w += arm.lever.cross(seen);
    if (arm.acts_on_translation) force_[arm.body].v += arm.sign * vector(arm.force[k]);
  }
  void subtract_gamma(PartSeries& series, int k) {
    Vec3& target = rows_[series.index];
    if (series.part->spherical) {
      const Vec3 gamma = vector(times(turned_[series.child], series.child_point)) -
                         vector(times(turned_[series.parent], series.parent_point));
      target = -(k + 1) * gamma;
      return;
    }
    target.setZero();
    for (const PartSeries::Row& row : series.rows)
      for (int z : {row.a, row.b})
        if (!carried_[z].constant()) carried_[z].guess(turned_, k);
    for (size_t r = 0; r < series.rows.size(); ++r) {
      const PartSeries::Row& row = series.rows[r];
      const CarriedSeries &a = carried_[row.a], &b = carried_[row.b];
      const int first_a = b.constant() ? k + 2 : 0, first_b = a.constant() ? k + 2 : 0;  // if not zero the only one
      const double product = dot(a.value.data() + first_a, b.value.data() + first_b, k + 2 - first_a - first_b);
      target[r] = -(k + 1) * (k + 2) * row.scale * product;
    }
  }
  // A^T a of the upper rows
  static Vec3 seen_from(const Columns& A, const Vec3& a) {
    Vec3 y;
    for (int c = 0; c < 3; ++c) y[c] = A(0, c) * a[0] + A(1, c) * a[1] + A(2, c) * a[2];
    return y;
  }

  const Plan& plan_;
  const System& system_;
  const ReferencePoints& points_;
  BodySeries body_;
  std::vector<Vec3> lever_;      // mass times centre of mass, for the torque of gravity about a pin
  std::vector<Columns> turned_;  // R hat(w) of this order; zero for the ground
  std::vector<CarriedSeries> carried_;
  std::vector<PartSeries> parts_;
  std::vector<SpringSeries> springs_;
  std::vector<TorsionSeries> torsions_;
  std::vector<DriveSeries> drives_;
  std::vector<ContactSeries> contacts_;
  struct RowDrive {
    int part;
    const TimeFunction* function;
    std::vector<double> series;
  };
  std::vector<RowDrive> row_drives_;
  bool has_others_ = false;  // driven rows, contacts or mimics
#if defined(__x86_64__)
  const bool wide_ = __builtin_cpu_supports("avx2");
#endif
  std::vector<Arm> arms_;
  std::vector<Twist> force_;  // in: forces of this order; out: accelerations
  std::vector<Vec3> rows_;    // by part; in: -gamma; out: multipliers
};

}  // namespace lieeuler
