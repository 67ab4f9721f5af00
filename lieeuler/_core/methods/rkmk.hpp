// Explicit Runge-Kutta-Munthe-Kaas methods on the index-1 system (Munthe-Kaas, doi:10.1016/S0168-9274(98)00030-0), in a
// chart of the states about the start of each step: that of the bodies, or that of the joints of a tree.
#pragma once

#include <numeric>

#include "methods/body_chart.hpp"
#include "methods/joint_chart.hpp"
#include "methods/method.hpp"
#include "run/adaptive_steps.hpp"

namespace lieeuler {

// The nonzero entries of the rows of a tableau.
using Terms = std::vector<std::pair<int, double>>;
inline std::vector<Terms> sparse(const std::vector<std::vector<double>>& rows) {
  std::vector<Terms> all;
  for (const std::vector<double>& row : rows) {
    all.emplace_back();
    for (size_t k = 0; k < row.size(); ++k)
      if (row[k] != 0) all.back().push_back({static_cast<int>(k), row[k]});
  }
  return all;
}

// Attempts single steps, which the caller accepts or not. A chart supplies
//
//   Point                                a state, with what the chart knows of it
//   Point make(), int blocks()           how many times twelve numbers y has: positions, angles and their rates
//   Status start(const State&, Point&, double slowest, Counters&)
//   void renew()                         before another run
//   bool configure(const double* y, const Point& base, Point&, double* out)
//                                        the point y about `base`, and the derivatives of its positions and angles;
//                                        false outside of the chart
//   void put_rates(const Point&, double* out), put_accelerations(const Point&, double* out)
//   Status accelerate(Point&)            solves for the accelerations
//   Status settle(Point&, double length, Counters&)
//                                        the same at the end of a step, put back onto the constraints
//   void return_to(const Point&)         after accelerations elsewhere: joints() are those of this point
//   const State& state(const Point&), whole(Point&)
//                                        within a step, and at its end, with accelerations; then joints() are there
template <class Chart>
class MuntheKaas {
  using Point = typename Chart::Point;

 public:
  template <class... Arguments>
  MuntheKaas(const Plan& plan, const Tableau& tableau, const Arguments&... arguments)
      : plan_(plan),
        chart_(plan, arguments...),
        stages_(sparse(tableau.stages)),
        weights_(sparse({tableau.weights})),
        errors_(sparse(tableau.errors)),
        extra_(sparse(tableau.extra)),
        dense_(sparse(tableau.dense)),
        nodes_(sums(tableau.stages)),
        extra_nodes_(sums(tableau.extra)) {
    slopes_.assign((stages_.size() + 2 + extra_.size()) * size_, 0.0);
    y_.assign(size_, 0.0), step_.assign(size_, 0.0);
    dense_terms_.assign((3 + dense_.size()) * size_, 0.0);
  }

  Status start(const State& state, double slowest, Counters& counters) {
    slowest_ = slowest;
    scales_ = Scales::of(system_, state, slowest_);
    return chart_.start(state, state_, scales_.length, counters);
  }

  void renew() { chart_.renew(); }

  Status attempt(double h, Counters& counters) {
    h_ = h;
    state_.frames.begin_step(h);
    put_first_slope();
    for (size_t i = 0; i < stages_.size(); ++i) {
      combine(stages_[i], y_.data());
      if (const Status status = evaluate(slope(i + 1), h * nodes_[i], counters); status != Status::success)
        return status;
    }
    combine(weights_[0], step_.data());
    if (!move(step_.data(), state_, h, next_, slope(end()))) return Status::map_domain;
    if (const Status status = chart_.settle(next_, scales_.length, counters); status != Status::success) return status;
    chart_.put_accelerations(next_, slope(end()));
    return Status::success;
  }

  // Estimated error of the attempted step, relative to the sizes of the system; from two estimates as in code DOP853.
  double error() {
    combine(errors_[0], y_.data());
    const double first = scales_.norm(y_);
    if (errors_.size() == 1 || first == 0) return first;
    combine(errors_[1], y_.data());
    const double second = scales_.norm(y_);
    return first * first / std::sqrt(first * first + 0.01 * second * second);
  }

