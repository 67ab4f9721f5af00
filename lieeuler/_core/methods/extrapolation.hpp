// Extrapolation of DAE1L_LSE to step size zero, with order and step control: the table (11.1) and the
// filtered velocities (11.2) of docs/theory.md. The table is formed in y = (x, log(R_n^T R), v, w); the step ends with
// one projection onto Phi = 0 and G u = 0.
#pragma once

#include <array>

#include "methods/euler_lagrange.hpp"
#include "run/adaptive_steps.hpp"

namespace lieeuler {

// Stabilised Euler steps whose u and xi are relative to a start, and whose motion since then is summed separately from
// the state, so that rounding errors are relative to the motion.
class IncrementEquations : public StabilisedEquations {
 public:
  explicit IncrementEquations(const Plan& plan)
      : StabilisedEquations(plan, CoordinateMap::exp, false, Correction::mass) {}

  // For steps of any length from here: the matrix that long ones of damped springs need is laid out before the first.
  void take_long_steps(const State& state) {
    if (!splits() || !damped || system.frequency == 0) return;
    joints.update(state.frames);
    take_whole_matrix(joints);
  }
  // Replaces a change of the velocities by what remains of it after an implicit step with the matrix factored last:
  // stiff forces make it decay within the step. False if the solve fails.
  bool filter(std::vector<Twist>& change) {
    std::fill(filtered_.begin(), filtered_.end(), 0.0);
    for (int b = 0; b < system.n(); ++b) store(momentum(system.bodies[b], change[b]), &filtered_[3 * nodes.v(b)]);
    for (int k : plan.rotors) filtered_[3 * nodes.lam(k)] = joints.velocity(plan.parts[k], change)[0];
    if (!solve_linear(filtered_)) return false;
    for (int b = 0; b < system.n(); ++b) change[b] = load(&filtered_[3 * nodes.v(b)]);
    return true;
  }

  Status begin() override {
    std::fill(ways.begin(), ways.end(), Vec3::Zero()), std::fill(turns.begin(), turns.end(), Mat3::Zero());
    std::fill(gains.begin(), gains.end(), Twist{});
    origin_ = state;
    return StabilisedEquations::begin();
  }
  void guess() override {
    StabilisedEquations::guess();
    for (int b = 0; b < system.n(); ++b) store(gains[b], &z[3 * nodes.v(b)]), store(gains[b], &z[3 * nodes.xi_v(b)]);
  }

  // Of every body since the start: x, R^T R' - I and u.
  std::vector<Vec3> ways = std::vector<Vec3>(system.n());
  std::vector<Mat3> turns = std::vector<Mat3>(system.n());
  std::vector<Twist> gains = xi;

 protected:
  const std::vector<Twist>& from() const override { return gains; }
  bool configure() override {
    for (int b = 0; b < system.n(); ++b) {
      state.u[b] = origin_.u[b] + load(&z[3 * nodes.v(b)]), xi[b] = origin_.u[b] + load(&z[3 * nodes.xi_v(b)]);
      if (!move(b)) return false;
    }
    return true;
  }
  void settle() override {
    for (int b = 0; b < system.n(); ++b) {
      const Frame& origin = origin_.frames[b];
      const Mat3 turn = maps[b].turn();
      ways[b] += h * xi[b].v;
      turns[b] += turn + turns[b] * turn;
      gains[b] = load(&z[3 * nodes.v(b)]);
      state.frames[b] = {origin.x + ways[b], origin.R + origin.R * turns[b]};
    }
    StabilisedEquations::settle();
  }

 private:
  State origin_{system};
  std::vector<double> filtered_ = z;
};

class Extrapolation {
 public:
  explicit Extrapolation(const Plan& plan) : system_(plan.system), euler_(plan), whole_(plan), projection_(plan) {
    for (auto* euler : {&euler_, &whole_}) euler->polish_velocities();  // extrapolation magnifies errors
    for (std::vector<double>& entry : table_) entry.assign(size_, 0.0);
    for (Node& node : nodes_) node.y.assign(size_ / 2, 0.0);
  }

