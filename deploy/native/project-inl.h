// Projection of Gaussians to records and tile entries.
#pragma once
#include "bins-inl.h"
#include "covariance-inl.h"
#include "kernels.h"
#include "scalars-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

struct Projected {
  alignas(64) float u[BATCH], v[BATCH], x[BATCH], y[BATCH], yx[BATCH], r[BATCH], g[BATCH], b[BATCH];
};

static void store_records(const Projected& s, Record* out) {
  const float* rows = s.u;
#if GV_LANES == 8
  for (int done = 0; done < BATCH; done += 8) {
    V m[8];
    for (int k = 0; k < 8; k++) m[k] = load(rows + k * BATCH + done);
    transpose(m);
    for (int k = 0; k < 8; k++) store(&out[done + k].u, m[k]);
  }
#else
  for (int j = 0; j < BATCH; j++) {
    float* o = &out[j].u;
    for (int k = 0; k < 8; k++) o[k] = rows[k * BATCH + j];
  }
#endif
}

// A Gaussian of a closed surface whose normal points away from the camera lies behind the surface's front.
static void hide_backfaces(const Projection& p, const float* means, const float* normals, uint32_t* visible) {
  float limit = p.backface * p.backface;
  for (int j = 0; j < BATCH; j++) {
    float x = p.eye[0] - means[3 * j], y = p.eye[1] - means[3 * j + 1], z = p.eye[2] - means[3 * j + 2];
    float facing = normals[3 * j] * x + normals[3 * j + 1] * y + normals[3 * j + 2] * z;
    visible[j] &= !((facing < 0.f) & (facing * facing > limit * (x * x + y * y + z * z)));
  }
}

