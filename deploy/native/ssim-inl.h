// SSIM of a plane with its gradient.
//
// One plane is streamed from top to bottom. Rows of x, y, x^2 + y^2 and (x - y)^2, centred, are
// filtered along the row and kept while a window needs them; of each finished row of the quotient
// three rows of derivatives are kept, until the row of the gradient that gathers them is complete.
// What is in flight is a few dozen rows, which stay in the cache.
#pragma once
#include <stddef.h>
#include <stdint.h>

#include "kernels.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

constexpr int SSIM_MAPS = 4;  // x, y, x^2 + y^2, (x - y)^2
// Derivatives of the quotient, as the windows gather them: by x alone, by x^2 + y^2, by (x - y)^2.
constexpr int SSIM_SLOPES = 3;
constexpr float SSIM_C1 = 0.01f * 0.01f, SSIM_C2 = 0.03f * 0.03f;

// Floats of a row, with room for a vector beyond its end and for `taps` - 1 zeros before.
static int64_t ssim_stride(int32_t width, int32_t taps) {
  return (width + taps + 2 * LANES + 15) / 16 * 16;
}

static size_t ssim_scratch_floats(int32_t width, int32_t taps_x, int32_t taps_y) {
  return (size_t)ssim_stride(width, taps_x) *
         (SSIM_MAPS + (SSIM_MAPS + SSIM_SLOPES) * taps_y + SSIM_SLOPES);
}

GV_INLINE V maximum0(V x) { return x > 0.f ? x : V{}; }

// out[j] = sum_k taps[k] in[j + k], j below `count` rounded up to whole vectors. SIZE: the number
// of taps where it is known.
template <int SIZE>
GV_INLINE void filter_row(const float* in, const float* taps, int32_t taps_x, int64_t count,
                          float* out) {
  const int32_t size = SIZE ? SIZE : taps_x;
  for (int64_t j = 0; j < count; j += LANES) {
    V sum = load(in + j) * taps[0];
    for (int32_t k = 1; k < size; k++) sum += load(in + j + k) * taps[k];
    store(out + j, sum);
  }
}

// sum_k taps[k] in[k][j], and of the lanes after j.
template <int SIZE>
GV_INLINE V filter_column(const float* const* in, const float* taps, int32_t size, int64_t j) {
  V sum = load(in[0] + j) * taps[0];
  for (int32_t k = 1; k < (SIZE ? SIZE : size); k++) sum += load(in[k] + j) * taps[k];
  return sum;
}

// The last `size` rows of a map, by row number.
struct SsimRows {
  float* data;
  int64_t stride;
  int32_t size;
  float* row(int64_t number) const { return data + (number % size) * stride; }
};

// Half the mean of both planes. What is near it loses fewest digits when it is squared.
GV_INLINE float ssim_centre(int32_t height, int32_t width, const float* x, const float* y) {
  const int64_t pixels = (int64_t)height * width;
  double total = 0;
  for (int64_t r = 0; r < height; r++) {
    const float *px = x + r * width, *py = y + r * width;
    V part{};
    int64_t c = 0;
    for (; c + LANES <= width; c += LANES) part += load(px + c) + load(py + c);
    for (; c < width; c++) total += px[c] + py[c];
    for (int i = 0; i < LANES; i++) total += part[i];
  }
  return (float)(total / 2 / pixels);
}

