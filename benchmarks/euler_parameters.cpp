// The classical Runge-Kutta rule on the index-1 equations of one body on a ball joint: on the Lie group, with a
// constant mass matrix, and in Euler parameters, whose mass matrix changes with the attitude. That of one body has an
// inverse in closed form.
//
//   euler_parameters FORM STEPS DURATION      FORM: lie, factored or inverse; prints x at the end and |p| - 1
#include <Eigen/Dense>
#include <cstdio>
#include <cstdlib>
#include <cstring>

using Vec3 = Eigen::Vector3d;
using Vec4 = Eigen::Vector4d;
using Mat3 = Eigen::Matrix3d;
using Mat34 = Eigen::Matrix<double, 3, 4>;

// The scene single_pendulum.
const double kMass = 1;
const Vec3 kInertia(0.1, 0.2, 0.15), kAnchor(0, 0, 1), kGravity(0, 0, -9.81), kRate(0.5, 0.3, 1);
const Vec4 kAttitude(std::sqrt(0.75), 0, 0.5, 0);

Mat3 hat(const Vec3& a) {
  Mat3 A;
  A << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return A;
}
Mat34 L(const Vec4& p) {  // w = 2 L dp/dt, body axes
  Mat34 l;
  l << -p[1], p[0], p[3], -p[2], -p[2], -p[3], p[0], p[1], -p[3], p[2], -p[1], p[0];
  return l;
}
Mat3 rotation(const Vec4& p) { return Eigen::Quaterniond(p[0], p[1], p[2], p[3]).toRotationMatrix(); }
Vec3 gyroscopic(const Vec3& w) { return -w.cross(kInertia.cwiseProduct(w)); }

struct Lie {
  Vec3 x, v, w;
  Mat3 R;
  struct Rate {
    Vec3 x, theta, v, w;
  };
  static Mat3 exponential(const Vec3& theta) {
    const double t = theta.norm();
    const Mat3 X = hat(theta);
    if (t < 1e-4) return Mat3::Identity() + X + X * X / 2;
    return Mat3::Identity() + std::sin(t) / t * X + (1 - std::cos(t)) / (t * t) * X * X;
  }
  Rate rate(const Vec3& theta, const Vec3& v_, const Vec3& w_) const {
    const Mat3 R_ = R * exponential(theta), lever = R_ * hat(kAnchor);
    const Mat3 S = Mat3::Identity() / kMass + lever * kInertia.cwiseInverse().asDiagonal() * lever.transpose();
    const Vec3 free = kInertia.cwiseInverse().cwiseProduct(gyroscopic(w_));
    const Vec3 lam = S.llt().solve(kGravity - lever * free + R_ * w_.cross(w_.cross(kAnchor)));
    const Vec3 turn = kInertia.cwiseInverse().cwiseProduct(gyroscopic(w_) + lever.transpose() * lam);
    const Vec3 cross = theta.cross(w_);
    const double t2 = theta.squaredNorm(), c = 1.0 / 12 + t2 / 720;  // inverse tangent of exp, to t^4 in a step
    return {v_, w_ + 0.5 * cross + c * theta.cross(cross), kGravity - lam / kMass, turn};
  }
  void step(double h) {
    const Vec3 zero = Vec3::Zero();
    const Rate a = rate(zero, v, w);
    const Rate b = rate(h / 2 * a.theta, v + h / 2 * a.v, w + h / 2 * a.w);
    const Rate c = rate(h / 2 * b.theta, v + h / 2 * b.v, w + h / 2 * b.w);
    const Rate d = rate(h * c.theta, v + h * c.v, w + h * c.w);
    x += h / 6 * (a.x + 2 * b.x + 2 * c.x + d.x);
    R *= exponential(h / 6 * (a.theta + 2 * b.theta + 2 * c.theta + d.theta));
    v += h / 6 * (a.v + 2 * b.v + 2 * c.v + d.v);
    w += h / 6 * (a.w + 2 * b.w + 2 * c.w + d.w);
  }
};

