// From the gradients of pixels to sums over pixels for each Gaussian of a tile.
//
// The pixels are replayed front to back. With weight w_i = T_i alpha_i and c_i = dL/dw_i as far as
// it is direct (color, depth and alpha gradients dotted with the Gaussian's color, depth and
// 1 - background's share),
//   dL/dalpha_i = T_i c_i - sum_{j > i} w_j c_j / (1 - alpha_i),
// and the sum behind i is one scalar a pixel: the whole sum, known from the forward's images, less
// what was passed.
#pragma once
#include <stdint.h>

#include "block-inl.h"
#include "kernels.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// A block's pixels: transmittance and sum behind where the replay stands, dL/d(r, g, b, depth), and
// the part of c_i that is the same for all Gaussians.
struct PixelGradients {
  Px T, behind, r, g, b, d, constant;
};

struct BackwardScratch {
  PixelGradients pixels[BLOCKS];
  Lists lists;
  alignas(64) float sums[CHUNK + 1][16];  // Sums, then MoreSums, then padding
};

// v and w of up to LANES Gaussians at a block's sixteen pixels, to be summed over pixels together:
// transposed, lanes are Gaussians and every sum is a few multiply-adds for all of them, where a
// horizontal sum each would cost far more.
struct Pending {
  alignas(64) float v[LANES][16], w[LANES][16], u[LANES], y[LANES];  // (u, y): the centre
  int at[LANES];                                                     // in the chunk
};

// pixels[i]: pixel i of LANES rows.
GV_INLINE void load_transposed(const float (*rows)[16], V* pixels) {
  for (int part = 0; part < PARTS; part++) {
    V* m = pixels + part * LANES;
    for (int i = 0; i < LANES; i++) m[i] = load(rows[i] + part * LANES);
    transpose(m);
  }
}

// Adds the sums over the block's pixels of what is pending. (x0, y0): the block's first pixel.
template <bool MORE>
static void flush(Pending& pending, const PixelGradients& px, float x0, float y0,
                  float (*sums)[16]) {
  V p[16], out[16];
  load_transposed(pending.v, p);
  // moments of v about the block's first pixel: first over the rows of each column (c0, c1, c2: of
  // degree 0, 1, 2 in y), then over the columns
  V c0[4], c1[4], c2[4];
  for (int x = 0; x < 4; x++) {
    V a = p[x], b = p[4 + x], c = p[8 + x], d = p[12 + x];
    c0[x] = a + b + (c + d);
    c1[x] = b + 2.f * c + 3.f * d;
    c2[x] = b + 4.f * c + 9.f * d;
  }
  V m0 = c0[0] + c0[1] + (c0[2] + c0[3]);
  V mx = c0[1] + 2.f * c0[2] + 3.f * c0[3];
  V mxx = c0[1] + 4.f * c0[2] + 9.f * c0[3];
  V my = c1[0] + c1[1] + (c1[2] + c1[3]);
  V mxy = c1[1] + 2.f * c1[2] + 3.f * c1[3];
  V myy = c2[0] + c2[1] + (c2[2] + c2[3]);
  // and about the Gaussian's centre
  V dx = x0 - load(pending.u), dy = y0 - load(pending.y);
  out[0] = mx + dx * m0;
  out[1] = my + dy * m0;
  out[2] = mxx + dx * (mx + out[0]);  // sum (x + dx)^2 v = mxx + 2 dx mx + dx^2 m0
  out[3] = mxy + dx * my + dy * out[0];
  out[4] = myy + dy * (my + out[1]);
  load_transposed(pending.w, p);
  V r = V{}, g = V{}, b = V{}, d = V{};
  const float *gr = (const float*)&px.r, *gg = (const float*)&px.g;
  const float *gb = (const float*)&px.b, *gd = (const float*)&px.d;
  for (int i = 0; i < 16; i++) {
    r += p[i] * gr[i];
    g += p[i] * gg[i];
    b += p[i] * gb[i];
    if (MORE) d += p[i] * gd[i];
  }
  out[5] = r, out[6] = g, out[7] = b, out[8] = m0, out[9] = d;
  for (int i = 10; i < 16; i++) out[i] = V{};
  constexpr int VALUES = MORE ? 12 : 8;  // whole vectors of four
  for (int part = 0; part * LANES < VALUES; part++) {
    V* m = out + part * LANES;
    transpose(m);
    for (int i = 0; i < LANES; i++) {
      float* to = sums[pending.at[i]] + part * LANES;
      store(to, load(to) + m[i]);
    }
  }
}

