// Coordinate maps from R^3 onto SO(3): the exponential, the Cayley map and canonical coordinates of the second kind.
//
// Each map m gives, at theta:
//   rotation()       E = m(theta); turn() = E - I, accurate relative to its own size (except for ccsk)
//   left_tangent()   T with  m(theta + d) = E exp(hat(T d)) + O(d^2), (3.1) of docs/theory.md
//   momentum(L)      y = D* L, D* = inverse transpose of the right-trivialised tangent (Hamilton-Pontryagin equations)
//   momentum_slope   dy/dxi for theta = h xi, L = J xi
// set() returns false outside the map's domain.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <variant>

namespace lieeuler {

// Maps from R^3 onto SO(3).
enum class CoordinateMap { exp, cayley, ccsk };

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;

inline Mat3 hat(const Vec3& a) { return Mat3{{0, -a.z(), a.y()}, {a.z(), 0, -a.x()}, {-a.y(), a.x(), 0}}; }
// hat(a) hat(b), written out.
inline Mat3 hat_product(const Vec3& a, const Vec3& b) {
  Mat3 m = b * a.transpose();
  const double x = m(0, 0), y = m(1, 1), z = m(2, 2);
  m(0, 0) = -(y + z), m(1, 1) = -(x + z), m(2, 2) = -(x + y);
  return m;
}

// m x and m^T x, written out: half the instructions of the general product.
EIGEN_ALWAYS_INLINE Vec3 times(const Mat3& m, const Vec3& x) {
  return {m(0, 0) * x[0] + m(0, 1) * x[1] + m(0, 2) * x[2], m(1, 0) * x[0] + m(1, 1) * x[1] + m(1, 2) * x[2],
          m(2, 0) * x[0] + m(2, 1) * x[1] + m(2, 2) * x[2]};
}
EIGEN_ALWAYS_INLINE Vec3 transposed_times(const Mat3& m, const Vec3& x) {
  return {m(0, 0) * x[0] + m(1, 0) * x[1] + m(2, 0) * x[2], m(0, 1) * x[0] + m(1, 1) * x[1] + m(2, 1) * x[2],
          m(0, 2) * x[0] + m(1, 2) * x[1] + m(2, 2) * x[2]};
}

// The first `Terms` of sum_k coefficients[k] s^k, highest power first in the loop (Horner).
template <int Terms, int N>
[[gnu::always_inline]] inline double polynomial(const double (&coefficients)[N], double s) {
  static_assert(Terms <= N);
  double value = coefficients[Terms - 1];
  for (int k = Terms - 2; k >= 0; --k) value = value * s + coefficients[k];
  return value;
}

// Below this squared angle the series are accurate to rounding with the terms given and need no trigonometric function;
// above it the closed forms lose at most one digit to cancellation.
inline constexpr double kSeriesLimit = 0.25;
// Below this one half of the terms are enough, as for the rotation of one small step.
inline constexpr double kShortSeriesLimit = 1e-3;

inline constexpr double kSincSeries[] = {1.,          -1. / 6,        1. / 120,         -1. / 5040,
                                         1. / 362880, -1. / 39916800, 1. / 6227020800., -1. / 1307674368000.};
inline constexpr double kCoscSeries[] = {1. / 2,       -1. / 24,         1. / 720,          -1. / 40320,
                                         1. / 3628800, -1. / 479001600., 1. / 87178291200., -1. / 20922789888000.};
inline constexpr double kCubicSeries[] = {
    1. / 6,        -1. / 120,         1. / 5040,           -1. / 362880,
    1. / 39916800, -1. / 6227020800., 1. / 1307674368000., -1. / 355687428096000.};
// |B_2k| / (2k)!, k = 1, 2, ...
inline constexpr double kInverseTangentSeries[] = {1. / 12,           1. / 720,
                                                   1. / 30240,        1. / 1209600,
                                                   1. / 47900160,     691. / 1307674368000.,
                                                   1. / 74724249600., 3617. / 10670622842880000.};

// The even functions of |theta| in the exponential map, as functions of s = |theta|^2.
struct ExpCoefficients {
  double sinc;   // sin(t) / t
  double cosc;   // (1 - cos t) / t^2
  double cubic;  // (t - sin t) / t^3
};

template <int Terms>
ExpCoefficients exp_series(double s) {
  return {polynomial<Terms>(kSincSeries, s), polynomial<Terms>(kCoscSeries, s), polynomial<Terms>(kCubicSeries, s)};
}
inline ExpCoefficients exp_coefficients(double s) {
  if (s < kShortSeriesLimit) return exp_series<4>(s);
  if (s < kSeriesLimit) return exp_series<8>(s);
  const double t = std::sqrt(s), sine = std::sin(t), half = std::sin(0.5 * t);
  return {sine / t, 2 * half * half / s, (t - sine) / (t * s)};
}

// c(s) = 1/t^2 - cot(t/2)/(2t) and dc/ds: the quadratic coefficient of the inverse tangent of the exponential.
inline void inverse_tangent_coefficient(double s, double& c, double& slope) {
  if (s < kSeriesLimit) {
    static constexpr auto& c_series = kInverseTangentSeries;
    static constexpr double slope_series[] = {c_series[1],     2 * c_series[2], 3 * c_series[3], 4 * c_series[4],
                                              5 * c_series[5], 6 * c_series[6], 7 * c_series[7]};
    if (s < kShortSeriesLimit)
      c = polynomial<4>(c_series, s), slope = polynomial<4>(slope_series, s);
    else
      c = polynomial<8>(c_series, s), slope = polynomial<7>(slope_series, s);
    return;
  }
  const double t = std::sqrt(s), sine = std::sin(0.5 * t), cotangent = std::cos(0.5 * t) / sine;
  c = 1 / s - cotangent / (2 * t);
  slope = (-1 / s + cotangent / (4 * t) + 1 / (8 * sine * sine)) / s;
}

// The coefficients of exp and of its inverse tangent together; beyond the series they share one sine and cosine.
struct ChartCoefficients {
  double sinc, cosc, inverse;  // inverse: c(s) of inverse_tangent_coefficient
};

inline ChartCoefficients chart_coefficients(double s) {
  if (s < kSeriesLimit) {
    double c, slope;
    inverse_tangent_coefficient(s, c, slope);
    const ExpCoefficients k = exp_coefficients(s);
    return {k.sinc, k.cosc, c};
  }
  const double t = std::sqrt(s), sine = std::sin(0.5 * t), cosine = std::cos(0.5 * t);
  return {2 * sine * cosine / t, 2 * sine * sine / s, 1 / s - cosine / (2 * t * sine)};
}

// d(xi x J xi)/dxi
inline Mat3 gyroscopic_slope(const Vec3& xi, const Vec3& L, const Mat3& J) { return hat(xi) * J - hat(L); }

// a I + b hat(theta) + c theta theta^T
[[gnu::always_inline]] inline Mat3 quadratic(const Vec3& theta, double a, double b, double c) {
  Mat3 m = (c * theta) * theta.transpose();
  m.diagonal().array() += a;
  const Vec3 v = b * theta;
  m(0, 1) -= v.z(), m(0, 2) += v.y(), m(1, 0) += v.z(), m(1, 2) -= v.x(), m(2, 0) -= v.y(), m(2, 1) += v.x();
  return m;
}

class ExpMap {
 public:
  bool set(const Vec3& theta) {
    theta_ = theta;
    s_ = theta.squaredNorm();
    k_ = exp_coefficients(s_);
    return s_ < 4 * std::numbers::pi * std::numbers::pi;
  }
  [[gnu::always_inline]] Mat3 rotation() const { return quadratic(theta_, 1 - k_.cosc * s_, k_.sinc, k_.cosc); }
  Mat3 turn() const { return quadratic(theta_, -k_.cosc * s_, k_.sinc, k_.cosc); }
  Mat3 left_tangent() const { return quadratic(theta_, 1 - k_.cubic * s_, -k_.cosc, k_.cubic); }
  Vec3 momentum(const Vec3& L) const {
    double c, slope;
    inverse_tangent_coefficient(s_, c, slope);
    const Vec3 turned = theta_.cross(L);
    return L + 0.5 * turned + c * theta_.cross(turned);
  }
  Mat3 momentum_slope(const Vec3& xi, const Vec3& L, const Mat3& J, double h) const {
    double c, slope;
    inverse_tangent_coefficient(s_, c, slope);
    const Mat3 turn = gyroscopic_slope(xi, L, J), X = hat(xi);
    const Vec3 turned = xi.cross(L);
    return J + 0.5 * h * turn + c * h * h * (X * turn - hat(turned)) +
           (2 * slope * h * h * h * h) * xi.cross(turned) * xi.transpose();
  }

