// Scalar functions that loops over them vectorize.
#pragma once
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

GV_INLINE float low(float a, float b) { return a < b ? a : b; }
GV_INLINE float high(float a, float b) { return a > b ? a : b; }

// log2 for positive normal x, to float32 accuracy; loops over it vectorize, which the library's would not.
GV_INLINE float log2_of(float x) {
  int32_t bits;
  __builtin_memcpy(&bits, &x, 4);
  int32_t exponent = (bits - 0x3f3504f3) >> 23;  // mantissa in [sqrt(1/2), sqrt(2))
  bits -= (int32_t)((uint32_t)exponent << 23);
  float m;
  __builtin_memcpy(&m, &bits, 4);
  float s = (m - 1.f) / (m + 1.f), s2 = s * s;
  float p = s2 * (s2 * (s2 * (s2 * 0.3205989f + 0.41219860f) + 0.57707802f) + 0.96179669f) + 2.8853901f;
  return (float)exponent + s * p;
}

}  // namespace gv::GV_NAMESPACE