  Status accept() {
    std::ranges::swap(state_, next_);
    scales_ = Scales::of(system_, chart_.state(state_), slowest_);
    interpolates_ = false;
    return chart_.confirm_rank();
  }
  // Where accelerations jump at the end of a step: those of what acts from there on.
  Status cross() {
    if (!plan_.jumps_at(state_.frames)) return Status::success;
    Counters uncounted;
    state_.frames.end_step();
    return chart_.settle(state_, scales_.length, uncounted);
  }

  // Code HINIT of Hairer, Norsett and Wanner: from the sizes of the first and second derivatives.
  double first_step(int order, double rtol, Counters& counters) {
    h_ = 1;
    put_first_slope();
    std::copy_n(slope(0), size_, y_.begin());
    const double first = scales_.norm(y_);
    const double rate = scales_.rate, h = 0.01 / std::max(first, 1e-6 * rate);
    for (size_t i = 0; i < size_; ++i) y_[i] = h * slope(0)[i];
    const Status status = evaluate(slope(1), h, counters);
    chart_.return_to(state_);
    if (status != Status::success) return 0.01 * h;
    for (size_t i = 0; i < size_; ++i) y_[i] = slope(1)[i] - slope(0)[i];
    const double second = scales_.norm(y_) / h;
    const double size = std::max({first / rate, second / (rate * rate), 1e-12});
    return std::min(100 * h, std::pow(0.01 * rtol / size, 1.0 / order) / rate);
  }

  // The state at a fraction of the step accepted last, before projection. Afterwards joints() belong to no state.
  Status dense(double fraction, State& out, Counters& counters, Watch&) {
    if (!interpolates_)
      if (const Status status = interpolate(counters); status != Status::success) return status;
    const double s = fraction, rest = 1 - fraction;
    for (size_t i = 0; i < size_; ++i) {
      double value = 0;
      for (size_t k = 3 + dense_.size(); k-- > 0;) value = dense_terms_[k * size_ + i] + (k % 2 ? s : rest) * value;
      y_[i] = s * value;
    }
    if (!move(y_.data(), next_, fraction * h_, trial_, step_.data())) return Status::map_domain;
    out = chart_.state(trial_);
    return Status::success;
  }

  double next_break(double end) const { return system_.next_break(chart_.state(state_).frames.time, end); }
  const State& state() { return chart_.whole(state_); }
  const Constraints& joints() const { return chart_.joints(); }
  int redundant_rows() const { return chart_.redundant_rows(); }
  double smallest_pivot() { return chart_.smallest_pivot(); }
  double rate() const { return scales_.rate; }

 private:
  static constexpr int kBlock = 12;  // x, theta, v, w

  // Times of the stages, as parts of the step.
  static std::vector<double> sums(const std::vector<std::vector<double>>& rows) {
    std::vector<double> all;
    for (const std::vector<double>& row : rows) all.push_back(std::accumulate(row.begin(), row.end(), 0.0));
    return all;
  }

  double* slope(size_t stage) { return slopes_.data() + stage * size_; }
  size_t end() const { return stages_.size() + 1; }

  // h times the weighted sum of slopes.
  void combine(const Terms& terms, double* out) const {
    for (size_t at = 0; at < size_; at += kBlock) {
      double sum[kBlock] = {};
      for (const auto& [stage, weight] : terms) {
        const double factor = h_ * weight;
        const double* const k = slopes_.data() + stage * size_ + at;
        for (int i = 0; i < kBlock; ++i) sum[i] += factor * k[i];
      }
      std::copy_n(sum, kBlock, out + at);
    }
  }

  // The point y of the chart at `base`, at a time h later.
  bool move(const double* y, const Point& base, double h, Point& point, double* out) {
    point.angles = base.angles;
    point.frames.follow(base.frames, h);
    return chart_.configure(y, base, point, out);
  }
  // The slope at the origin of the chart.
  void put_first_slope() {
    chart_.put_rates(state_, slope(0));
    chart_.put_accelerations(state_, slope(0));
  }
  // The slope at y_, at the time `after` the start of the step.
  Status evaluate(double* out, double after, Counters& counters) {
    if (!move(y_.data(), state_, after, trial_, out)) return Status::map_domain;
    ++counters.factorizations;
    ++counters.force_evaluations;
    if (const Status status = chart_.accelerate(trial_); status != Status::success) return status;
    chart_.put_accelerations(trial_, out);
    return Status::success;
  }

