// A function of time: a piecewise polynomial plus a sum of sines.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

namespace lieeuler {

struct TimeFunction {
  struct Sine {
    double amplitude, frequency, phase;  // amplitude sin(frequency t + phase)
  };
  std::vector<double> breaks;               // where pieces begin; the first one holds before its break too
  std::vector<std::vector<double>> pieces;  // coefficients in powers of t - break
  std::vector<Sine> sines;

  double operator()(double t) const {
    const size_t k = piece(t);
    double value = 0;
    for (size_t i = pieces[k].size(); i-- > 0;) value = value * (t - breaks[k]) + pieces[k][i];
    for (const Sine& sine : sines) value += sine.amplitude * std::sin(sine.frequency * t + sine.phase);
    return value;
  }

  // The k-th derivative.
  double derivative(double t, int k) const {
    std::vector<double> series(k + 1);
    expand(t, k + 1, series.data());
    return series[k] * std::tgamma(k + 1);
  }

  // Taylor coefficients about t, orders below `count`.
  void expand(double t, int count, double* out) const {
    const size_t k = piece(t);
    std::vector<double> moved = pieces[k];  // to the origin t, by Horner's rule
    for (size_t first = 0; first < moved.size(); ++first)
      for (size_t i = moved.size() - 1; i-- > first;) moved[i] += (t - breaks[k]) * moved[i + 1];
    for (int i = 0; i < count; ++i) out[i] = static_cast<size_t>(i) < moved.size() ? moved[i] : 0;
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
    const size_t next = piece(t) + 1;
    return next == breaks.size() ? end : std::min(end, breaks[next]);
  }
  // Rough size of its values.
  double size() const {
    double most = 0;
    for (const std::vector<double>& piece : pieces) most = std::max(most, std::abs(piece.front()));
    for (const Sine& sine : sines) most += std::abs(sine.amplitude);
    return most;
  }

 private:
  static constexpr double kRounding = 1e-13;  // relative to t: a step that ends on a break has reached the next piece

  size_t piece(double t) const {
    const auto next = std::upper_bound(breaks.begin() + 1, breaks.end(), t + kRounding * std::abs(t));
    return static_cast<size_t>(next - breaks.begin()) - 1;
  }
};

}  // namespace lieeuler