  Status start(const State& initial, double rtol, double slowest, Counters& counters) {
    rtol_ = rtol, slowest_ = slowest;
    state_ = initial;
    update_angles(system_, state_.frames, state_.u, state_.angles);
    if (const Status status = projection_.start(state_); status != Status::success) return status;
    for (auto* euler : {&euler_, &whole_}) euler->equations().take_long_steps(state_);
    scales_ = Scales::of(system_, state_, slowest_);
    if (const Status status = projection_.settle(state_, scales_.length, counters); status != Status::success)
      return status;
    for (most_rows_ = 4; most_rows_ < kMostRows && magnification(most_rows_ + 1) < kRounding * rtol; ++most_rows_) {
    }
    step_ = 1e-2 / scales_.rate;  // step control corrects it in the first steps
    target_ = std::clamp(static_cast<int>(2 - 0.5 * std::log10(rtol)), 3, most_rows_ - 1);
    return Status::success;
  }

  double proposed() const { return std::min(step_, longest_step()); }

  Status attempt(double h, bool& stands, Counters& counters, Watch& watch) {
    if (const Status status = fill_rows(h, stands, counters, watch); status != Status::success || !stands)
      return status;
    extrapolate(state_, next_);
    next_.frames.follow(state_.frames, h);
    return projection_.project(next_, scales_.length, counters);
  }

  void refuse(double h, Status status) {
    refused_ = true;
    if (status == Status::success)
      plan_again(h);
    else
      step_ = 0.3 * h, target_ = std::max(3, target_ - 1);
  }

  Status accept(double h) {
    plan_next(h);
    h_ = h, refused_ = false;
    std::ranges::swap(state_, next_);
    scales_ = Scales::of(system_, state_, slowest_);
    node_count_ = 0;
    return projection_.confirm_rank();
  }

  // Hermite interpolation of (x, theta) and their rates at the ends of the step and at points inside it, which are
  // extrapolated like the step itself. Its order is at least that of the step.
  Status dense(double fraction, State& out, Counters& counters, Watch& watch) {
    if (node_count_ == 0)
      if (const Status status = interpolate(h_, counters, watch); status != Status::success) return status;
    ExpMap map;
    for (int b = 0; b < system_.n(); ++b) {
      Twist value, rate;  // of x and theta
      for (int k = node_count_; k-- > 0;) {
        const Twist term = load(&nodes_[k].y[6 * b]);
        const double lever = fraction - nodes_[k].s;
        rate = value + lever * rate;
        value = term + lever * value;
      }
      map.set(value.w);
      out.frames[b].x = next_.frames[b].x + value.v;
      out.frames[b].R = next_.frames[b].R * map.rotation();
      out.u[b] = {rate.v / h_, map.left_tangent() * rate.w / h_};
    }
    out.angles = next_.angles;
    out.frames.follow(next_.frames, fraction * h_);
    return Status::success;
  }

  double next_break(double end) const { return system_.next_break(state_.frames.time, end); }
  const State& state() const { return state_; }
  const Constraints& joints() const { return projection_.joints(); }
  int redundant_rows() const { return projection_.redundant_rows(); }
  double smallest_pivot() { return projection_.smallest_pivot(); }
  double rate() const { return scales_.rate; }

 private:
  static constexpr int kMostRows = 12;
  // A row may magnify rounding errors up to the tolerance; measured, they then are a fifth of it.
  static constexpr double kRounding = 10 / std::numeric_limits<double>::epsilon();
  static constexpr double kSolved = 0.1;  // part of the tolerance for the iteration errors of all sub-steps
  static constexpr int kMostInner = (kMostRows - 1) / 2;

  // A term of Newton's interpolation formula: six numbers a body.
  struct Node {
    double s = 0;
    std::vector<double> y;
  };

  // Sum of the absolute weights of the first column in T_nn: the factor by which the table magnifies rounding errors.
  static double magnification(int n) {
    double sum = 0;
    for (int k = 1; k <= n; ++k) sum += std::pow(k, n - 1) / (std::tgamma(k) * std::tgamma(n - k + 1));
    return sum;
  }
  // A longer step could turn attitudes beyond the chart.
  double longest_step() const {
    double rate = 0;
    for (int b = 0; b < system_.n(); ++b) rate = std::max(rate, state_.u[b].w.norm());
    return 0.8 * most_turn_ / std::max(rate, 1e-300);
  }

  // Number of sub-steps up to a row, plus one for the projection.
  static double work(int row) { return 0.5 * row * (row + 1) + 1; }
  double work_per_time(int row) const { return work(row) / best_[row]; }

