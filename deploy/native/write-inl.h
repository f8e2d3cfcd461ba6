// From blended blocks to images, and images where nothing is blended.
#pragma once
#include <stdint.h>

#include "block-inl.h"
#include "kernels.h"
#include "scalars-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// T is the transmittance; its sign is set once the pixel has stopped. r, g, b, d: sums so far.
struct BlockState {
  Px T, r, g, b, d;
};

GV_INLINE uint8_t to_byte(float x) {
  x = clamp(x, 0.f, 1.f);
  return (uint8_t)(int32_t)(x * 255.f + 0.5f);
}

// The sixteen pixels of a block as the images have them.
struct Written {
  alignas(64) float r[16], g[16], b[16], alpha[16], depth[16];
};

// Four pixels from planes to twelve floats r g b r g b ...: pairs first, each twelve's third after.
GV_INLINE void write_colors(Four r, Four g, Four b, float* to) {
  const Four rg = GV_SHUFFLE4(r, g, 0, 4, 1, 5);   // r0 g0 r1 g1
  const Four gb = GV_SHUFFLE4(g, b, 1, 5, 2, 6);   // g1 b1 g2 b2
  const Four br = GV_SHUFFLE4(b, r, 2, 7, 3, 3);   // b2 r3 b3 b3
  store4(to, GV_SHUFFLE4(rg, b, 0, 1, 4, 2));      // r0 g0 b0 r1
  store4(to + 4, GV_SHUFFLE4(gb, r, 0, 1, 6, 2));  // g1 b1 r2 g2
  store4(to + 8, GV_SHUFFLE4(br, g, 0, 1, 7, 2));  // b2 r3 g3 b3
}

// Four pixels from planes to twelve rounded bytes.
GV_INLINE void write_bytes(Four r, Four g, Four b, uint8_t* to) {
  const Four c[3] = {r, g, b};
  uint32_t px[4], word[3];
  FourInts packed{};  // a pixel each, red in the lowest byte
  for (int k = 0; k < 3; k++) {
    Four x = c[k] > 0.f ? c[k] : Four{};
    x = x < 1.f ? x : Four{} + 1.f;
    packed |= __builtin_convertvector(x * 255.f + 0.5f, FourInts) << 8 * k;
  }
  __builtin_memcpy(px, &packed, sizeof px);
  // the fourth byte of each is empty: close up
  word[0] = px[0] | px[1] << 24;
  word[1] = px[1] >> 8 | px[2] << 16;
  word[2] = px[2] >> 16 | px[3] << 8;
  __builtin_memcpy(to, word, sizeof word);
}

// `at`: the place of the block's first pixel in the image.
GV_INLINE void write_whole_block(const GvImages& out, const Written& s, int64_t at, int32_t width) {
  for (int y = 0; y < 4; y++, at += width) {
    const Four r = load4(s.r + 4 * y), g = load4(s.g + 4 * y), b = load4(s.b + 4 * y);
    if (out.color) write_colors(r, g, b, out.color + 3 * at);
    if (out.color8) write_bytes(r, g, b, out.color8 + 3 * at);
    if (out.alpha) store4(out.alpha + at, load4(s.alpha + 4 * y));
    if (out.depth) store4(out.depth + at, load4(s.depth + 4 * y));
  }
}

// A block at the border, of which only so many columns and rows are in the image.
static void write_part_of_block(const GvImages& out, const Written& s, int64_t at, int32_t width,
                                int columns, int rows) {
  for (int y = 0; y < rows; y++)
    for (int x = 0; x < columns; x++) {
      const int i = 4 * y + x;
      const int64_t to = at + (int64_t)y * width + x;
      const float rgb[3] = {s.r[i], s.g[i], s.b[i]};
      for (int k = 0; k < 3; k++) {
        if (out.color) out.color[3 * to + k] = rgb[k];
        if (out.color8) out.color8[3 * to + k] = to_byte(rgb[k]);
      }
      if (out.alpha) out.alpha[to] = s.alpha[i];
      if (out.depth) out.depth[to] = s.depth[i];
    }
}

// The blocks of the tile whose first pixel is (x0, y0), with the background behind them.
GV_NOINLINE static void write_blocks(const TileJob& job, const BlockState* state, int x0, int y0) {
  const Projection& p = *job.projection;
  const float* bg = job.options->background;
  for (int block = 0; block < BLOCKS; block++) {
    const BlockState& s = state[block];
    int bx = x0 + block_x(block), by = y0 + block_y(block);
    int columns = p.width - bx < 4 ? p.width - bx : 4, rows = p.height - by < 4 ? p.height - by : 4;
    if (columns <= 0 || rows <= 0) continue;
    Written w;
    for (int k = 0; k < PARTS; k++) {
      V T = without_sign(s.T.part[k]);
      store(w.alpha + k * LANES, 1.f - T);
      store(w.depth + k * LANES, s.d.part[k]);
      store(w.r + k * LANES, s.r.part[k] + T * bg[0]);
      store(w.g + k * LANES, s.g.part[k] + T * bg[1]);
      store(w.b + k * LANES, s.b.part[k] + T * bg[2]);
    }
    int64_t at = (int64_t)by * p.width + bx;
    if (columns == 4 && rows == 4) write_whole_block(*job.images, w, at, p.width);
    else write_part_of_block(*job.images, w, at, p.width, columns, rows);
  }
}

// The background on columns [x0, x1) and rows [y0, y1), which may be those of neighbouring tiles
// together: short pieces of many rows would be a page each, and four times as slow.
static void write_background(const Projection* p, const GvOptions* options, const GvImages* out,
                             int32_t x0, int32_t x1, int32_t y0, int32_t y1) {
  alignas(64) float line[3 * TILE];
  alignas(64) uint8_t line8[3 * TILE];
  for (int i = 0; i < 3 * TILE; i++) {
    line[i] = options->background[i % 3];
    line8[i] = to_byte(line[i]);
  }
  const int64_t whole = (x1 - x0) / TILE, rest = (x1 - x0) % TILE;
  for (int32_t y = y0; y < y1; y++) {
    const int64_t at = (int64_t)y * p->width + x0;
    if (float* to = out->color ? out->color + 3 * at : nullptr) {
      for (int64_t i = 0; i < whole; i++, to += 3 * TILE) __builtin_memcpy(to, line, sizeof line);
      __builtin_memcpy(to, line, 12 * rest);
    }
    if (uint8_t* to = out->color8 ? out->color8 + 3 * at : nullptr) {
      for (int64_t i = 0; i < whole; i++, to += 3 * TILE) __builtin_memcpy(to, line8, sizeof line8);
      __builtin_memcpy(to, line8, 3 * rest);
    }
    if (out->alpha) __builtin_memset(out->alpha + at, 0, 4 * (x1 - x0));
    if (out->depth) __builtin_memset(out->depth + at, 0, 4 * (x1 - x0));
  }
}

}  // namespace gv::GV_NAMESPACE
