// x^(1/p) of positive numbers in a register, to 1e-8 and with the same bits on every processor: for step sizes.
#pragma once

#include <cstdint>

namespace lieeuler {

// 2^(log2(x) inverse), inverse = 1/p. Zero where x is. x = 2^e m: log2 m from the series of artanh about sqrt 2, 2^f of
// the rest f from that of exp.
template <class Number, class Bits>
[[gnu::always_inline]] inline Number root(const Number& x, const Number& inverse) {
  constexpr double kLog2 = 0.69314718055994531, kSqrt2 = 1.4142135623730951;
  constexpr double kUnits = 0x1p52, kRounding = 0x1.8p52;  // their last place is one
  constexpr std::uint64_t kOne = 0x3ff0000000000000, kMantissa = 0x000fffffffffffff, kUnitsBits = 0x4330000000000000;
  const Bits bits = (Bits)x;
  const Number exponent = (Number)((bits >> 52) | kUnitsBits) - (kUnits + 1023);
  const Number m = (Number)((bits & kMantissa) | kOne);
  const Number t = (m - kSqrt2) / (m + kSqrt2), s = t * t;
  const Number artanh = t * (1 + s * (1. / 3 + s * (1. / 5 + s * (1. / 7 + s * (1. / 9)))));
  const Number y = inverse * (exponent + 0.5 + (2 / kLog2) * artanh);
  const Number whole = y + kRounding, f = kLog2 * (y - (whole - kRounding));
  const Number power =
      1 + f * (1 + f * (1. / 2 + f * (1. / 6 + f * (1. / 24 + f * (1. / 120 + f * (1. / 720 + f * (1. / 5040)))))));
  const Number value = (Number)((Bits)power + ((Bits)whole << 52));
  return x > 0 ? value : Number{};
}

}  // namespace lieeuler
