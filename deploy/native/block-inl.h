// The 4x4 blocks of a tile: their pixels, the Gaussians that touch them, and the arithmetic that
// forward and backward share, so that in both the same pixels stop at the same Gaussians.
#pragma once
#include <stdint.h>

#include "kernels.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// Sixteen pixels of a block, in reading order.
struct Px {
  V part[PARTS];
};

// The column and the first row of a block among a tile's pixels. Blocks are numbered in reading
// order, eight in a row.
GV_INLINE int block_x(int block) { return (block & 7) * 4; }
GV_INLINE int block_y(int block) { return (block >> 3) * 4; }

// ---- a chunk of Gaussians -----------------------------------------------------------------------

struct Lists {
  // Copies of the chunk's records, with what is not in a record. The last one is seen nowhere: it
  // fills up groups.
  alignas(32) Record local[CHUNK + 1];
  float lift[CHUNK + 1], depth[CHUNK + 1];
  uint64_t blocks[CHUNK];                 // which blocks each Gaussian touches
  uint64_t touching[BLOCKS][CHUNK / 64];  // bit i of word w: Gaussian 64 w + i touches the block
};

GV_INLINE void fetch(const Projection& p, uint32_t index, float depth, Lists& out, int i) {
  out.local[i] = p.records[index];
  out.lift[i] = p.lift ? p.lift[index] : LOG2_255;
  out.depth[i] = depth;
}
GV_INLINE void add_unseen(Lists& lists) {
  lists.local[CHUNK] = Record{};
  lists.lift[CHUNK] = -1.f;
  lists.depth[CHUNK] = 0;
}

// One step of a transposition of 64x64 bits: squares of S x S bits change places across the
// diagonal of their 2S x 2S square. `mask`: the low S of every 2S bits.
template <int S>
GV_INLINE void exchange_bits(uint64_t m[64], uint64_t mask) {
  for (int base = 0; base < 64; base += 2 * S)
    for (int i = base; i < base + S; i++) {
      uint64_t t = (m[i + S] ^ m[i] >> S) & mask;  // where the two differ: exclusive or swaps them
      m[i + S] ^= t;
      m[i] ^= t << S;
    }
}
// Row i becomes column i.
static void transpose_bits(uint64_t m[64]) {
  exchange_bits<32>(m, 0x00000000ffffffffull);
  exchange_bits<16>(m, 0x0000ffff0000ffffull);
  exchange_bits<8>(m, 0x00ff00ff00ff00ffull);
  exchange_bits<4>(m, 0x0f0f0f0f0f0f0f0full);
  exchange_bits<2>(m, 0x3333333333333333ull);
  exchange_bits<1>(m, 0x5555555555555555ull);
}

// From `blocks` to `touching`.
GV_NOINLINE static void list_by_block(Lists& lists, int count) {
  for (int w = 0; 64 * w < count; w++) {
    uint64_t m[64];
    for (int i = 0; i < 64; i++) m[i] = 64 * w + i < count ? lists.blocks[64 * w + i] : 0;
    transpose_bits(m);
    for (int i = 0; i < 64; i++) lists.touching[i][w] = m[i];
  }
}

// Gaussians whose exponentials are computed together: four vectors at a time, but no more than
// registers allow.
constexpr int GROUP = PARTS >= 4 ? 1 : 4 / PARTS;
constexpr int AT_ONCE = 8;  // Gaussians that list_members() writes a turn