  // Computes row n of the table for the step h from `start`, in table_[1 .. n], and the difference of its last entries.
  Status fill(int n, double h, const State& start, Counters& counters, Watch& watch) {
    Steps& euler = n == 1 ? whole_ : euler_;
    Counters inner;
    Status status = euler.start(start, h / n);
    for (int i = 0; i < n && status == Status::success; ++i)
      status = watch.ends() ? Status::interrupted : euler.step(inner);  // a step has hundreds of these
    inner.add_to(counters);
    if (status != Status::success) return status;
    for (int b = 0; b < system_.n(); ++b) {
      const IncrementEquations& moved = euler.equations();
      if (!put(b, moved.ways[b], Mat3::Identity() + moved.turns[b], moved.gains[b], difference_))
        return Status::map_domain;
    }
    for (size_t i = 0; i < size_; ++i) {
      double entry = difference_[i];
      for (int k = 1; k < n; ++k) {
        const double above = std::exchange(table_[k][i], entry);
        entry += (entry - above) * (n - k) / k;
      }
      table_[n][i] = entry;
      if (n > 1) difference_[i] = table_[n - 1][i] - entry;
    }
    rows_ = n;
    return Status::success;
  }

  // Writes the coordinates of a body by its way, turn and change of velocity; false if it turned too far for the chart.
  bool put(int b, const Vec3& x, const Mat3& turn, const Twist& u, std::vector<double>& y) const {
    const Vec3 theta = logarithm(turn);
    store(Twist{x, theta}, &y[12 * b]), store(u, &y[12 * b + 6]);
    return theta.norm() < most_turn_;
  }
  // The state of the last entry of the last row.
  void extrapolate(const State& start, State& out) const {
    ExpMap map;
    for (int b = 0; b < system_.n(); ++b) {
      const double* const at = &table_[rows_][12 * b];
      map.set(load3(at + 3));
      out.frames[b].x = start.frames[b].x + load3(at);
      out.frames[b].R = start.frames[b].R * map.rotation();
      out.u[b] = {start.u[b].v + load3(at + 6), start.u[b].w + load3(at + 9)};
    }
    out.angles = start.angles;
  }

  // Fills rows until one converges, or until none up to the one after the target can converge.
  Status fill_rows(double h, bool& converged, Counters& counters, Watch& watch) {
    double error = 0, last = 0;
    for (auto* euler : {&euler_, &whole_}) euler->solve_to(kSolved * rtol_ / magnification(target_ + 1));
    for (int row = 1; row <= target_ + 1; ++row) {
      if (const Status status = fill(row, h, state_, counters, watch); status != Status::success) return status;
      if (row == 1) continue;
      last = std::exchange(error, estimate() / rtol_);
      if (!std::isfinite(error)) return Status::non_finite;
      best_[row] = longest(row, h, error);
      if (row + 1 < target_) continue;
      converged = error <= 1;
      if (converged) return Status::success;
      // Each further row reduces the error at least by the same factor.
      const double factor = row == 2 ? 1.0 / row : error / last;
      if (error * std::pow(factor, target_ + 1 - row) > 1) {
        for (int other = row + 1; other <= target_; ++other)
          best_[other] = longest(other, h, error * std::pow(std::min(factor, 1.0), other - row));
        return Status::success;
      }
    }
    return Status::success;
  }
  // The error of the row filled last. Of the velocities only the part counts that remains after an implicit step, not
  // the oscillation of a stiff spring that displaces nothing (as in code RADAU5; Hairer and Wanner IV.8).
  double estimate() {
    for (int b = 0; b < system_.n(); ++b) rates_[b] = load(&difference_[12 * b + 6]);
    if (whole_.equations().filter(rates_))
      for (int b = 0; b < system_.n(); ++b) store(rates_[b], &difference_[12 * b + 6]);
    return scales_.norm(difference_);
  }
  // The step that this row allows, from its error over the tolerance.
  static double longest(int row, double h, double error) {
    return h * std::clamp(0.94 * std::pow(0.65 / std::max(error, 1e-12), 1.0 / row), 0.1, 4.0);
  }

