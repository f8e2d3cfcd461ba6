// Projection of Gaussians to records, and to entries of the tiles that they reach.
#pragma once
#include <stdint.h>

#include "bins-inl.h"
#include "covariance-inl.h"
#include "kernels.h"
#include "scalars-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// A batch of Gaussians on its way to the image, a field after the other so that loops over the
// Gaussians vectorize.
struct Batch {
  CameraPoints camera;
  // the fields of Record, in its order
  alignas(64) float u[BATCH], v[BATCH], x[BATCH], y[BATCH], yx[BATCH];
  alignas(64) float r[BATCH], g[BATCH], b[BATCH];
  alignas(64) float A[BATCH], B[BATCH], C[BATCH], det[BATCH], sharp_det[BATCH];  // Covariance
  alignas(64) float support[BATCH];     // squared Mahalanobis distance where alpha is ALPHA_MIN
  alignas(64) float finite[BATCH];      // 0 where all fields are finite, else NaN
  alignas(64) uint32_t good[BATCH];     // 1 where all fields are finite and no scale is negative
  alignas(64) uint32_t visible[BATCH];  // 1 where it is good and reaches a pixel
};

// Where the Gaussians of a batch reach. `columns` and `rows` are ranges of blocks as an entry holds
// them, rows already in their place.
struct Reach {
  alignas(64) uint32_t bx[BATCH], by[BATCH];         // first and last block: low and high 16 bits
  alignas(64) uint32_t tile[BATCH];                  // that holds the first block
  alignas(64) uint32_t columns[BATCH], rows[BATCH];  // of that tile
  alignas(64) uint32_t next_columns[BATCH], next_rows[BATCH];  // of the tile to the right and below
  alignas(64) uint32_t right[BATCH], down[BATCH];              // 1 where it reaches the tile there
  alignas(64) uint32_t beyond[BATCH];  // 1 where it reaches further than that
  alignas(64) Entry entry[BATCH];      // depth and index
};

// 0 for a finite x and NaN otherwise: such values added up find any bad field at once.
GV_INLINE float nothing_if_finite(float x) { return x - x; }

// Colours, support and what is finite. OPACITY: `p.lift` is written, which `support` follows.
template <bool OPACITY>
GV_INLINE void read_fields(const Projection& p, const GvGaussians& in, int64_t first, Batch& s) {
  const float *means = in.means, *colors = in.colors;
  for (int j = 0; j < BATCH; j++) {
    float f = nothing_if_finite(means[3 * j]) + nothing_if_finite(means[3 * j + 1]) +
              nothing_if_finite(means[3 * j + 2]) + nothing_if_finite(colors[3 * j]) +
              nothing_if_finite(colors[3 * j + 1]) + nothing_if_finite(colors[3 * j + 2]);
    s.r[j] = colors[3 * j];
    s.g[j] = colors[3 * j + 1];
    s.b[j] = colors[3 * j + 2];
    s.finite[j] = f;
  }
  if (const float* opacities = OPACITY ? in.opacities : nullptr) {
    for (int j = 0; j < BATCH; j++) {
      float o = opacities[j];
      s.finite[j] += nothing_if_finite(o);
      float log2_opacity = log2_of(larger(o, 1e-6f));  // below ALPHA_MIN nothing is seen
      p.lift[first + j] = LOG2_255 + log2_opacity;
      s.support[j] = larger(LOG2_255 + log2_opacity, -1.f) * (2.f / LOG2E);
    }
  } else {
    for (int j = 0; j < BATCH; j++) s.support[j] = LOG2_255 * (2.f / LOG2E);
    if (OPACITY)
      for (int j = 0; j < BATCH; j++) p.lift[first + j] = LOG2_255;
  }
}