// The quotient of LANES windows, and its slopes.
struct SsimQuotient {
  V value, by_mean, by_power, by_power_d;
};
// From the windows' means of the maps. luminance x structure, each as 1 minus what differs:
//   luminance = 1 - (mean x - mean y)^2 / (mean x^2 + mean y^2 + C1),
//   structure = 1 - var(x - y) / (var x + var y + C2).
GV_INLINE SsimQuotient ssim_quotient(const V m[SSIM_MAPS], float centre) {
  V mean_d = m[0] - m[1], bright_x = m[0] + centre, bright_y = m[1] + centre;
  V var_sum = m[2] - m[0] * m[0] - m[1] * m[1], var_d = m[3] - mean_d * mean_d;
  V a = 1.f / (bright_x * bright_x + bright_y * bright_y + SSIM_C1);
  V b = 1.f / (maximum0(var_sum) + SSIM_C2);
  V ratio_l = mean_d * mean_d * a, ratio_s = maximum0(var_d) * b;
  V luminance = 1.f - ratio_l, structure = 1.f - ratio_s;
  SsimQuotient q;
  q.value = luminance * structure;
  q.by_power = var_sum >= 0.f ? luminance * ratio_s * b : V{};
  q.by_power_d = var_d >= 0.f ? -luminance * b : V{};
  // the means stand in the luminance and, squared, in both variances
  q.by_mean = structure * 2.f * a * (ratio_l * bright_x - mean_d) -
              2.f * (q.by_power * m[0] + q.by_power_d * mean_d);
  return q;
}
// 0 in all lanes but the first `left`.
GV_INLINE void keep_first(SsimQuotient& q, int32_t left) {
  I lane;
  for (int i = 0; i < LANES; i++) lane[i] = i;
  I inside = lane < left;
  q.value = keep(inside, q.value), q.by_mean = keep(inside, q.by_mean);
  q.by_power = keep(inside, q.by_power), q.by_power_d = keep(inside, q.by_power_d);
}

// A plane on its way through the scratch memory, which is zero at first.
struct SsimStream {
  int32_t height, width, taps_y, taps_x;
  const float *column, *line, *x, *y;
  int64_t stride;
  float centre;
  float* raw;                    // a row of each map before its filter
  SsimRows maps[SSIM_MAPS];      // rows filtered along the line
  SsimRows slopes[SSIM_SLOPES];  // rows of derivatives, `taps_x` - 1 zeros before them
  float* gathered;               // a row of each slope, filtered along the column

  int32_t out_height() const { return height - taps_y + 1; }
  int32_t out_width() const { return width - taps_x + 1; }
};

GV_INLINE void lay_out(SsimStream& s, float* scratch) {
  s.stride = ssim_stride(s.width, s.taps_x);
  s.raw = scratch;
  float* at = scratch + SSIM_MAPS * s.stride;
  for (SsimRows& m : s.maps) m = {at, s.stride, s.taps_y}, at += s.taps_y * s.stride;
  for (SsimRows& m : s.slopes) m = {at, s.stride, s.taps_y}, at += s.taps_y * s.stride;
  s.gathered = at;
}

// Row r of the images to the maps.
template <int SIZE>
GV_INLINE void ssim_read_row(const SsimStream& s, int64_t r) {
  const float *px = s.x + r * s.width, *py = s.y + r * s.width;
  float* raw = s.raw;
  for (int64_t c = 0; c < s.width; c++) {
    float a = px[c] - s.centre, b = py[c] - s.centre;
    raw[c] = a;
    raw[s.stride + c] = b;
    raw[2 * s.stride + c] = a * a + b * b;
    raw[3 * s.stride + c] = (a - b) * (a - b);
  }
  for (int m = 0; m < SSIM_MAPS; m++)
    filter_row<SIZE>(raw + m * s.stride, s.line, s.taps_x, s.out_width(), s.maps[m].row(r));
}

// The sum of row o of the quotient by lanes, and with `slopes` its derivatives.
template <int SIZE>
GV_INLINE V ssim_quotient_row(const SsimStream& s, int64_t o, bool slopes) {
  float* slope[SSIM_SLOPES];
  for (int k = 0; k < SSIM_SLOPES; k++) slope[k] = s.slopes[k].row(o) + (s.taps_x - 1);
  const float* window[SSIM_MAPS][SSIM_TAPS];
  for (int k = 0; k < SSIM_MAPS; k++)
    for (int32_t t = 0; t < s.taps_y; t++) window[k][t] = s.maps[k].row(o + t);
  V row_sum{};
  for (int64_t j = 0; j < s.out_width(); j += LANES) {
    V m[SSIM_MAPS];
    for (int k = 0; k < SSIM_MAPS; k++)
      m[k] = filter_column<SIZE>(window[k], s.column, s.taps_y, j);
    SsimQuotient q = ssim_quotient(m, s.centre);
    int64_t left = s.out_width() - j;
    if (left < LANES) keep_first(q, (int32_t)left);
    row_sum += q.value;
    if (slopes) {
      store(slope[0] + j, q.by_mean);
      store(slope[1] + j, q.by_power);
      store(slope[2] + j, q.by_power_d);
    }
  }
  return row_sum;
}