// The chunk's Gaussians that touch a block, in order, filled up to whole groups with the unseen
// one.
struct Members {
  int count;
  uint16_t at[CHUNK + AT_ONCE];
};
// Eight a turn whether there are so many or not: what is too much is overwritten, and the
// processor, which could not know how many bits a word has, has nothing to guess. Four go into one
// word, lest a compiler gather them in vectors, whose units are busy enough.
GV_INLINE void list_members(const Lists& lists, int block, int words, Members& out) {
  int n = 0;
  for (int w = 0; w < words; w++) {
    uint64_t set = lists.touching[block][w];
    int more = __builtin_popcountll(set);
    uint16_t* to = out.at + n;
    n += more;
    for (; more > 0; more -= AT_ONCE, to += AT_ONCE) {
      uint64_t four[AT_ONCE / 4];
      for (int k = 0; k < AT_ONCE; k++, set &= set - 1) {
        // the place of the lowest bit (63 if there is none), as the k-th of four 16-bit numbers
        uint64_t at = (uint64_t)__builtin_ctzll(set | 1ull << 63) << 16 * (k & 3);
        // the first of four starts from 64 w in each of them
        four[k / 4] = (k & 3 ? four[k / 4] : 0x0001000100010001ull * (64 * w)) + at;
      }
      __builtin_memcpy(to, four, sizeof four);
    }
  }
  out.count = n;
  for (int k = 0; k < GROUP; k++) out.at[n + k] = CHUNK;
}

// ---- pixels ------------------------------------------------------------------------------------

// The blocks of a tile that have pixels of the image.
GV_INLINE uint64_t blocks_inside(const Projection& p, int x0, int y0) {
  int columns = (p.width - x0 + 3) / 4, rows = (p.height - y0 + 3) / 4;
  uint64_t mask = columns >= 8 ? ~0ull : ((1ull << columns) - 1) * 0x0101010101010101ull;
  return rows >= 8 ? mask : mask & ((1ull << (8 * rows)) - 1);
}

alignas(64) static const float COLUMN[16] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
alignas(64) static const float ROW[16] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};

// The places of a block's pixels. Columns are the same in all parts.
struct Pixels {
  V x, y[PARTS];
};
GV_INLINE Pixels pixels_of(int x0, int y0, int block) {
  Pixels at;
  at.x = load(COLUMN) + (float)(x0 + block_x(block));
  for (int k = 0; k < PARTS; k++) at.y[k] = load(ROW + k * LANES) + (float)(y0 + block_y(block));
  return at;
}

// The exponent of alpha as in Record.
GV_INLINE void exponent(const Record& s, float lift, const Pixels& at, V* e) {
  V dx = at.x - s.u, x = dx * s.x, rest = lift - x * x, slant = dx * s.yx;
  for (int k = 0; k < PARTS; k++) {
    V y = (at.y[k] - s.v) * s.y + slant;
    e[k] = rest - y * y;
  }
}

// ---- transmittance -----------------------------------------------------------------------------
//
// A pixel's transmittance T is kept with its sign set once the pixel has stopped. While a block is
// blended, `left` falls on below the stop where a pixel has stopped, and T stays at what it was
// before: so the chain from one Gaussian to the next is a single multiply-add, not a comparison and
// a selection as well. Now and then what has stopped is set to 0, so that it never becomes a
// denormal number.

GV_INLINE V with_sign(V x) { return (V)((I)x | (I{} + INT32_MIN)); }
GV_INLINE V without_sign(V x) { return (V)((I)x & (I{} + INT32_MAX)); }

GV_INLINE Px running_part(const Px& T) {
  Px left;
  for (int k = 0; k < PARTS; k++) left.part[k] = keep(T.part[k] > 0.f, T.part[k]);
  return left;
}
GV_INLINE void drop_stopped(Px& left, float stop) {
  for (int k = 0; k < PARTS; k++) left.part[k] = keep(left.part[k] >= stop, left.part[k]);
}
GV_INLINE void sign_stopped(Px& T, const Px& left) {
  for (int k = 0; k < PARTS; k++)
    T.part[k] = select(left.part[k] > 0.f, T.part[k], with_sign(T.part[k]));
}

// Whether any pixel lets more than `limit` through.
GV_INLINE bool above(const Px& T, float limit) {
  V most = T.part[0];
  for (int k = 1; k < PARTS; k++) most = select(most > T.part[k], most, T.part[k]);
  return any_positive(most - limit);
}

}  // namespace gv::GV_NAMESPACE
