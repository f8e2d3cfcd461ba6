// Scalar functions of which the compiler makes vectors where a loop calls them.
#pragma once
#include <stdint.h>

#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// Of a NaN and a number, the second argument: so clamp() of NaN is `least`.
GV_INLINE float smaller(float a, float b) { return a < b ? a : b; }
GV_INLINE float larger(float a, float b) { return a > b ? a : b; }
GV_INLINE float clamp(float x, float least, float most) { return smaller(larger(x, least), most); }

// log2 for positive normal x, to float32 accuracy: 2^exponent m with m in [sqrt(1/2), sqrt(2)), and
// log2 m as an odd polynomial of s = (m - 1) / (m + 1). The library's log2f would not vectorize.
GV_INLINE float log2_of(float x) {
  int32_t bits;
  __builtin_memcpy(&bits, &x, 4);
  int32_t exponent = (bits - 0x3f3504f3) >> 23;  // 0x3f3504f3 is sqrt(1/2)
  bits -= (int32_t)((uint32_t)exponent << 23);
  float m;
  __builtin_memcpy(&m, &bits, 4);
  float s = (m - 1.f) / (m + 1.f), s2 = s * s;
  float p = s2 * 0.3205989f + 0.41219860f;
  p = s2 * p + 0.57707802f;
  p = s2 * p + 0.96179669f;
  p = s2 * p + 2.8853901f;
  return (float)exponent + s * p;
}

}  // namespace gv::GV_NAMESPACE