  // Terms of the continuous extension in Hairer's form: s (d_0 + (1-s) (d_1 + s (d_2 + (1-s) (d_3 + ...)))).
  Status interpolate(Counters& counters) {
    std::ranges::swap(state_, next_);  // the chart is that of the step's start
    Status status = Status::success;
    for (size_t i = 0; i < extra_.size() && status == Status::success; ++i) {
      combine(extra_[i], y_.data());
      status = evaluate(slope(end() + 1 + i), h_ * extra_nodes_[i], counters);
    }
    std::ranges::swap(state_, next_);
    if (status != Status::success) return status;
    double *const d0 = dense_terms_.data(), *const d1 = d0 + size_, *const d2 = d1 + size_;
    for (size_t i = 0; i < size_; ++i) {
      d0[i] = step_[i];
      d1[i] = h_ * slope(0)[i] - step_[i];
      d2[i] = 2 * step_[i] - h_ * (slope(0)[i] + slope(end())[i]);
    }
    for (size_t k = 0; k < dense_.size(); ++k) combine(dense_[k], d0 + (3 + k) * size_);
    interpolates_ = true;
    return Status::success;
  }

  const Plan& plan_;
  const System& system_ = plan_.system;
  Chart chart_;
  Point state_ = chart_.make(), next_ = state_, trial_ = state_;  // after a step next_ is its start
  Scales scales_;
  const size_t size_ = kBlock * chart_.blocks();
  const std::vector<Terms> stages_, weights_, errors_, extra_, dense_;
  const std::vector<double> nodes_, extra_nodes_;
  std::vector<double> slopes_;  // of the stages, of the end of the step, of the extra stages
  std::vector<double> y_, step_, dense_terms_;
  double h_ = 0, slowest_ = 0;
  bool interpolates_ = false;
};

// Steps of fixed size, for `run`.
template <class Chart>
class FixedMuntheKaas : public MuntheKaas<Chart> {
 public:
  using MuntheKaas<Chart>::MuntheKaas;

  Status start(const State& state, double h) {
    h_ = h;
    Counters at_start;
    return MuntheKaas<Chart>::start(state, 0, at_start);
  }
  Status step(Counters& counters) {
    if (const Status status = this->attempt(h_, counters); status != Status::success) return status;
    ++counters.steps;
    return this->accept();
  }

 private:
  double h_ = 0;
};

// Steps chosen by the error estimate.
template <class Chart>
class ControlledMuntheKaas : public MuntheKaas<Chart> {
  using Base = MuntheKaas<Chart>;

 public:
  template <class... Arguments>
  ControlledMuntheKaas(const Plan& plan, const Tableau& tableau, const Arguments&... arguments)
      : Base(plan, tableau, arguments...), order_(tableau.order) {}

  Status start(const State& initial, double rtol, double slowest, Counters& counters) {
    rtol_ = rtol;
    if (const Status status = Base::start(initial, slowest, counters); status != Status::success) return status;
    control_ = StepControl(order_, this->first_step(order_, rtol, counters));
    return Status::success;
  }
  double proposed() const { return control_.step(); }
  Status attempt(double h, bool& stands, Counters& counters, Watch&) {
    const Status status = Base::attempt(h, counters);
    if (status == Status::success) stands = control_.accept(this->error() / rtol_);
    return status;
  }
  void refuse(double, Status status) {
    if (status != Status::success) control_.refuse(0.25);
  }
  Status accept(double) {
    const Status status = Base::accept();
    return status == Status::success ? this->cross() : status;
  }

 private:
  StepControl control_;
  int order_;
  double rtol_ = 0;
};
template <class Chart>
using AdaptiveMuntheKaas = AdaptiveSteps<ControlledMuntheKaas<Chart>>;

}  // namespace lieeuler