template <bool factor>
struct Parameters {
  Vec3 x, v;
  Vec4 p, dp;
  struct Rate {
    Vec3 x, v;
    Vec4 p, dp;
  };
  // 4 L^T J L is singular along p; p p^T added there changes nothing but the component that |p| = 1 prescribes.
  static Rate rate(const Vec4& p, const Vec3& v, const Vec4& dp) {
    const Mat34 l = L(p);
    const Vec3 w = 2 * l * dp;
    const Mat3 R = rotation(p);
    const Mat34 lever = 2 * R * hat(kAnchor) * l;
    const Vec4 force = 2 * l.transpose() * gyroscopic(w) - p * dp.squaredNorm();
    Eigen::Matrix<double, 4, 3> columns;
    Vec4 free;
    if constexpr (factor) {
      const Eigen::Matrix4d mass = 4 * l.transpose() * kInertia.asDiagonal() * l + p * p.transpose();
      const Eigen::LLT<Eigen::Matrix4d> factored(mass);
      columns = factored.solve(lever.transpose());
      free = factored.solve(force);
    } else {  // as L L^T = |p|^2 and L p = 0
      const double size = p.squaredNorm();
      const Eigen::Matrix4d inverse =
          (l.transpose() * (kInertia.cwiseInverse() / 4).asDiagonal() * l + p * p.transpose()) / (size * size);
      columns = inverse * lever.transpose();
      free = inverse * force;
    }
    const Mat3 S = Mat3::Identity() / kMass + lever * columns;
    const Vec3 lam = S.llt().solve(kGravity - lever * free + R * w.cross(w.cross(kAnchor)));
    return {v, kGravity - lam / kMass, dp, free + columns * lam};
  }
  void step(double h) {
    const Rate a = rate(p, v, dp);
    const Rate b = rate(p + h / 2 * a.p, v + h / 2 * a.v, dp + h / 2 * a.dp);
    const Rate c = rate(p + h / 2 * b.p, v + h / 2 * b.v, dp + h / 2 * b.dp);
    const Rate d = rate(p + h * c.p, v + h * c.v, dp + h * c.dp);
    x += h / 6 * (a.x + 2 * b.x + 2 * c.x + d.x);
    v += h / 6 * (a.v + 2 * b.v + 2 * c.v + d.v);
    p += h / 6 * (a.p + 2 * b.p + 2 * c.p + d.p);
    dp += h / 6 * (a.dp + 2 * b.dp + 2 * c.dp + d.dp);
  }
};

template <class Form>
Form after(Form form, long steps, double h) {
  for (long k = 0; k < steps; ++k) form.step(h);
  return form;
}

int main(int, char** argv) {
  const long steps = std::atol(argv[2]);
  const double h = std::atof(argv[3]) / steps;
  const Mat3 R = rotation(kAttitude);
  const Vec3 x = -R * kAnchor, v = -R * kRate.cross(kAnchor);
  const Vec4 dp = 0.5 * L(kAttitude).transpose() * kRate;
  Vec3 end;
  double drift;
  const auto read = [&](const auto& last) { end = last.x, drift = std::abs(last.p.norm() - 1); };
  if (std::strcmp(argv[1], "lie") == 0) {
    const Lie last = after(Lie{x, v, kRate, R}, steps, h);
    end = last.x, drift = (last.R.transpose() * last.R - Mat3::Identity()).cwiseAbs().maxCoeff();
  } else if (std::strcmp(argv[1], "factored") == 0) {
    read(after(Parameters<true>{x, v, kAttitude, dp}, steps, h));
  } else {
    read(after(Parameters<false>{x, v, kAttitude, dp}, steps, h));
  }
  std::printf("%.17g %.17g %.17g %.3g\n", end.x(), end.y(), end.z(), drift);
}