 private:
  Vec3 theta_ = Vec3::Zero();
  double s_ = 0;
  ExpCoefficients k_{};
};

class CayleyMap {
 public:
  bool set(const Vec3& theta) {
    theta_ = theta;
    scale_ = 1 / (1 + 0.25 * theta.squaredNorm());
    return std::isfinite(scale_);
  }
  Mat3 rotation() const { return Mat3::Identity() + turn(); }
  Mat3 turn() const {
    const Mat3 X = hat(theta_);
    return scale_ * (X + 0.5 * X * X);
  }
  Mat3 left_tangent() const { return scale_ * (Mat3::Identity() - 0.5 * hat(theta_)); }
  Vec3 momentum(const Vec3& L) const { return L + 0.5 * theta_.cross(L) + (0.25 * theta_.dot(L)) * theta_; }
  Mat3 momentum_slope(const Vec3& xi, const Vec3& L, const Mat3& J, double h) const {
    const Mat3 quadratic = xi.dot(L) * Mat3::Identity() + 2 * xi * L.transpose();
    return J + 0.5 * h * gyroscopic_slope(xi, L, J) + 0.25 * h * h * quadratic;
  }

 private:
  Vec3 theta_ = Vec3::Zero();
  double scale_ = 1;
};

// exp(theta_1 E_1) exp(theta_2 E_2) exp(theta_3 E_3); singular where |theta_2| = pi/2.
class CcskMap {
 public:
  bool set(const Vec3& theta) {
    first_ = Eigen::AngleAxisd(theta.x(), Vec3::UnitX()).toRotationMatrix();
    second_ = Eigen::AngleAxisd(theta.y(), Vec3::UnitY()).toRotationMatrix();
    third_ = Eigen::AngleAxisd(theta.z(), Vec3::UnitZ()).toRotationMatrix();
    right_.col(0) = Vec3::UnitX();
    right_.col(1) = first_.col(1);
    right_.col(2) = first_ * second_.col(2);
    return std::abs(theta.y()) < 0.5 * std::numbers::pi;
  }
  Mat3 rotation() const { return first_ * second_ * third_; }
  Mat3 turn() const { return rotation() - Mat3::Identity(); }
  Mat3 left_tangent() const { return rotation().transpose() * right_; }
  Vec3 momentum(const Vec3& L) const { return right_.transpose().inverse() * L; }
  Mat3 momentum_slope(const Vec3&, const Vec3& L, const Mat3& J, double h) const {
    const Mat3 dual = right_.transpose().inverse();
    const Vec3 y = dual * L;
    const Vec3 e1 = Vec3::UnitX(), second_axis = right_.col(1), third_axis = right_.col(2);
    Mat3 moved = Mat3::Zero();  // (d right / d theta)^T y, from differentiating right^T y = L
    moved(1, 0) = y.dot(e1.cross(second_axis));
    moved(2, 0) = y.dot(e1.cross(third_axis));
    moved(2, 1) = y.dot(first_ * Vec3::UnitY().cross(second_.col(2)));
    return dual * (J - h * moved);
  }