// Replay a block's Gaussians of a chunk; false when all of its pixels have stopped.
template <bool MORE, bool FAST>
static bool replay_block(PixelGradients& px, const Lists& lists, float (*sums)[16],
                         Pending& pending, int block, int words, float x0, float y0, float stop) {
  Members members;
  list_members(lists, block, words, members);
  if (!members.count) return true;
  bool alive = true;
  Px left = running_part(px.T), behinds = px.behind;
  const Pixels at = pixels_of((int)x0, (int)y0, 0);
  for (int i = 0; i < members.count && alive;) {
    // groups until the rows are full; past the end, with Gaussians that are seen nowhere
    for (int row = 0; row < LANES; row += GROUP, i += GROUP) {
      V e[GROUP * PARTS], p[GROUP * PARTS];
      for (int j = 0; j < GROUP; j++) {
        int m = members.at[i + j];
        exponent(lists.local[m], lists.lift[m], at, e + j * PARTS);
      }
      power<FAST>(e, p);
      for (int j = 0; j < GROUP; j++) {
        const Record& s = lists.local[members.at[i + j]];
        pending.at[row + j] = members.at[i + j];
        pending.u[row + j] = s.u;
        pending.y[row + j] = s.v;
        for (int k = 0; k < PARTS; k++) {
          // the same arithmetic as the forward's, so that the same pixels stop at the same
          // Gaussians
          V unclamped = drop(negative(e[j * PARTS + k]), p[j * PARTS + k]);
          V alpha = minimum(unclamped, splat(ALPHA_MAX));
          V before = left.part[k], weight = before * alpha, after = before - weight;
          I stopped = negative(after - stop);
          weight = drop(stopped, weight);
          // c_i, and the sum behind i
          V direct = px.r.part[k] * s.r +
                     (px.g.part[k] * s.g + (px.b.part[k] * s.b + px.constant.part[k]));
          if (MORE) direct += px.d.part[k] * lists.depth[members.at[i + j]];
          V behind = behinds.part[k] - weight * direct;
          V g_alpha = before * direct - behind * reciprocal(1.f - alpha);
          // v, by the rule as if alpha had not been clamped
          store(pending.v[row + j] + k * LANES, drop(stopped, unclamped * g_alpha));
          store(pending.w[row + j] + k * LANES, weight);
          behinds.part[k] = behind;
          left.part[k] = after;
        }
      }
      if (i + GROUP >= members.count) {  // what the other rows still hold must not count
        for (int rest = row + GROUP; rest < LANES; rest++) {
          __builtin_memset(pending.v[rest], 0, sizeof pending.v[rest]);
          __builtin_memset(pending.w[rest], 0, sizeof pending.w[rest]);
          pending.at[rest] = CHUNK;
        }
        i += GROUP;
        break;
      }
    }
    flush<MORE>(pending, px, x0, y0, sums);
    drop_stopped(left, stop);
    alive = above(left, 0.5f * stop);
  }
  px.T = left;  // 0 where it has stopped: no more is asked of it
  px.behind = behinds;
  return alive;
}

