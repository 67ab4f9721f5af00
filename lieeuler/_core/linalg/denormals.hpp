// While an object of this class exists, numbers below 1e-308 count as zero. Along a chain of hundreds of bodies the
// influence of one end on the other decays through that range, where an operation takes a hundred times as long.
#pragma once

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

namespace lieeuler {

class FlushDenormals {
 public:
#if defined(__SSE2__)
  FlushDenormals() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | kFlushToZero | kDenormalsAreZero); }
  ~FlushDenormals() { _mm_setcsr(saved_); }

 private:
  static constexpr unsigned kFlushToZero = 0x8000, kDenormalsAreZero = 0x0040;
  unsigned saved_;
#else
  FlushDenormals() = default;
#endif
  FlushDenormals(const FlushDenormals&) = delete;
  FlushDenormals& operator=(const FlushDenormals&) = delete;
};

}  // namespace lieeuler
