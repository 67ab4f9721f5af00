// A function of time: a piecewise polynomial plus a sum of sines. Constraint levels with one are (15.1) of
// docs/theory.md.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace lieeuler {

// A time, and the step that it belongs to: a break at an end of the step, to rounding, lies outside of it.
struct Moment {
  double time = 0;
  double from = -std::numeric_limits<double>::infinity(), to = -from;  // the inside of the step; of no step, everything

  static double rounding(double t) { return 1e-13 * std::abs(t); }

  // Begins a step of size h > 0 at this time.
  void begin_step(double h) {
    const double end = time + h, least = rounding(std::max(std::abs(time), std::abs(end)));
    from = time + least, to = end - least;
  }
  // Ends it: functions of this time are those that hold from here on.
  void end_step() { *this = {time}; }
  // Whether a time is that of the end of the step.
  bool ends_at(double t) const { return to < t && t <= time + (time - to); }
};

struct TimeFunction {
  struct Sine {
    double amplitude, frequency, phase;  // amplitude sin(frequency t + phase)
  };
  std::vector<double> breaks;               // where pieces begin; the first one holds before its break too
  std::vector<std::vector<double>> pieces;  // coefficients in powers of t - break
  std::vector<Sine> sines;

  double operator()(const Moment& at) const {
    const size_t k = piece(at);
    const double t = at.time;
    double value = 0;
    for (size_t i = pieces[k].size(); i-- > 0;) value = value * (t - breaks[k]) + pieces[k][i];
    for (const Sine& sine : sines) value += sine.amplitude * std::sin(sine.frequency * t + sine.phase);
    return value;
  }

  // The k-th derivative.
  double derivative(const Moment& at, int k) const {
    std::vector<double> series(k + 1);
    expand(at, k + 1, series.data());
    return series[k] * std::tgamma(k + 1);
  }

  // Taylor coefficients about a time, orders below `count`.
  void expand(const Moment& at, int count, double* out) const {
    const double t = at.time;
    const std::vector<double> moved = piece_about(piece(at), t);
    for (int i = 0; i < count; ++i) out[i] = coefficient(moved, i);
    for (const Sine& sine : sines) {
      const double s = std::sin(sine.frequency * t + sine.phase), c = std::cos(sine.frequency * t + sine.phase);
      const double turns[4] = {s, c, -s, -c};
      double factor = sine.amplitude;
      for (int i = 0; i < count; ++i) {
        out[i] += factor * turns[i % 4];
        factor *= sine.frequency / (i + 1);
      }
    }
  }

  // The first break after t, or `end`.
  double next_break(double t, double end) const {
    const size_t next = piece({t}) + 1;
    return next == breaks.size() ? end : std::min(end, breaks[next]);
  }
  // Appends the breaks at which the function or one of its first derivatives jumps.
  void append_jumps(int derivatives, std::vector<double>& out) const {
    constexpr double kRounding = 1e-12;  // as a part of the largest value at a break
    for (int i = 0; i <= derivatives; ++i) {
      std::vector<double> changes(breaks.size(), 0.0);
      double most = 0;
      for (size_t k = 1; k < breaks.size(); ++k) {
        const double before = coefficient(piece_about(k - 1, breaks[k]), i), after = coefficient(pieces[k], i);
        most = std::max({most, std::abs(before), std::abs(after)});
        changes[k] = std::abs(after - before);
      }
      for (size_t k = 1; k < breaks.size(); ++k)
        if (changes[k] > kRounding * most) out.push_back(breaks[k]);
    }
  }
  // Rough size of its values.
  double size() const {
    double most = 0;
    for (const std::vector<double>& piece : pieces) most = std::max(most, std::abs(piece.front()));
    for (const Sine& sine : sines) most += std::abs(sine.amplitude);
    return most;
  }

 private:
  // A step within one piece takes it at all of its times, also beyond the ends of the step, as compositions do. Any
  // other takes at each time the piece of that time, where what is a break but for rounding has been reached.
  size_t piece(const Moment& at) const {
    if (breaks.size() == 1) return 0;
    const size_t first = last_begun(at.from);
    return first == last_begun(at.to) ? first : last_begun(at.time + Moment::rounding(at.time));
  }
  size_t last_begun(double t) const {
    return static_cast<size_t>(std::upper_bound(breaks.begin() + 1, breaks.end(), t) - breaks.begin()) - 1;
  }
  static double coefficient(const std::vector<double>& of, int i) {
    return static_cast<size_t>(i) < of.size() ? of[i] : 0;
  }
  // Coefficients of a piece in powers of the time after t, by Horner's rule.
  std::vector<double> piece_about(size_t k, double t) const {
    std::vector<double> moved = pieces[k];
    for (size_t first = 0; first < moved.size(); ++first)
      for (size_t i = moved.size() - 1; i-- > first;) moved[i] += (t - breaks[k]) * moved[i + 1];
    return moved;
  }
};

}  // namespace lieeuler
