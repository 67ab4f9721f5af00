// Explicit Runge-Kutta-Munthe-Kaas methods on the index-1 system (Munthe-Kaas, doi:10.1016/S0168-9274(98)00030-0).
//
// In a step attitudes are R_n exp(hat theta), and the rule is applied to y = (x, theta, v, w) of every body:
//
//   x' = v,  theta' = dexp^-1(theta) w,  M u' = f - G^T lam,  G u' + gamma = 0
//
// The step ends with one projection onto Phi = 0 and G u = 0; the matrix factored there serves the next first stage.
#pragma once

#include <numeric>

#include "run/adaptive_steps.hpp"
#include "solve/free_bodies.hpp"

namespace lieeuler {

// The coefficients of lieeuler/tableaux.py.
struct Tableau {
  std::vector<std::vector<double>> stages;
  std::vector<double> weights;
  int order;
  std::vector<std::vector<double>> errors, extra, dense;
};

// Attempts single steps, which the caller accepts or not.
class MuntheKaas {
 public:
  // The nonzero entries of a row.
  using Terms = std::vector<std::pair<int, double>>;
  static std::vector<Terms> sparse(const std::vector<std::vector<double>>& rows) {
    std::vector<Terms> all;
    for (const std::vector<double>& row : rows) {
      all.emplace_back();
      for (size_t k = 0; k < row.size(); ++k)
        if (row[k] != 0) all.back().push_back({static_cast<int>(k), row[k]});
    }
    return all;
  }

  MuntheKaas(const Plan& plan, const Tableau& tableau, bool conserves)
      : system_(plan.system),
        projection_(plan),
        free_(plan.system, conserves),
        state_(system_),
        next_(system_),
        trial_(system_),
        size_(kPerBody * system_.n()),
        stages_(sparse(tableau.stages)),
        weights_(sparse({tableau.weights})),
        errors_(sparse(tableau.errors)),
        extra_(sparse(tableau.extra)),
        dense_(sparse(tableau.dense)),
        most_turn_(most_turn(system_, 2 * std::numbers::pi)),
        nodes_(sums(tableau.stages)),
        extra_nodes_(sums(tableau.extra)) {
    slopes_.assign((stages_.size() + 2 + extra_.size()) * size_, 0.0);
    y_.assign(size_, 0.0), step_.assign(size_, 0.0);
    dense_terms_.assign((3 + dense_.size()) * size_, 0.0);
  }

  Status start(const State& state, double slowest, Counters& counters) {
    state_ = state, slowest_ = slowest;
    update_angles(system_, state_.frames, state_.u, state_.angles);
    if (const Status status = projection_.start(state_); status != Status::success) return status;
    free_.start(state_);
    scales_ = Scales::of(system_, state_, slowest_);
    rank_confirmed_ = projection_.redundant_rows() == 0;
    return projection_.settle(state_, scales_.length, counters);
  }

  Status attempt(double h, Counters& counters) {
    h_ = h;
    put_first_slope();
    for (size_t i = 0; i < stages_.size(); ++i) {
      combine(stages_[i], y_.data());
      if (const Status status = evaluate(slope(i + 1), h * nodes_[i], counters); status != Status::success)
        return status;
    }
    combine(weights_[0], step_.data());
    next_.angles = state_.angles;
    next_.frames.follow(state_.frames, h);
    if (!configure(step_.data(), state_, next_, slope(end()))) return Status::map_domain;
    if (const Status status = projection_.settle(next_, scales_.length, counters); status != Status::success)
      return status;
    free_.restore(next_);
    put_accelerations(next_, slope(end()));
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
    std::swap(state_, next_);
    scales_ = Scales::of(system_, state_, slowest_);
    interpolates_ = false;
    if (rank_confirmed_) return Status::success;
    rank_confirmed_ = true;
    return projection_.confirm_rank();
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
    projection_.move_to(state_);  // joints() are those of state()
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
    out.angles = next_.angles;
    out.frames.follow(next_.frames, fraction * h_);
    return configure(y_.data(), next_, out, step_.data()) ? Status::success : Status::map_domain;
  }

  double next_break(double end) const { return system_.next_break(state_.frames.time, end); }
  const State& state() const { return state_; }
  const Constraints& joints() const { return projection_.joints(); }
  int redundant_rows() const { return projection_.redundant_rows(); }
  double smallest_pivot() { return projection_.smallest_pivot(); }
  double rate() const { return scales_.rate; }

 private:
  static constexpr int kPerBody = 12;  // x, theta, v, w

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
    for (size_t at = 0; at < size_; at += kPerBody) {
      double sum[kPerBody] = {};
      for (const auto& [stage, weight] : terms) {
        const double factor = h_ * weight;
        const double* const k = slopes_.data() + stage * size_ + at;
        for (int i = 0; i < kPerBody; ++i) sum[i] += factor * k[i];
      }
      std::copy_n(sum, kPerBody, out + at);
    }
  }