// Row o of the gradient, from the windows whose first row is o - taps_y + 1 to o. Windows above the
// image have zero rows still, and each row has zeros before and behind it. `share`: of a window in
// the mean.
template <int SIZE>
GV_INLINE void ssim_gradient_row(const SsimStream& s, int64_t o, float share, float* out) {
  const int64_t span = s.width + s.taps_x - 1;
  for (int k = 0; k < SSIM_SLOPES; k++) {
    const float* seen[SSIM_TAPS];
    for (int32_t t = 0; t < s.taps_y; t++) seen[t] = s.slopes[k].row(o + s.taps_y - t);
    for (int64_t j = 0; j < span; j += LANES)
      store(s.gathered + k * s.stride + j, filter_column<SIZE>(seen, s.column, s.taps_y, j));
  }
  float* raw = s.raw;  // its row is not needed any more
  for (int k = 0; k < SSIM_SLOPES; k++)
    filter_row<SIZE>(s.gathered + k * s.stride, s.line, s.taps_x, s.width, raw + k * s.stride);
  const float *px = s.x + o * s.width, *py = s.y + o * s.width;
  const float *by_mean = raw, *by_power = raw + s.stride, *by_power_d = raw + 2 * s.stride;
  for (int64_t c = 0; c < s.width; c++)
    out[c] = share * (by_mean[c] +
                      2.f * ((px[c] - s.centre) * by_power[c] + (px[c] - py[c]) * by_power_d[c]));
  for (int64_t m = 0; m < SSIM_MAPS; m++)  // the filter above reads past the row's end
    for (int64_t c = s.width; c < s.stride; c++) raw[m * s.stride + c] = 0.f;
}

template <int SIZE>
static void ssim_sized(int32_t height, int32_t width, int32_t taps_y, int32_t taps_x,
                       const float* column, const float* line, const float* x, const float* y,
                       double* value, float* gradient, float* scratch) {
  SsimStream s{};
  s.height = height, s.width = width, s.taps_y = taps_y, s.taps_x = taps_x;
  s.column = column, s.line = line, s.x = x, s.y = y;
  lay_out(s, scratch);
  for (size_t i = 0, n = ssim_scratch_floats(width, taps_x, taps_y); i < n; i++) scratch[i] = 0.f;
  s.centre = ssim_centre(height, width, x, y);
  double sum = 0;
  const double share = 1.0 / ((double)s.out_height() * s.out_width());
  const int64_t last = gradient ? (int64_t)height + taps_y - 1 : height;
  for (int64_t r = 0; r < last; r++) {
    const int64_t o = r - (taps_y - 1);  // row of the quotient that row r of the images completes
    if (r < height) ssim_read_row<SIZE>(s, r);
    if (o >= 0 && o < s.out_height()) {
      V row_sum = ssim_quotient_row<SIZE>(s, o, gradient != nullptr);
      for (int i = 0; i < LANES; i++) sum += row_sum[i];
    } else if (o >= s.out_height()) {  // below the last window there are no derivatives
      for (const SsimRows& slope : s.slopes) {
        float* row = slope.row(o);
        for (int64_t j = 0; j < s.stride; j++) row[j] = 0.f;
      }
    }
    if (gradient && o >= 0) ssim_gradient_row<SIZE>(s, o, (float)share, gradient + o * width);
  }
  *value = sum * share;
}

static void ssim_plane(int32_t height, int32_t width, int32_t taps_y, int32_t taps_x,
                       const float* column, const float* line, const float* x, const float* y,
                       double* value, float* gradient, float* scratch) {
  bool full = taps_y == SSIM_TAPS && taps_x == SSIM_TAPS;
  (full ? ssim_sized<SSIM_TAPS> : ssim_sized<0>)(height, width, taps_y, taps_x, column, line, x, y,
                                                 value, gradient, scratch);
}

}  // namespace gv::GV_NAMESPACE
