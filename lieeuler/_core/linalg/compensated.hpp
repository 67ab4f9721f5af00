// Compensated sums (Knuth's two-sum; Higham, Accuracy and Stability of Numerical Algorithms, 4.3).
#pragma once

#include <cmath>

#include "model/system.hpp"

namespace lieeuler {

// sum += change + lost; `lost` becomes the rounding error of this sum. Rounding errors in `change` are not corrected.
template <class Values>
void add_compensated(Values& sum, const Values& change, Values& lost) {
  const Values before = sum, whole = change + lost;
  sum = before + whole;
  const Values seen = sum - before;  // of `whole`
  lost = (before - (sum - seen)) + (whole - seen);
}
inline void add_compensated(Twist& sum, const Twist& change, Twist& lost) {
  add_compensated(sum.v, change.v, lost.v), add_compensated(sum.w, change.w, lost.w);
}

// start + a . b as accurate as in twice the working precision (Ogita, Rump and Oishi, doi:10.1137/030601818).
inline double dot_accurately(const Vec3& a, const Vec3& b, double start) {
  double sum = start, lost = 0;
  for (int i = 0; i < 3; ++i) {
    const double product = a[i] * b[i], next = sum + product, seen = next - sum;
    lost += std::fma(a[i], b[i], -product) + ((sum - (next - seen)) + (product - seen));
    sum = next;
  }
  return sum + lost;
}

// Moves a configuration step by step with compensated sums.
class CompensatedFrame {
 public:
  // `frame` <- `frame` * (dx, E), with turn = E - I.
  void move(Frame& frame, const Vec3& dx, const Mat3& turn) {
    add_compensated(frame.x, dx, x_);
    const Mat3 change = (frame.R + R_) * turn;
    add_compensated(frame.R, change, R_);
    // Over 32 moves the rounding errors of the turns add up to far less than one rounding error of R.
    if (++moves_ % kMovesApart == 0) straighten(frame.R);
  }

 private:
  static constexpr int kMovesApart = 32;

  // Moves R plus its lost part towards the nearest rotation. Only for a rotation do reactions do no work and exert no
  // moment: a defect that stays from step to step, even far below rounding of R, lets the momentum drift.
  void straighten(Mat3& R) {
    Mat3 half;  // of I - (R + lost)^T (R + lost)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j <= i; ++j) {
        const double product = dot_accurately(R.col(i), R.col(j), i == j ? -1 : 0);
        half(i, j) = half(j, i) = -0.5 * (product + R_.col(i).dot(R.col(j)) + R.col(i).dot(R_.col(j)));
      }
    add_compensated(R, Mat3(R * half), R_);
  }

  Vec3 x_ = Vec3::Zero();
  Mat3 R_ = Mat3::Zero();
  int moves_ = 0;
};

}  // namespace lieeuler
