// A sparse matrix times a dense one, as feature maps are sampled in training.
#pragma once
#include <stdint.h>

#include "index-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// out[n] = sum of weight[k] table[index[k]] for k from offset[n] to offset[n + 1]; rows of
// `channels` floats.
static bool sparse_product(int64_t begin, int64_t end, int32_t channels, int32_t rows,
                           const int32_t* offset, const int32_t* index, const float* weight,
                           const float* table, float* out) {
  if (!in_range(index + offset[begin], offset[end] - offset[begin], rows)) return false;
  constexpr int WIDE = 4;  // sums in flight, lest each wait for the one before
  for (int64_t n = begin; n < end; n++) {
    float* to = out + n * channels;
    int32_t c = 0;
    for (; c + WIDE * LANES <= channels; c += WIDE * LANES) {
      V sum[WIDE] = {};
      for (int32_t k = offset[n]; k < offset[n + 1]; k++) {
        const float* from = table + (int64_t)index[k] * channels + c;
        for (int i = 0; i < WIDE; i++) sum[i] += load(from + i * LANES) * weight[k];
      }
      for (int i = 0; i < WIDE; i++) store(to + c + i * LANES, sum[i]);
    }
    for (; c + LANES <= channels; c += LANES) {
      V sum{};
      for (int32_t k = offset[n]; k < offset[n + 1]; k++)
        sum += load(table + (int64_t)index[k] * channels + c) * weight[k];
      store(to + c, sum);
    }
    for (; c < channels; c++) {
      float sum = 0;
      for (int32_t k = offset[n]; k < offset[n + 1]; k++)
        sum += table[(int64_t)index[k] * channels + c] * weight[k];
      to[c] = sum;
    }
  }
  return true;
}

}  // namespace gv::GV_NAMESPACE
