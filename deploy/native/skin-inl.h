// Linear blend skinning with sparse weights.
#pragma once
#include <stdint.h>

#include "index-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// One point's blended 3x4 transform, as floats in a fixed-size loop that becomes vector code.
GV_INLINE void blended(int slots, int stride, const int32_t* index, const float* weight,
                       const float* A, float M[12]) {
  const float* a = A + (int64_t)stride * index[0];
  float w = weight[0];
  for (int c = 0; c < 12; c++) M[c] = w * a[c];
  for (int k = 1; k < slots; k++) {
    a = A + (int64_t)stride * index[k];
    w = weight[k];
    for (int c = 0; c < 12; c++) M[c] += w * a[c];
  }
}

constexpr int64_t SKIN_STRIP = 256;  // points whose indices are checked before they are used

// `columns`: (J, 4, 4), the columns of each joint's 3x4 transform, filled up to four floats, so
// that blending and applying are whole vectors. SLOTS: the number of slots where it is known, else
// 0.
template <int SLOTS>
static bool skin_slots(int64_t begin, int64_t end, int slots, int joints, const float* points,
                       const int32_t* index, const float* weight, const float* columns,
                       float* out) {
  int K = SLOTS ? SLOTS : slots;
  for (int64_t strip = begin; strip < end; strip += SKIN_STRIP) {
    int64_t stop = strip + SKIN_STRIP < end ? strip + SKIN_STRIP : end;
    if (!in_range(index + strip * K, (stop - strip) * K, joints)) return false;
    for (int64_t n = strip; n < stop; n++) {
      const int32_t* joint = index + n * K;
      const float *w = weight + n * K, *p = points + 3 * n, *A = columns + 16 * joint[0];
      Four x = load4(A) * w[0], y = load4(A + 4) * w[0];
      Four z = load4(A + 8) * w[0], t = load4(A + 12) * w[0];
      for (int k = 1; k < K; k++) {
        A = columns + 16 * joint[k];
        x += load4(A) * w[k], y += load4(A + 4) * w[k];
        z += load4(A + 8) * w[k], t += load4(A + 12) * w[k];
      }
      Four moved = x * p[0] + (y * p[1] + (z * p[2] + t));
      __builtin_memcpy(out + 3 * n, &moved, 12);
    }
  }
  return true;
}

static bool skin(int64_t begin, int64_t end, int32_t slots, int32_t joints, const float* points,
                 const int32_t* index, const float* weight, const float* columns, float* out) {
  return (slots == 4 ? skin_slots<4> : skin_slots<0>)(begin, end, slots, joints, points, index,
                                                      weight, columns, out);
}

// `grad_transforms` is added to.
static bool skin_backward(int64_t begin, int64_t end, int32_t slots, int32_t joints, int32_t stride,
                          const float* points, const int32_t* index, const float* weight,
                          const float* transforms, const float* grad_out, float* grad_points,
                          float* grad_transforms) {
  if (!in_range(index + begin * slots, (end - begin) * slots, joints)) return false;
  for (int64_t n = begin; n < end; n++) {
    const float *g = grad_out + 3 * n, *p = points + 3 * n;
    const int32_t* idx = index + n * slots;
    const float* w = weight + n * slots;
    if (grad_points) {
      float M[12];
      blended(slots, stride, idx, w, transforms, M);
      for (int c = 0; c < 3; c++)
        grad_points[3 * n + c] = M[c] * g[0] + M[4 + c] * g[1] + M[8 + c] * g[2];
    }
    if (grad_transforms) {
      float outer[12];  // dL/d(blended transform) = g (p, 1)^T
      for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++) outer[4 * r + c] = g[r] * p[c];
        outer[4 * r + 3] = g[r];
      }
      for (int k = 0; k < slots; k++) {
        float* to = grad_transforms + (int64_t)stride * idx[k];
        for (int c = 0; c < 12; c++) to[c] += w[k] * outer[c];
      }
    }
  }
  return true;
}

}  // namespace gv::GV_NAMESPACE
