// SSIM of a plane with its gradient.
//
// One plane is streamed from top to bottom. Rows of x, y, x^2 + y^2 and (x - y)^2, centred, are filtered along the row
// and kept while a window needs them; of each finished row of the quotient three rows of derivatives are kept, until the
// row of the gradient that gathers them is complete. What is in flight is a few dozen rows, which stay in the cache.
#pragma once
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

constexpr int SSIM_MAPS = 4, SSIM_SLOPES = 3, SSIM_TAPS = 11;

// Floats of a row, with room for a vector beyond its end and for `taps` - 1 zeros before.
static int64_t ssim_stride(int32_t width, int32_t taps) { return (width + taps + 2 * LANES + 15) / 16 * 16; }

static size_t ssim_scratch_floats(int32_t width, int32_t taps_x, int32_t taps_y) {
  return (size_t)ssim_stride(width, taps_x) * (SSIM_MAPS + (SSIM_MAPS + SSIM_SLOPES) * taps_y + SSIM_SLOPES);
}

GV_INLINE V maximum0(V x) { return x > 0.f ? x : V{}; }

// out[j] = sum_k taps[k] in[j + k], j below `count` rounded up to whole vectors.
template <int SIZE>
GV_INLINE void filter_row(const float* in, const float* taps, int32_t taps_x, int64_t count, float* out) {
  const int32_t size = SIZE ? SIZE : taps_x;
  for (int64_t j = 0; j < count; j += LANES) {
    V sum = load(in + j) * taps[0];
    for (int32_t k = 1; k < size; k++) sum += load(in + j + k) * taps[k];
    store(out + j, sum);
  }
}

// out[j] = sum_k taps[k] in[k][j].
template <int SIZE>
GV_INLINE V filter_column(const float* const* in, const float* taps, int32_t size, int64_t j) {
  V sum = load(in[0] + j) * taps[0];
  for (int32_t k = 1; k < (SIZE ? SIZE : size); k++) sum += load(in[k] + j) * taps[k];
  return sum;
}

struct SsimRows {  // the last `size` rows of a map, by row number
  float* data;
  int64_t stride;
  int32_t size;
  float* row(int64_t number) const { return data + (number % size) * stride; }
};

