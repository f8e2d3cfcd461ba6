// Entries go to the bins of the tiles that a Gaussian reaches.
#pragma once
#include <stdint.h>

#include "kernels.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

GV_INLINE void append(const Projection& p, Bins& bins, uint32_t tile, Entry e) {
  Entry* to = bins.cursors[tile];
  EntryBlock* block = block_of(to);
  const auto* end = (Entry*)((uintptr_t)block + sizeof(Entry) * EntryBlock::CAPACITY);
  if (__builtin_expect(to == end, 0)) to = p.grow(&bins, block)->entry;
  *to = e;
  bins.cursors[tile] = to + 1;
}

// The entries of a Gaussian that reaches beyond the neighbours of its first tile. `e` has its depth
// and index; `x` and `y` pack the first and the last block of the image (low and high 16 bits).
GV_NOINLINE static void bin_tiles(const Projection& p, Bins& bins, Entry e, uint32_t x,
                                  uint32_t y) {
  uint32_t x0 = x & 0xffff, x1 = x >> 16, y0 = y & 0xffff, y1 = y >> 16;
  const int g = p.granularity, b = 3 - g;  // a block's number loses g bits and keeps b
  uint32_t tx0 = x0 >> 3, tx1 = x1 >> 3, ty0 = y0 >> 3, ty1 = y1 >> 3;  // tiles
  for (uint32_t ty = ty0; ty <= ty1; ty++) {
    // from block 0 but in the first tile, to block 7 but in the last
    uint32_t from_y = (ty == ty0 ? y0 & 7 : 0) >> g, to_y = (ty == ty1 ? y1 & 7 : 7) >> g;
    for (uint32_t tx = tx0; tx <= tx1; tx++) {
      uint32_t from_x = (tx == tx0 ? x0 & 7 : 0) >> g, to_x = (tx == tx1 ? x1 & 7 : 7) >> g;
      uint32_t columns = from_x | to_x << b, rows = from_y | to_y << b;
      append(p, bins, ty * p.tiles_x + tx, e | columns | rows << 2 * b);
    }
  }
}

}  // namespace gv::GV_NAMESPACE