// The gradients at the pixels of the tile whose first pixel is (x0, y0), before any Gaussian.
static void load_pixels(const BackwardTileJob& job, PixelGradients* pixels, int x0, int y0) {
  const Projection& p = *job.projection;
  const GvImages &image = *job.images, &up = *job.upstream;
  const float* bg = job.options->background;
  for (int block = 0; block < BLOCKS; block++) {
    int bx = x0 + block_x(block), by = y0 + block_y(block);
    float T[16], behind[16], g[3][16], d[16], constant[16];
    for (int i = 0; i < 16; i++) {
      int x = bx + (i & 3), y = by + (i >> 2);
      T[i] = -1;
      behind[i] = g[0][i] = g[1][i] = g[2][i] = d[i] = constant[i] = 0;
      if (x >= p.width || y >= p.height) continue;
      int64_t at = (int64_t)y * p.width + x;
      T[i] = 1;
      if (up.alpha) {
        constant[i] = up.alpha[at];
        behind[i] = up.alpha[at] * image.alpha[at];
      }
      if (up.color)
        for (int k = 0; k < 3; k++) {  // a weight adds its color and takes away background
          float gk = up.color[3 * at + k];
          g[k][i] = gk;
          constant[i] -= gk * bg[k];
          behind[i] += gk * (image.color[3 * at + k] - bg[k]);
        }
      if (up.depth) {
        d[i] = up.depth[at];
        behind[i] += up.depth[at] * image.depth[at];
      }
    }
    PixelGradients& out = pixels[block];
    for (int k = 0; k < PARTS; k++) {
      out.T.part[k] = load(T + k * LANES);
      out.behind.part[k] = load(behind + k * LANES);
      out.r.part[k] = load(g[0] + k * LANES);
      out.g.part[k] = load(g[1] + k * LANES);
      out.b.part[k] = load(g[2] + k * LANES);
      out.d.part[k] = load(d + k * LANES);
      out.constant.part[k] = load(constant + k * LANES);
    }
  }
}

template <bool MORE, bool FAST>
static void replay_tile(BackwardTileJob& job) {
  const Projection& p = *job.projection;
  BackwardScratch& scratch = *(BackwardScratch*)job.scratch;
  Lists& lists = scratch.lists;
  const Kept& kept = job.kept;
  int x0 = job.tile_x * TILE, y0 = job.tile_y * TILE;
  load_pixels(job, scratch.pixels, x0, y0);
  add_unseen(lists);
  uint64_t alive = blocks_inside(p, x0, y0);
  Pending pending;
  __builtin_memset(&pending, 0, sizeof pending);
  for (uint32_t first = 0; first < kept.count; first += CHUNK) {
    int count = (int)(kept.count - first < CHUNK ? kept.count - first : CHUNK);
    for (int i = 0; i < count; i++) {
      fetch(p, kept.index[first + i], kept.depth[first + i], lists, i);
      lists.blocks[i] = kept.blocks[first + i] & alive;
    }
    // records of the next chunk, while this one is replayed
    for (uint32_t i = first + CHUNK; i < kept.count && i < first + 2 * CHUNK; i++)
      __builtin_prefetch(&p.records[kept.index[i]]);
    list_by_block(lists, count);
    __builtin_memset(scratch.sums, 0, sizeof(float) * 16 * count);
    int words = (count + 63) / 64;
    for (uint64_t left = alive; left; left &= left - 1) {
      int block = __builtin_ctzll(left);
      if (!replay_block<MORE, FAST>(scratch.pixels[block], lists, scratch.sums, pending, block,
                                    words, (float)(x0 + block_x(block)),
                                    (float)(y0 + block_y(block)), job.options->transmittance_stop))
        alive &= ~(1ull << block);
    }
    for (int i = 0; i < count; i++) {
      __builtin_memcpy(&job.sums[first + i], scratch.sums[i], sizeof(Sums));
      if (MORE) __builtin_memcpy(&job.more[first + i], scratch.sums[i] + 8, sizeof(MoreSums));
    }
  }
}

static void backward_tile(BackwardTileJob* job) {
  bool fast = job->options->fast != 0;
  (job->more ? (fast ? replay_tile<true, true> : replay_tile<true, false>)
             : (fast ? replay_tile<false, true> : replay_tile<false, false>))(*job);
}

}  // namespace gv::GV_NAMESPACE
