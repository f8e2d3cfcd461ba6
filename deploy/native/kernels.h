// What the engine (compiled once) and the kernels (kernels.cpp, compiled once per instruction set)
// share: plain data, and a table of functions. Nothing here may become code in a kernel's object
// file that the linker could choose for the baseline too, so there are no standard containers and
// no non-trivial inline functions.
#pragma once
#include <stddef.h>
#include <stdint.h>

#include "gavatar_native.h"
#include "splatting_rule.h"

namespace gv {

// A tile is 32x32 pixels: 64 blocks of 4x4, so that a set of blocks is one 64-bit word and a block
// is one vector of 16.
constexpr int TILE = 32;
constexpr int BLOCKS = 64;     // in a tile
constexpr int CHUNK = 256;     // Gaussians blended into a tile at a time
constexpr int BATCH = 64;      // Gaussians projected at a time
constexpr int SSIM_TAPS = 11;  // of the largest window

constexpr float LOG2E = 1.4426950408889634f;
constexpr float LOG2_255 = 7.994353436858858f;
static_assert(ALPHA_MIN == 1.f / 255.f,
              "Record, LOG2_255 and power() of simd-inl.h count in 1/255");

// A Gaussian on the image. Its alpha at offset (dx, dy) from (u, v) is 2^e / 255, where
// e = lift - (x dx)^2 - (y dy + yx dx)^2: below zero where alpha is below 1/255. u and v count from
// the centre of pixel (0, 0).
struct Record {
  float u, v, x, y, yx, r, g, b;
};

// One (Gaussian, tile) pair: depth bits, index, range of blocks, from the top bit down; comparing
// entries as numbers orders them by (depth, index), since the bits of positive floats sort like the
// floats.
// The range is x0, x1, y0, y1 of 3 - granularity bits each, from the lowest bit up; where there are
// more than 2^20 Gaussians the range is made coarser and the index longer.
typedef uint64_t Entry;

// 512 bytes at a multiple of 512, so that where the next entry goes says in which block, and
// whether that is full.
struct alignas(512) EntryBlock {
  static constexpr uint32_t CAPACITY = 61;
  Entry entry[CAPACITY];
  EntryBlock *first, *next;  // of the tile; the last block's `next` is not set
  uint64_t before;           // entries in the blocks before this one
};
static_assert(sizeof(EntryBlock) == 512, "the low nine bits of a cursor are its place in a block");

// The entries that one thread has made, by tile: cursors to where the next one goes, NO_ENTRIES at
// first.
struct Bins {
  Entry** cursors;
  int64_t visible, dropped;
  void* owner;
};
// The end of no block.
static Entry* const NO_ENTRIES = (Entry*)(sizeof(Entry) * EntryBlock::CAPACITY);

// The block that a cursor points into, or behind; null for NO_ENTRIES.
static inline __attribute__((always_inline)) EntryBlock* block_of(const Entry* cursor) {
  return (EntryBlock*)((uintptr_t)cursor & ~(uintptr_t)511);
}

// What is needed to project, in the types the arithmetic uses.
struct Projection {
  GvGaussians gaussians;
  double rotation[9], translation[3];
  float rotation_f[9];
  float fx, fy, cx, cy;
  float x_low, x_high, y_low, y_high;  // bounds of X/Z and Y/Z inside the Jacobian
  int32_t width, height, tiles_x, tiles_y;
  float eye[3], backface;  // the camera's centre; `backface` is 0 without normals
  bool antialiased;
  int32_t granularity;
  // Blocks of a tile by a range of columns or rows as an entry holds it: first | last << bits, of
  // 3 - granularity bits each.
  uint64_t columns[64], rows[64];
  Record* records;
  float* lift;  // log2(255 opacity), compensation included, or null for LOG2_255
  EntryBlock* (*grow)(Bins*, EntryBlock* previous);  // an empty block
};

// A tile's Gaussians in the order they were blended, kept for the backward.
struct Kept {
  uint32_t* index;
  uint64_t* blocks;  // which of the tile's blocks each touches
  float* depth;
  uint32_t count;
};

struct TileJob {
  const Projection* projection;
  const GvOptions* options;
  const GvImages* images;
  int32_t tile_x, tile_y;
  Bins** bins;
  int32_t bin_count;
  uint32_t count;  // entries
  Entry* work;     // (count) room to sort in
  void* scratch;   // (scratch_bytes)
  void (*sort)(Entry*, size_t);
  uint32_t* kept_index;  // (count) room for what is kept, or null
  uint64_t* kept_blocks;
  float* kept_depth;
  uint32_t blended;        // out
  double sort_s, blend_s;  // out
  double (*clock)();
};

// Sums over pixels of one Gaussian in one tile, v = alpha dL/dalpha and w = blending weight.
struct Sums {
  float v_dx, v_dy, v_dxdx, v_dxdy, v_dydy, w_r, w_g, w_b;
};
struct MoreSums {
  float v, w_depth;
};

struct BackwardTileJob {
  const Projection* projection;
  const GvOptions* options;
  const GvImages* images;
  const GvImages* upstream;
  int32_t tile_x, tile_y;
  Kept kept;
  Sums* sums;      // (count) out
  MoreSums* more;  // (count) out, null unless opacity or depth gradients flow
  void* scratch;   // (scratch_bytes)
};

// The code of a symbol of JPEG, in the lowest bits.
struct JpegCode {
  uint16_t bits, length;
};
struct JpegCodes {
  JpegCode first[12], rest[256];  // of mean brightness by size; of the rest by zeros << 4 | size
};
struct JpegImage {
  const uint8_t* pixels;  // (H, W, 3)
  int32_t height, width;
  JpegCodes codes[2];    // luminance, colour
  float factors[2][64];  // of a coefficient, in the zigzag order
};

struct Kernels {
  size_t scratch_bytes;  // that a tile's job needs, forward or backward
  void (*project)(const Projection*, Bins*, int64_t begin, int64_t end);
  void (*forward_tile)(TileJob*);  // of a tile that has entries
  // The background on columns [x0, x1) and rows [y0, y1).
  void (*background)(const Projection*, const GvOptions*, const GvImages*, int32_t x0, int32_t x1,
                     int32_t y0, int32_t y1);
  void (*backward_tile)(BackwardTileJob*);
  // Gradients of Gaussians [begin, end) from their sums, which are cleared.
  void (*backward_project)(const Projection*, Sums*, MoreSums*, const GvGradients*, int64_t begin,
                           int64_t end);
  // Those that return a bool: false when an index is out of range.
  bool (*skin)(int64_t begin, int64_t end, int32_t slots, int32_t joints, const float* points,
               const int32_t* index, const float* weight, const float* columns, float* out);
  bool (*skin_backward)(int64_t begin, int64_t end, int32_t slots, int32_t joints, int32_t stride,
                        const float* points, const int32_t* index, const float* weight,
                        const float* transforms, const float* grad_out, float* grad_points,
                        float* grad_transforms);
  bool (*blendshapes)(int64_t begin, int64_t end, int32_t groups, int32_t parts, const float* base,
                      const uint8_t* part, const int8_t* basis, const float* coefficients,
                      const float* gains, float* points, float* colors, float* scales);
  bool (*upsample)(int64_t begin, int64_t end, int32_t slots, int32_t rows, const float* base,
                   const int32_t* index, const float* weight, const float* table, float* points,
                   float* colors, float* scales);
  size_t (*ssim_scratch_floats)(int32_t width, int32_t taps_x, int32_t taps_y);
  // `gradient` may be null. `column` and `line`: the window's weights down and along.
  void (*ssim_plane)(int32_t height, int32_t width, int32_t taps_y, int32_t taps_x,
                     const float* column, const float* line, const float* x, const float* y,
                     double* value, float* gradient, float* scratch);
  bool (*sparse_product)(int64_t begin, int64_t end, int32_t channels, int32_t rows,
                         const int32_t* offset, const int32_t* index, const float* weight,
                         const float* table, float* out);
  // Codes the line of blocks from pixel row y on; the end of what it wrote.
  uint8_t* (*jpeg_line)(const JpegImage*, int32_t y, uint8_t* to);
};

}  // namespace gv