template <int SIZE>
static void ssim_sized(int32_t height, int32_t width, int32_t taps_y, int32_t taps_x, const float* column,
                       const float* line, const float* x, const float* y, double* value, float* gradient,
                       float* scratch) {
  const float C1 = 0.01f * 0.01f, C2 = 0.03f * 0.03f;
  const int64_t stride = ssim_stride(width, taps_x), pixels = (int64_t)height * width;
  const int32_t out_h = height - taps_y + 1, out_w = width - taps_x + 1;
  for (size_t i = 0, n = ssim_scratch_floats(width, taps_x, taps_y); i < n; i++) scratch[i] = 0.f;
  float* raw = scratch;  // a row of each map before its filter
  SsimRows maps[SSIM_MAPS], slopes[SSIM_SLOPES];
  float* at = raw + SSIM_MAPS * stride;
  for (SsimRows& m : maps) m = {at, stride, taps_y}, at += taps_y * stride;
  for (SsimRows& s : slopes) s = {at, stride, taps_y}, at += taps_y * stride;
  float* gathered = at;  // a row of each slope, filtered along the column

  double total = 0;
  for (int64_t r = 0; r < height; r++) {
    const float *px = x + r * width, *py = y + r * width;
    V part{};
    int64_t c = 0;
    for (; c + LANES <= width; c += LANES) part += load(px + c) + load(py + c);
    for (; c < width; c++) total += px[c] + py[c];
    for (int i = 0; i < LANES; i++) total += part[i];
  }
  const float centre = (float)(total / 2 / pixels);

  double sum = 0;
  const double share = 1.0 / ((double)out_h * out_w);
  const int64_t last = gradient ? (int64_t)height + taps_y - 1 : height;
  for (int64_t r = 0; r < last; r++) {
    const int64_t o = r - (taps_y - 1);  // the row of the quotient that row r of the images completes
    if (r < height) {
      const float *px = x + r * width, *py = y + r * width;
      for (int64_t c = 0; c < width; c++) {
        float a = px[c] - centre, b = py[c] - centre;
        raw[c] = a, raw[stride + c] = b, raw[2 * stride + c] = a * a + b * b, raw[3 * stride + c] = (a - b) * (a - b);
      }
      for (int m = 0; m < SSIM_MAPS; m++)
        filter_row<SIZE>(raw + m * stride, line, taps_x, out_w, maps[m].row(r));
    }
    if (o >= 0 && o < out_h) {
      float* slope[SSIM_SLOPES];
      for (int s = 0; s < SSIM_SLOPES; s++) slope[s] = slopes[s].row(o) + (taps_x - 1);
      const float* window[SSIM_MAPS][SSIM_TAPS];
      for (int k = 0; k < SSIM_MAPS; k++)
        for (int32_t t = 0; t < taps_y; t++) window[k][t] = maps[k].row(o + t);
      V row_sum{};
      for (int64_t j = 0; j < out_w; j += LANES) {
        V m[SSIM_MAPS];
        for (int k = 0; k < SSIM_MAPS; k++) m[k] = filter_column<SIZE>(window[k], column, taps_y, j);
        V mean_d = m[0] - m[1], bright_x = m[0] + centre, bright_y = m[1] + centre;
        V var_sum = m[2] - m[0] * m[0] - m[1] * m[1], var_d = m[3] - mean_d * mean_d;
        V a = 1.f / (bright_x * bright_x + bright_y * bright_y + C1), b = 1.f / (maximum0(var_sum) + C2);
        V ratio_l = mean_d * mean_d * a, ratio_s = maximum0(var_d) * b;
        V luminance = 1.f - ratio_l, structure = 1.f - ratio_s, product = luminance * structure;
        V by_power = var_sum >= 0.f ? luminance * ratio_s * b : V{};
        V by_power_d = var_d >= 0.f ? -luminance * b : V{};
        V by_mean = structure * 2.f * a * (ratio_l * bright_x - mean_d) - 2.f * (by_power * m[0] + by_power_d * mean_d);
        int64_t left = out_w - j;
        if (left < LANES) {
          I lane;
          for (int i = 0; i < LANES; i++) lane[i] = i;
          I inside = lane < (int32_t)left;
          product = keep(inside, product), by_mean = keep(inside, by_mean);
          by_power = keep(inside, by_power), by_power_d = keep(inside, by_power_d);
        }
        row_sum += product;
        if (gradient) store(slope[0] + j, by_mean), store(slope[1] + j, by_power), store(slope[2] + j, by_power_d);
      }
      for (int i = 0; i < LANES; i++) sum += row_sum[i];
    } else if (o >= out_h) {  // below the last window there are no derivatives
      for (int s = 0; s < SSIM_SLOPES; s++) {
        float* row = slopes[s].row(o);
        for (int64_t j = 0; j < stride; j++) row[j] = 0.f;
      }
    }
    if (!gradient || o < 0) continue;
    // Row o of the gradient sees the windows whose first row is o - taps_y + 1 to o. Windows above the image have zero
    // rows still, and each row has zeros before and behind it.
    const int64_t span = width + taps_x - 1;
    for (int s = 0; s < SSIM_SLOPES; s++) {
      const float* seen[SSIM_TAPS];
      for (int32_t t = 0; t < taps_y; t++) seen[t] = slopes[s].row(o + taps_y - t);
      for (int64_t j = 0; j < span; j += LANES)
        store(gathered + s * stride + j, filter_column<SIZE>(seen, column, taps_y, j));
    }
    const float *px = x + o * width, *py = y + o * width;
    float *by_mean = raw, *by_power = raw + stride, *by_power_d = raw + 2 * stride;  // raw's row is not needed any more
    for (int s = 0; s < SSIM_SLOPES; s++) filter_row<SIZE>(gathered + s * stride, line, taps_x, width, raw + s * stride);
    float* out = gradient + o * width;
    for (int64_t c = 0; c < width; c++)
      out[c] = (float)share * (by_mean[c] + 2.f * ((px[c] - centre) * by_power[c] + (px[c] - py[c]) * by_power_d[c]));
    for (int64_t m = 0; m < SSIM_MAPS; m++)  // the filter above reads past the row's end
      for (int64_t c = width; c < stride; c++) raw[m * stride + c] = 0.f;
  }
  *value = sum * share;
}

static void ssim_plane(int32_t height, int32_t width, int32_t taps_y, int32_t taps_x, const float* column,
                       const float* line, const float* x, const float* y, double* value, float* gradient,
                       float* scratch) {
  bool full = taps_y == SSIM_TAPS && taps_x == SSIM_TAPS;
  (full ? ssim_sized<SSIM_TAPS> : ssim_sized<0>)(height, width, taps_y, taps_x, column, line, x, y, value, gradient,
                                                 scratch);
}

}  // namespace gv::GV_NAMESPACE