  void plan_again(double h) {
    if (target_ > 3 && work_per_time(target_ - 1) < 0.8 * work_per_time(target_)) --target_;
    step_ = std::min(best_[target_], 0.9 * h);
  }
  // Order and step of least work per unit of time, as in code SEULEX.
  void plan_next(double h) {
    const int used = rows_;
    int order = std::max(used <= target_ ? used : used - 1, 2);
    if (order > 2 && work_per_time(order - 1) < 0.8 * work_per_time(order))
      --order;
    else if (used <= target_ && (used == 2 || work_per_time(used) < 0.9 * work_per_time(used - 1)))
      order = used + 1;
    else if (used > target_ && work_per_time(used) < 0.9 * work_per_time(order))
      order = used;
    order = std::clamp(order, 3, most_rows_ - 1);
    if (refused_) {
      target_ = std::max(3, std::min(order, used));
      step_ = std::min(h, best_[std::min(target_, used)]);
      return;
    }
    step_ = order <= used ? best_[order] : best_[used] * work(order) / work(used);
    target_ = order;
  }

  Status interpolate(double h, Counters& counters, Watch& watch) {
    const State& start = next_;  // the start of the step
    const int rows = rows_, inner = std::max(1, (rows - 1) / 2);
    auto put_node = [&](int place, double s, const std::vector<double>& y) {
      for (int b = 0; b < system_.n(); ++b) {
        const double* const at = &y[12 * b];
        const Vec3 theta = load3(at + 3);
        ExpMap map;
        map.set(theta);
        Node &value = nodes_[2 * place], &rate = nodes_[2 * place + 1];
        value.s = rate.s = s;
        store(load(at), &value.y[6 * b]);
        store(Twist{h * (start.u[b].v + load3(at + 6)), h * map.momentum(start.u[b].w + load3(at + 9))},
              &rate.y[6 * b]);
      }
    };
    std::fill(difference_.begin(), difference_.end(), 0.0);
    put_node(0, 0, difference_);
    for (int b = 0; b < system_.n(); ++b) {
      const Frame &from = start.frames[b], &to = state_.frames[b];
      if (!put(b, to.x - from.x, from.R.transpose() * to.R, state_.u[b] - start.u[b], difference_))
        return Status::map_domain;
    }
    put_node(inner + 1, 1, difference_);
    for (int i = 1; i <= inner; ++i) {
      const double s = static_cast<double>(i) / (inner + 1);
      for (int row = 1; row <= rows; ++row)
        if (const Status status = fill(row, s * h, start, counters, watch); status != Status::success) return status;
      put_node(i, s, table_[rows]);
    }
    node_count_ = 2 * (inner + 2);
    divide_differences();
    return Status::success;
  }
  // Turns values and rates at double nodes into the coefficients of Newton's formula.
  void divide_differences() {
    for (size_t i = 0; i < size_ / 2; ++i) {
      for (int k = node_count_ - 2; k > 0; k -= 2)
        nodes_[k].y[i] = (nodes_[k].y[i] - nodes_[k - 2].y[i]) / (nodes_[k].s - nodes_[k - 2].s);
      for (int level = 2; level < node_count_; ++level)
        for (int k = node_count_ - 1; k >= level; --k)
          nodes_[k].y[i] = (nodes_[k].y[i] - nodes_[k - 1].y[i]) / (nodes_[k].s - nodes_[k - level].s);
    }
  }

  const System& system_;
  using Steps = ImplicitStepper<IncrementEquations>;
  Steps euler_, whole_;  // whole_: for row 1, whose matrix the error estimate uses
  Projection projection_;
  State state_{system_}, next_ = state_;  // after a step next_ is its start
  Scales scales_;
  const size_t size_ = 12 * system_.n();
  const double most_turn_ =
      most_turn(system_, 2.5);  // largest turn of a body in a step: log is smooth below half a turn
  std::array<std::vector<double>, kMostRows + 1> table_;
  std::vector<double> difference_ = std::vector<double>(size_);
  std::vector<Twist> rates_ = std::vector<Twist>(system_.n() + 1);
  std::array<double, kMostRows + 1> best_{};  // the step each row could take
  std::array<Node, 2 * (kMostInner + 2)> nodes_;
  int rows_ = 0, target_ = 0, node_count_ = 0, most_rows_ = kMostRows;
  double rtol_ = 0, slowest_ = 0, step_ = 0, h_ = 0;  // h_: of the step accepted last
  bool refused_ = false;
};
using AdaptiveExtrapolation = AdaptiveSteps<Extrapolation>;

}  // namespace lieeuler