 private:
  Mat3 first_ = Mat3::Zero(), second_ = first_, third_ = first_, right_ = first_;
};

// One of the three, chosen for a run.
class Map {
 public:
  explicit Map(CoordinateMap map) {
    if (map == CoordinateMap::cayley) map_.emplace<CayleyMap>();
    if (map == CoordinateMap::ccsk) map_.emplace<CcskMap>();
  }
  bool set(const Vec3& theta) {
    return by([&](auto& map) { return map.set(theta); });
  }
  Mat3 rotation() {
    return by([](auto& map) { return map.rotation(); });
  }
  Mat3 turn() {
    return by([](auto& map) { return map.turn(); });
  }
  Mat3 left_tangent() {
    return by([](auto& map) { return map.left_tangent(); });
  }
  Vec3 momentum(const Vec3& L) {
    return by([&](auto& map) { return map.momentum(L); });
  }
  Mat3 momentum_slope(const Vec3& xi, const Vec3& L, const Mat3& J, double h) {
    return by([&](auto& map) { return map.momentum_slope(xi, L, J, h); });
  }

 private:
  // The exponential map is inlined, the others are not.
  template <class Use>
  auto by(const Use& use) -> decltype(use(std::declval<ExpMap&>())) {
    if (ExpMap* const map = std::get_if<ExpMap>(&map_)) return use(*map);
    return others(use);
  }
  template <class Use>
  [[gnu::noinline]] auto others(const Use& use) -> decltype(use(std::declval<ExpMap&>())) {
    CayleyMap* const map = std::get_if<CayleyMap>(&map_);
    return map ? use(*map) : use(std::get<CcskMap>(map_));
  }

  std::variant<ExpMap, CayleyMap, CcskMap> map_;
};

// theta of exp(hat theta) = R, |theta| < pi; accurate away from pi.
inline Vec3 logarithm(const Mat3& R) {
  const Vec3 axis = 0.5 * Vec3(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
  const double sine = axis.norm(), angle = std::atan2(sine, 0.5 * (R.trace() - 1));
  return sine < 1e-9 && angle < 1 ? axis : Vec3(angle / sine * axis);
}

// One Newton step towards the nearest rotation; accurate to rounding if R is already orthogonal to rounding. Returns
// the largest entry of R^T R - I before the step, which the step squares.
inline double polish(Mat3& R) {
  const Vec3 a = R.col(0), b = R.col(1), c = R.col(2);
  const double aa = 0.5 * (1 - a.dot(a)), bb = 0.5 * (1 - b.dot(b)), cc = 0.5 * (1 - c.dot(c));
  const double ab = -0.5 * a.dot(b), bc = -0.5 * b.dot(c), ca = -0.5 * c.dot(a);
  R.col(0) += aa * a + ab * b + ca * c;
  R.col(1) += ab * a + bb * b + bc * c;
  R.col(2) += ca * a + bc * b + cc * c;
  return 2 * std::max({std::abs(aa), std::abs(bb), std::abs(cc), std::abs(ab), std::abs(bc), std::abs(ca)});
}
inline Mat3 polished(Mat3 R) {
  polish(R);
  return R;
}
// The nearest rotation of a matrix that is not close to one: several steps.
inline Mat3 orthogonalised(Mat3 R) {
  constexpr double kLast = 1e-8;
  for (int k = 0; k < 8 && polish(R) >= kLast; ++k) {
  }
  return R;
}

}  // namespace lieeuler
