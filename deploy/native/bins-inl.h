// Entries: which blocks of which tiles a Gaussian reaches.
#pragma once
#include "kernels.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

GV_INLINE void append(const Projection& p, Bins& bins, uint32_t tile, Entry e) {
  Entry* to = bins.cursors[tile];
  EntryBlock* block = block_of(to);
  if (__builtin_expect(to == (Entry*)((uintptr_t)block + sizeof(Entry) * EntryBlock::CAPACITY), 0))
    to = p.grow(&bins, block)->entry;
  *to = e;
  bins.cursors[tile] = to + 1;
}

// A Gaussian that reaches beyond the neighbours of a tile. `x` and `y` pack the first and last block of the image (low
// and high 16 bits).
GV_NOINLINE static void bin_tiles(const Projection& p, Bins& bins, Entry e, uint32_t x, uint32_t y) {
  uint32_t x0 = x & 0xffff, x1 = x >> 16, y0 = y & 0xffff, y1 = y >> 16;
  int g = p.granularity, b = 3 - g;
  uint32_t tx0 = x0 >> 3, tx1 = x1 >> 3, ty0 = y0 >> 3, ty1 = y1 >> 3;
  for (uint32_t ty = ty0; ty <= ty1; ty++) {
    uint32_t from_y = (ty == ty0 ? y0 & 7 : 0) >> g, to_y = (ty == ty1 ? y1 & 7 : 7) >> g;
    for (uint32_t tx = tx0; tx <= tx1; tx++) {
      uint32_t from_x = (tx == tx0 ? x0 & 7 : 0) >> g, to_x = (tx == tx1 ? x1 & 7 : 7) >> g;
      append(p, bins, ty * p.tiles_x + tx, e | from_x | to_x << b | (from_y | to_y << b) << 2 * b);
    }
  }
}

}  // namespace gv::GV_NAMESPACE