  // Sets `state` to the point y of the chart at `base`, and `out` to the derivatives of x and theta; false if an
  // attitude turned too far for the chart.
  bool configure(const double* y, const State& base, State& state, double* out) const {
    for (int b = 0; b < system_.n(); ++b, y += kPerBody, out += kPerBody) {
      const Vec3 theta = load3(y + 3), v = base.u[b].v + load3(y + 6), w = base.u[b].w + load3(y + 9);
      const double s = theta.squaredNorm();
      if (!(s < most_turn_ * most_turn_)) return false;
      const ChartCoefficients k = chart_coefficients(s);
      state.frames[b].x = base.frames[b].x + load3(y);
      state.frames[b].R.noalias() = base.frames[b].R * quadratic(theta, 1 - k.cosc * s, k.sinc, k.cosc);
      state.u[b] = {v, w};
      const Vec3 turned = theta.cross(w);
      store(v, out), store(Vec3(w + 0.5 * turned + k.inverse * theta.cross(turned)), out + 3);  // dexp^-1 w
    }
    return true;
  }
  void put_accelerations(const State& state, double* out) const {
    for (int b = 0; b < system_.n(); ++b) store(state.a[b], out + kPerBody * b + 6);
  }
  // The slope at the origin of the chart.
  void put_first_slope() {
    double* out = slope(0);
    for (int b = 0; b < system_.n(); ++b) store(state_.u[b], out + kPerBody * b);
    put_accelerations(state_, out);
  }
  // The slope at y_, at the time `after` the start of the step.
  Status evaluate(double* out, double after, Counters& counters) {
    trial_.angles = state_.angles;
    trial_.frames.follow(state_.frames, after);
    if (!configure(y_.data(), state_, trial_, out)) return Status::map_domain;
    ++counters.factorizations;
    ++counters.force_evaluations;
    if (const Status status = projection_.accelerate(trial_); status != Status::success) return status;
    put_accelerations(trial_, out);
    return Status::success;
  }

  // Terms of the continuous extension in Hairer's form: s (d_0 + (1-s) (d_1 + s (d_2 + (1-s) (d_3 + ...)))).
  Status interpolate(Counters& counters) {
    std::swap(state_, next_);  // the chart is that of the step's start
    Status status = Status::success;
    for (size_t i = 0; i < extra_.size() && status == Status::success; ++i) {
      combine(extra_[i], y_.data());
      status = evaluate(slope(end() + 1 + i), h_ * extra_nodes_[i], counters);
    }
    std::swap(state_, next_);
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

  const System& system_;
  Projection projection_;
  FreeBodies free_;
  State state_, next_, trial_;  // after a step next_ is its start
  Scales scales_;
  const size_t size_;
  const std::vector<Terms> stages_, weights_, errors_, extra_, dense_;
  const double most_turn_;  // largest turn of a body in a step: dexp^-1 is singular at a whole turn
  const std::vector<double> nodes_, extra_nodes_;
  std::vector<double> slopes_;  // of the stages, of the end of the step, of the extra stages
  std::vector<double> y_, step_, dense_terms_;
  double h_ = 0, slowest_ = 0;
  bool interpolates_ = false, rank_confirmed_ = false;
};

// Steps of fixed size, for `run`.
class FixedMuntheKaas : public MuntheKaas {
 public:
  FixedMuntheKaas(const Plan& plan, const Tableau& tableau) : MuntheKaas(plan, tableau, false) {}

  Status start(const State& state, double h) {
    h_ = h;
    Counters at_start;
    return MuntheKaas::start(state, 0, at_start);
  }
  Status step(Counters& counters) {
    if (const Status status = attempt(h_, counters); status != Status::success) return status;
    ++counters.steps;
    return accept();
  }

 private:
  double h_ = 0;
};

// Steps chosen by the error estimate.
class ControlledMuntheKaas : public MuntheKaas {
 public:
  ControlledMuntheKaas(const Plan& plan, const Tableau& tableau, bool conserves = false)
      : MuntheKaas(plan, tableau, conserves), order_(tableau.order) {}

  Status start(const State& initial, double rtol, double slowest, Counters& counters) {
    rtol_ = rtol;
    if (const Status status = MuntheKaas::start(initial, slowest, counters); status != Status::success) return status;
    control_ = StepControl(order_, first_step(order_, rtol, counters));
    return Status::success;
  }
  double proposed() const { return control_.step(); }
  Status attempt(double h, bool& stands, Counters& counters, Watch&) {
    const Status status = MuntheKaas::attempt(h, counters);
    if (status == Status::success) stands = control_.accept(error() / rtol_);
    return status;
  }
  void refuse(double, Status status) {
    if (status != Status::success) control_.refuse(0.25);
  }
  Status accept(double) { return MuntheKaas::accept(); }

 private:
  StepControl control_;
  int order_;
  double rtol_ = 0;
};
using AdaptiveMuntheKaas = AdaptiveSteps<ControlledMuntheKaas>;

}  // namespace lieeuler