// Gaussians `first` and after, of which n are there and BATCH are computed: what is not a whole number of vectors would
// be left to other instructions, which round otherwise, and a Gaussian's picture would depend on how many stand before
// it.
// GENERAL: scales of three columns. OPACITY: opacities given, or antialiased.
template <bool GENERAL, bool OPACITY>
static void project_batch(const Projection& p, Bins& bins, const GvGaussians& in, int64_t first, int n) {
  const float *means = in.means, *scales = in.scales, *colors = in.colors, *quaternions = in.quaternions;
  const float* opacities = OPACITY ? in.opacities : nullptr;
  CameraPoints c;
  to_camera(p, means, BATCH, c);
  Projected s;
  alignas(64) float support[BATCH], finite[BATCH], A[BATCH], B[BATCH], C[BATCH], det[BATCH], sharp_det[BATCH];
  alignas(64) uint32_t bx[BATCH], by[BATCH], visible[BATCH], good[BATCH];
  alignas(64) Entry entry[BATCH];
  // The tile that holds the first block, what it and its neighbours are told of columns and rows, who reaches there.
  alignas(64) uint32_t tile[BATCH], columns[BATCH], next_columns[BATCH], rows[BATCH], next_rows[BATCH];
  alignas(64) uint32_t right[BATCH], down[BATCH], beyond[BATCH];

  // x - x is 0 for a finite x and NaN otherwise; adding them up finds any bad field at once
  for (int j = 0; j < BATCH; j++) {
    float f = (means[3 * j] - means[3 * j]) + (means[3 * j + 1] - means[3 * j + 1]) +
              (means[3 * j + 2] - means[3 * j + 2]) + (colors[3 * j] - colors[3 * j]) +
              (colors[3 * j + 1] - colors[3 * j + 1]) + (colors[3 * j + 2] - colors[3 * j + 2]);
    s.r[j] = colors[3 * j];
    s.g[j] = colors[3 * j + 1];
    s.b[j] = colors[3 * j + 2];
    finite[j] = f;
  }
  if (opacities) {
    for (int j = 0; j < BATCH; j++) {
      float o = opacities[j];
      finite[j] += o - o;
      float log2_opacity = log2_of(high(o, 1e-6f));  // below 1/255 nothing is seen
      p.lift[first + j] = LOG2_255 + log2_opacity;
      support[j] = high(LOG2_255 + log2_opacity, -1.f) * (2.f / LOG2E);
    }
  } else {
    for (int j = 0; j < BATCH; j++) support[j] = LOG2_255 * (2.f / LOG2E);
    if (OPACITY)
      for (int j = 0; j < BATCH; j++) p.lift[first + j] = LOG2_255;
  }
  if (quaternions)
    for (int j = 0; j < BATCH; j++) {
      const float* q = quaternions + 4 * j;
      float f = (q[0] - q[0]) + (q[1] - q[1]) + (q[2] - q[2]) + (q[3] - q[3]);
      finite[j] += f;
    }
  for (int j = 0; j < BATCH; j++) {
    float z = c.z[j] > NEAR ? c.z[j] : 1.f, inv_z = 1.f / z;
    float tx = low(high(c.x[j] * inv_z, p.x_low), p.x_high), ty = low(high(c.y[j] * inv_z, p.y_low), p.y_high);
    Covariance cov;
    float smallest;
    if (GENERAL) {
      const float* sj = scales + 3 * j;
      const float identity[4] = {1, 0, 0, 0};
      float M[9], Q[9], W[9], m0[3], m1[3];
      rotated_axes(p, quaternions ? quaternions + 4 * j : identity, sj, M, Q, W);
      cov = general_covariance(p, W, inv_z, tx, ty, m0, m1);
      smallest = low(low(sj[0], sj[1]), sj[2]);
      finite[j] += (sj[0] - sj[0]) + (sj[1] - sj[1]) + (sj[2] - sj[2]);
    } else {
      cov = isotropic_covariance(p, scales[j] * inv_z, tx, ty);
      smallest = scales[j];
      finite[j] += scales[j] - scales[j];
    }
    A[j] = cov.A, B[j] = cov.B, C[j] = cov.C, det[j] = cov.det, sharp_det[j] = cov.sharp_det;
    good[j] = (finite[j] == 0.f) & (smallest >= 0.f);
  }
  if (OPACITY && p.antialiased)
    for (int j = 0; j < BATCH; j++) {
      float ratio = sharp_det[j] / det[j];
      ratio = ratio < 1.f ? ratio : 1.f;  // 1 for a NaN too
      float lift = p.lift[first + j] + 0.5f * log2_of(high(ratio, 1e-12f));
      p.lift[first + j] = lift;
      support[j] = high(lift, -1.f) * (2.f / LOG2E);
    }
  const int g = p.granularity, b = 3 - g;
  for (int j = 0; j < BATCH; j++) {
    float inv_z = 1.f / (c.z[j] > NEAR ? c.z[j] : 1.f);
    float u = p.fx * (c.x[j] * inv_z) + p.cx - 0.5f, v = p.fy * (c.y[j] * inv_z) + p.cy - 0.5f;
    // half the Mahalanobis distance squared, as a sum of two squares
    float x = __builtin_sqrtf(0.5f * LOG2E / A[j]), y = __builtin_sqrtf(0.5f * LOG2E * (A[j] / det[j]));
    float yx = -y * (B[j] / A[j]);
    s.u[j] = u;
    s.v[j] = v;
    s.x[j] = x;
    s.y[j] = y;
    s.yx[j] = yx;
    float rx = __builtin_sqrtf(support[j] * A[j]), ry = __builtin_sqrtf(support[j] * C[j]);
    float x_max = (float)(p.width - 1), y_max = (float)(p.height - 1);
    float x0 = __builtin_ceilf(u - rx), x1 = __builtin_floorf(u + rx);
    float y0 = __builtin_ceilf(v - ry), y1 = __builtin_floorf(v + ry);
    // written so that a NaN anywhere makes it false
    visible[j] = (c.z[j] > NEAR) & (x1 >= 0.f) & (y1 >= 0.f) & (x0 <= x_max) & (y0 <= y_max) & (x0 <= x1) & (y0 <= y1);
    visible[j] &= good[j] & ((x - x) + (y - y) + (yx - yx) == 0.f);
    uint32_t bx0 = (uint32_t)(int32_t)low(high(x0, 0.f), x_max) >> 2, bx1 = (uint32_t)(int32_t)low(high(x1, 0.f), x_max) >> 2;
    uint32_t by0 = (uint32_t)(int32_t)low(high(y0, 0.f), y_max) >> 2, by1 = (uint32_t)(int32_t)low(high(y1, 0.f), y_max) >> 2;
    bx[j] = bx0 | bx1 << 16;
    by[j] = by0 | by1 << 16;
    uint32_t tx = bx0 >> 3, ty = by0 >> 3, more_x = (bx1 >> 3) - tx, more_y = (by1 >> 3) - ty;
    tile[j] = ty * p.tiles_x + tx;
    right[j] = more_x != 0, down[j] = more_y != 0, beyond[j] = (more_x > 1) | (more_y > 1);
    columns[j] = (bx0 & 7) >> g | (more_x ? 7 : bx1 & 7) >> g << b;
    rows[j] = ((by0 & 7) >> g | (more_y ? 7 : by1 & 7) >> g << b) << 2 * b;
    next_columns[j] = (bx1 & 7) >> g << b;
    next_rows[j] = (by1 & 7) >> g << 3 * b;
    uint32_t depth;
    __builtin_memcpy(&depth, &c.z[j], 4);
    entry[j] = (Entry)depth << 32 | (uint32_t)((uint32_t)(first + j) << 4 * b);
  }
  if (p.backface > 0) hide_backfaces(p, means, in.normals, visible);
  store_records(s, p.records + first);
  // Sets of bits, so that there is nothing to guess but where a set ends.
  const uint64_t all = ~0ull >> (BATCH - n);
  const uint64_t seen = lowest_bits(visible, BATCH) & all, large = lowest_bits(beyond, BATCH) & seen;
  const uint64_t plain = seen & ~large;
  const uint64_t to_right = lowest_bits(right, BATCH) & plain, downwards = lowest_bits(down, BATCH) & plain;
  auto each = [](uint64_t set, auto visit) {
    for (; set; set &= set - 1) visit(__builtin_ctzll(set));
  };
  each(plain, [&](int j) { append(p, bins, tile[j], entry[j] | columns[j] | rows[j]); });
  each(to_right, [&](int j) { append(p, bins, tile[j] + 1, entry[j] | next_columns[j] | rows[j]); });
  each(downwards, [&](int j) { append(p, bins, tile[j] + p.tiles_x, entry[j] | columns[j] | next_rows[j]); });
  each(to_right & downwards,
       [&](int j) { append(p, bins, tile[j] + p.tiles_x + 1, entry[j] | next_columns[j] | next_rows[j]); });
  each(large, [&](int j) { bin_tiles(p, bins, entry[j], bx[j], by[j]); });
  bins.visible += __builtin_popcountll(seen);
  bins.dropped += n - __builtin_popcountll(lowest_bits(good, BATCH) & all);
}