// Covariances, and with them who is good. `sharp_det` is for compensate_opacities() alone.
template <bool GENERAL, bool OPACITY>
GV_INLINE void project_shapes(const Projection& p, const GvGaussians& in, Batch& s) {
  const float *scales = in.scales, *quaternions = in.quaternions;
  const CameraPoints& c = s.camera;
  if (quaternions)
    for (int j = 0; j < BATCH; j++) {
      const float* q = quaternions + 4 * j;
      float f = nothing_if_finite(q[0]) + nothing_if_finite(q[1]) + nothing_if_finite(q[2]) +
                nothing_if_finite(q[3]);
      s.finite[j] += f;
    }
  for (int j = 0; j < BATCH; j++) {
    float z = c.z[j] > NEAR ? c.z[j] : 1.f, inv_z = 1.f / z;
    float tx = clamp(c.x[j] * inv_z, p.x_low, p.x_high);
    float ty = clamp(c.y[j] * inv_z, p.y_low, p.y_high);
    Covariance cov;
    float smallest;
    if (GENERAL) {
      const float* sj = scales + 3 * j;
      const float identity[4] = {1, 0, 0, 0};
      Axes axes;
      float m0[3], m1[3];
      rotated_axes(p, quaternions ? quaternions + 4 * j : identity, sj, axes);
      cov = general_covariance(p, axes.W, inv_z, tx, ty, m0, m1);
      smallest = smaller(smaller(sj[0], sj[1]), sj[2]);
      s.finite[j] += nothing_if_finite(sj[0]) + nothing_if_finite(sj[1]) + nothing_if_finite(sj[2]);
    } else {
      cov = isotropic_covariance(p, scales[j] * inv_z, tx, ty);
      smallest = scales[j];
      s.finite[j] += nothing_if_finite(scales[j]);
    }
    s.A[j] = cov.A, s.B[j] = cov.B, s.C[j] = cov.C;
    s.det[j] = cov.det;
    if (OPACITY) s.sharp_det[j] = cov.sharp_det;
    s.good[j] = (s.finite[j] == 0.f) & (smallest >= 0.f);
  }
}

// Opacities times sqrt(det S / det (S + low-pass)): the low-pass widens, and must not add light.
GV_INLINE void compensate_opacities(const Projection& p, int64_t first, Batch& s) {
  for (int j = 0; j < BATCH; j++) {
    float ratio = s.sharp_det[j] / s.det[j];
    ratio = ratio < 1.f ? ratio : 1.f;  // 1 for a NaN too
    float lift = p.lift[first + j] + 0.5f * log2_of(larger(ratio, 1e-12f));
    p.lift[first + j] = lift;
    s.support[j] = larger(lift, -1.f) * (2.f / LOG2E);
  }
}

// The rest of the records, who is visible, and where they reach.
GV_INLINE void place(const Projection& p, int64_t first, Batch& s, Reach& out) {
  const CameraPoints& c = s.camera;
  const int g = p.granularity, b = 3 - g;  // a block's number loses g bits and keeps b
  for (int j = 0; j < BATCH; j++) {
    float inv_z = 1.f / (c.z[j] > NEAR ? c.z[j] : 1.f);
    float u = p.fx * (c.x[j] * inv_z) + p.cx - 0.5f, v = p.fy * (c.y[j] * inv_z) + p.cy - 0.5f;
    // half the squared Mahalanobis distance, in powers of two and as a sum of two squares (Record)
    float x = __builtin_sqrtf(0.5f * LOG2E / s.A[j]);
    float y = __builtin_sqrtf(0.5f * LOG2E * (s.A[j] / s.det[j]));
    float yx = -y * (s.B[j] / s.A[j]);
    s.u[j] = u;
    s.v[j] = v;
    s.x[j] = x;
    s.y[j] = y;
    s.yx[j] = yx;
    // the box around the ellipse of the support, in whole pixels
    float rx = __builtin_sqrtf(s.support[j] * s.A[j]), ry = __builtin_sqrtf(s.support[j] * s.C[j]);
    float x_max = (float)(p.width - 1), y_max = (float)(p.height - 1);
    float x0 = __builtin_ceilf(u - rx), x1 = __builtin_floorf(u + rx);
    float y0 = __builtin_ceilf(v - ry), y1 = __builtin_floorf(v + ry);
    // written so that a NaN anywhere makes it false
    s.visible[j] = (c.z[j] > NEAR) & (x1 >= 0.f) & (y1 >= 0.f) & (x0 <= x_max) & (y0 <= y_max) &
                   (x0 <= x1) & (y0 <= y1);
    s.visible[j] &= s.good[j] & ((x - x) + (y - y) + (yx - yx) == 0.f);
    uint32_t bx0 = (uint32_t)(int32_t)clamp(x0, 0.f, x_max) >> 2;  // a block has 4x4 pixels
    uint32_t bx1 = (uint32_t)(int32_t)clamp(x1, 0.f, x_max) >> 2;
    uint32_t by0 = (uint32_t)(int32_t)clamp(y0, 0.f, y_max) >> 2;
    uint32_t by1 = (uint32_t)(int32_t)clamp(y1, 0.f, y_max) >> 2;
    out.bx[j] = bx0 | bx1 << 16;
    out.by[j] = by0 | by1 << 16;
    uint32_t tx = bx0 >> 3, ty = by0 >> 3;                        // a tile has 8x8 blocks
    uint32_t more_x = (bx1 >> 3) - tx, more_y = (by1 >> 3) - ty;  // tiles after the first
    out.tile[j] = ty * p.tiles_x + tx;
    out.right[j] = more_x != 0, out.down[j] = more_y != 0;
    out.beyond[j] = (more_x > 1) | (more_y > 1);
    // in the first tile from the first block to the last one or the tile's end; next from block 0
    out.columns[j] = (bx0 & 7) >> g | (more_x ? 7 : bx1 & 7) >> g << b;
    out.rows[j] = ((by0 & 7) >> g | (more_y ? 7 : by1 & 7) >> g << b) << 2 * b;
    out.next_columns[j] = (bx1 & 7) >> g << b;
    out.next_rows[j] = (by1 & 7) >> g << 3 * b;
    uint32_t depth;
    __builtin_memcpy(&depth, &c.z[j], 4);
    out.entry[j] = (Entry)depth << 32 | (uint32_t)((uint32_t)(first + j) << 4 * b);
  }
}

