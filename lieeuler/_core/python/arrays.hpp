// Conversions between Python and the kernel.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdexcept>
#include <utility>

#include "run/outcome.hpp"

namespace lieeuler {

namespace nb = nanobind;

using Array = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<double, nb::c_contig, nb::device::cpu>;
using Made = nb::ndarray<nb::numpy, double>;
using Parts = nb::typed<nb::dict, nb::str, nb::any>;  // of a result, by their names

// Python checks values, with messages that name them. Here only input is refused that would read beyond memory or never
// end.
inline void require(bool fine, const char* what) {
  if (!fine) throw std::invalid_argument(what);
}

inline Made make_array(std::vector<double> data, std::initializer_list<size_t> shape) {
  auto* kept = new std::vector<double>(std::move(data));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
  return Made(kept->data(), shape.size(), shape.begin(), owner);
}

inline Mat3 mat3(const double* p) { return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(p); }
inline void put(std::vector<double>& out, size_t at, const Vec3& v) { std::copy_n(v.data(), 3, out.data() + at); }
inline void put(std::vector<double>& out, size_t at, const Mat3& R) {
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(out.data() + at) = R;
}

inline const char* name_of(Status status) {
  static constexpr const char* names[] = {"success",     "newton_failed",   "singular_matrix",
                                          "map_domain",  "non_finite",      "step_too_small",
                                          "interrupted", "constraints_open"};  // as in Status
  return names[static_cast<int>(status)];
}

// The state of a system in arrays (n, 3), (n, 3, 3), (n, 3) and (n, 3).
inline State load_state(const System& system, const double* x, const double* R, const double* v, const double* w) {
  State state(system);
  for (int b = 0; b < system.n(); ++b) {
    state.frames[b] = {load3(x + 3 * b), mat3(R + 9 * b)};
    state.u[b] = {load3(v + 3 * b), load3(w + 3 * b)};
  }
  return state;
}

// The state number `index` of those in the arrays.
inline State make_state(const System& system, const Array& x, const Array& R, const Array& v, const Array& w,
                        size_t index = 0) {
  const size_t n = system.n(), count = x.size() / (3 * n), at = index * n;
  require(index < count && x.size() == 3 * n * count && R.size() == 9 * n * count && v.size() == 3 * n * count &&
              w.size() == 3 * n * count,
          "x, R, v and w must be those of the system's bodies");
  return load_state(system, x.data() + 3 * at, R.data() + 9 * at, v.data() + 3 * at, w.data() + 3 * at);
}

}  // namespace lieeuler
