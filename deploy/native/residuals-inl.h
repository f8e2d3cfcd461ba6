// Residuals of the pose: points, colours and scales as base + residual, eight floats a Gaussian.
#pragma once
#include <stdint.h>

#include "index-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

typedef float R8 __attribute__((vector_size(32)));
typedef int32_t I8 __attribute__((vector_size(32)));

// One Gaussian's x y z r g b s: colours clipped to [0, 1], the scale to 0 and up.
GV_INLINE void write_attributes(int64_t n, const R8& x, float* points, float* colors,
                                float* scales) {
  for (int c = 0; c < 3; c++) points[3 * n + c] = x[c];
  for (int c = 0; c < 3; c++) {
    float v = x[3 + c];
    v = v > 0.f ? v : 0.f;
    colors[3 * n + c] = v < 1.f ? v : 1.f;
  }
  scales[n] = x[6] > 0.f ? x[6] : 0.f;
}

// The four bases of a group stand in the four bytes of a lane: shifts unpack them four times faster
// than widening bytes, for which compilers of the day write scalar code. (Byte 0 is the lowest:
// little-endian machines only, as all are here.)
static bool blendshapes(int64_t begin, int64_t end, int32_t groups, int32_t parts,
                        const float* base, const uint8_t* part, const int8_t* basis,
                        const float* coefficients, const float* gains, float* points, float* colors,
                        float* scales) {
  for (int64_t n = begin; n < end; n++) {
    if (part[n] >= parts) return false;
    const float* w = coefficients + (int64_t)part[n] * groups * 4;
    const int8_t* row = basis + n * groups * 32;
    R8 sum{}, gain, x;
    for (int g = 0; g < groups; g++) {
      I8 b;
      __builtin_memcpy(&b, row + 32 * g, 32);
      // each byte to the top of its lane, and down again with its sign
      sum += __builtin_convertvector((b << 24) >> 24, R8) * w[4 * g];
      sum += __builtin_convertvector((b << 16) >> 24, R8) * w[4 * g + 1];
      sum += __builtin_convertvector((b << 8) >> 24, R8) * w[4 * g + 2];
      sum += __builtin_convertvector(b >> 24, R8) * w[4 * g + 3];
    }
    __builtin_memcpy(&gain, gains + 8 * part[n], 32);
    __builtin_memcpy(&x, base + 8 * n, 32);
    write_attributes(n, x + sum * gain, points, colors, scales);
  }
  return true;
}

static bool upsample(int64_t begin, int64_t end, int32_t slots, int32_t rows, const float* base,
                     const int32_t* index, const float* weight, const float* table, float* points,
                     float* colors, float* scales) {
  if (!in_range(index + begin * slots, (end - begin) * slots, rows)) return false;
  for (int64_t n = begin; n < end; n++) {
    R8 x, row;
    __builtin_memcpy(&x, base + 8 * n, 32);
    for (int k = 0; k < slots; k++) {
      __builtin_memcpy(&row, table + (int64_t)8 * index[n * slots + k], 32);
      x += row * weight[n * slots + k];
    }
    write_attributes(n, x, points, colors, scales);
  }
  return true;
}

}  // namespace gv::GV_NAMESPACE