// A Gaussian of a closed surface whose normal points away from the camera lies behind its front.
static void hide_backfaces(const Projection& p, const float* means, const float* normals,
                           uint32_t* visible) {
  float limit = p.backface * p.backface;
  for (int j = 0; j < BATCH; j++) {
    float x = p.eye[0] - means[3 * j];
    float y = p.eye[1] - means[3 * j + 1];
    float z = p.eye[2] - means[3 * j + 2];
    float facing = normals[3 * j] * x + normals[3 * j + 1] * y + normals[3 * j + 2] * z;
    // the cosine, facing / |(x, y, z)|, is below -backface; squared, to spare the root
    visible[j] &= !((facing < 0.f) & (facing * facing > limit * (x * x + y * y + z * z)));
  }
}

static void store_records(const Batch& s, Record* out) {
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

// Appends the entries of the batch's first n Gaussians. Works on sets of them, one bit each, so
// that the processor has nothing to guess but where a set ends.
GV_INLINE void append_entries(const Projection& p, Bins& bins, const Batch& s, const Reach& to,
                              int n) {
  const uint64_t all = ~0ull >> (BATCH - n);
  const uint64_t seen = lowest_bits(s.visible, BATCH) & all;
  const uint64_t large = lowest_bits(to.beyond, BATCH) & seen, plain = seen & ~large;
  const uint64_t to_right = lowest_bits(to.right, BATCH) & plain;
  const uint64_t downwards = lowest_bits(to.down, BATCH) & plain;
  auto each = [](uint64_t set, auto visit) {
    for (; set; set &= set - 1) visit(__builtin_ctzll(set));  // the lowest bit, then without it
  };
  each(plain,
       [&](int j) { append(p, bins, to.tile[j], to.entry[j] | to.columns[j] | to.rows[j]); });
  each(to_right, [&](int j) {
    append(p, bins, to.tile[j] + 1, to.entry[j] | to.next_columns[j] | to.rows[j]);
  });
  each(downwards, [&](int j) {
    append(p, bins, to.tile[j] + p.tiles_x, to.entry[j] | to.columns[j] | to.next_rows[j]);
  });
  each(to_right & downwards, [&](int j) {
    append(p, bins, to.tile[j] + p.tiles_x + 1, to.entry[j] | to.next_columns[j] | to.next_rows[j]);
  });
  each(large, [&](int j) { bin_tiles(p, bins, to.entry[j], to.bx[j], to.by[j]); });
  bins.visible += __builtin_popcountll(seen);
  bins.dropped += n - __builtin_popcountll(lowest_bits(s.good, BATCH) & all);
}

// Gaussians `first` and after, of which n are there and BATCH are computed: what is not a whole
// number of vectors would be left to other instructions, which round otherwise, and a Gaussian's
// picture would depend on how many stand before it.
// GENERAL: scales of three columns. OPACITY: opacities given, or antialiased.
template <bool GENERAL, bool OPACITY>
static void project_batch(const Projection& p, Bins& bins, const GvGaussians& in, int64_t first,
                          int n) {
  Batch s;
  Reach to;
  to_camera(p, in.means, BATCH, s.camera);
  read_fields<OPACITY>(p, in, first, s);
  project_shapes<GENERAL, OPACITY>(p, in, s);
  if (OPACITY && p.antialiased) compensate_opacities(p, first, s);
  place(p, first, s, to);
  if (p.backface > 0) hide_backfaces(p, in.means, in.normals, s.visible);
  store_records(s, p.records + first);
  append_entries(p, bins, s, to, n);
}

// Rows [first, first + n) of (N, columns) floats; where they are too few for a batch, a copy with
// zeros behind them. Null stays null.
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
    float means[3 * BATCH], scales[3 * BATCH], colors[3 * BATCH], opacities[BATCH];
    float quaternions[4 * BATCH], normals[3 * BATCH];
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