// Rows [first, first + n) of (N, columns) floats; where they are too few for a batch, a copy with zeros behind them.
GV_INLINE const float* batch_of(const float* all, int64_t first, int n, int columns, float* room) {
  if (!all || n == BATCH) return all ? all + first * columns : nullptr;
  __builtin_memset(room, 0, sizeof(float) * BATCH * columns);
  __builtin_memcpy(room, all + first * columns, sizeof(float) * n * columns);
  return room;
}

static void project(const Projection* p, Bins* bins, int64_t begin, int64_t end) {
  const GvGaussians& all = p->gaussians;
  bool general = all.scale_columns == 3, opacity = p->lift != nullptr;
  auto batch = general ? (opacity ? project_batch<true, true> : project_batch<true, false>)
                       : (opacity ? project_batch<false, true> : project_batch<false, false>);
  for (int64_t i = begin; i < end; i += BATCH) {
    const int n = (int)(end - i < BATCH ? end - i : BATCH);
    float means[3 * BATCH], scales[3 * BATCH], colors[3 * BATCH], opacities[BATCH], quaternions[4 * BATCH],
        normals[3 * BATCH];
    GvGaussians in = all;
    in.means = batch_of(all.means, i, n, 3, means);
    in.scales = batch_of(all.scales, i, n, all.scale_columns, scales);
    in.colors = batch_of(all.colors, i, n, 3, colors);
    in.opacities = batch_of(all.opacities, i, n, 1, opacities);
    in.quaternions = batch_of(all.quaternions, i, n, 4, quaternions);
    in.normals = batch_of(all.normals, i, n, 3, normals);
    batch(*p, *bins, in, i, n);
  }
}

}  // namespace gv::GV_NAMESPACE
