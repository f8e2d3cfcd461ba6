// The tile's entries in order of depth, handed out in chunks, so that what opaque pixels hide is
// never sorted. First all entries fall into buckets by depth; chunks are then whole buckets, sorted
// as they are asked for.
#pragma once
#include <stddef.h>
#include <stdint.h>

#include "kernels.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

GV_INLINE uint32_t depth_bits(Entry e) { return (uint32_t)(e >> 32); }
GV_INLINE float depth_of(Entry e) {
  uint32_t bits = depth_bits(e);
  float depth;
  __builtin_memcpy(&depth, &bits, 4);
  return depth;
}
// The blocks of the tile that an entry touches.
GV_INLINE uint64_t blocks_of(Entry e, const Projection& p) {
  const int bits = 6 - 2 * p.granularity;
  uint32_t code = (uint32_t)e, m = (1u << bits) - 1;
  return p.columns[code & m] & p.rows[code >> bits & m];
}

// At most CHUNK entries, those of even and those of odd places apart.
struct Chosen {
  static constexpr int HALF = CHUNK / 2;
  Entry even[HALF + 1], odd[HALF];  // one more, for the neighbour of the last odd one

  Entry& at(uint32_t i) {
    // A pointer first: GCC spreads an index over both sides of a choice of arrays, and what a
    // sanitizer adds to the index is then computed on one side only.
    Entry* half = i & 1 ? odd : even;
    return half[i >> 1];
  }
};

constexpr int MOST_BUCKETS = 4096;

struct DepthOrder {
  Entry* entries;
  uint32_t count, position, sorted_until;  // entries; given out; in order, from the first on
  uint32_t nearest, shift;                 // bucket = (depth bits - nearest) >> shift
  uint32_t* ends;                          // of the buckets
  void (*sort)(Entry*, size_t);

  uint32_t bucket(Entry e) const { return (depth_bits(e) - nearest) >> shift; }
};

template <typename F>
GV_INLINE void each_entry(const TileJob& job, F visit) {
  int tile = job.tile_y * job.projection->tiles_x + job.tile_x;
  for (int t = 0; t < job.bin_count; t++) {
    const Entry* cursor = job.bins[t]->cursors[tile];
    const EntryBlock* last = block_of(cursor);
    if (!last) continue;
    for (const EntryBlock* block = last->first;; block = block->next) {
      uint32_t n = block == last ? (uint32_t)(cursor - last->entry) : EntryBlock::CAPACITY;
      for (uint32_t i = 0; i < n; i++) visit(block->entry[i]);
      if (block == last) break;
    }
  }
}

// Counting sort by bucket. `histogram`: room for MOST_BUCKETS + 2. Counts stand one place further
// on, so that their running sum is where each bucket starts, and, once filled, where it ends.
GV_NOINLINE static DepthOrder bucket_entries(const TileJob& job, uint32_t* histogram) {
  uint32_t nearest = ~0u, farthest = 0;
  each_entry(job, [&](Entry e) {
    uint32_t z = depth_bits(e);
    nearest = z < nearest ? z : nearest;
    farthest = z > farthest ? z : farthest;
  });
  if (job.options->depth_cut > 0) {
    float limit;
    __builtin_memcpy(&limit, &nearest, 4);
    limit += job.options->depth_cut;
    uint32_t bits;
    __builtin_memcpy(&bits, &limit, 4);
    farthest = bits < farthest ? bits : farthest;
  }
  // 2^wanted buckets at most, about one to four for each entry
  int wanted = job.count > 1500 ? 12 : job.count > 512 ? 10 : job.count > 64 ? 8 : 4;
  int bits = 32 - __builtin_clz((farthest - nearest) | 1);
  uint32_t shift = (uint32_t)(bits > wanted ? bits - wanted : 0);
  DepthOrder order{job.work, job.count, 0, 0, nearest, shift, histogram, job.sort};
  uint32_t buckets = ((farthest - nearest) >> order.shift) + 1;
  __builtin_memset(histogram, 0, 4 * (buckets + 1));
  if (job.options->depth_cut > 0) {
    order.count = 0;
    each_entry(job, [&](Entry e) {
      if (depth_bits(e) > farthest) return;
      histogram[order.bucket(e) + 1]++;
      order.count++;
    });
    for (uint32_t i = 1; i <= buckets; i++) histogram[i] += histogram[i - 1];
    each_entry(job, [&](Entry e) {
      if (depth_bits(e) <= farthest) order.entries[histogram[order.bucket(e)]++] = e;
    });
    return order;
  }
  each_entry(job, [&](Entry e) { histogram[order.bucket(e) + 1]++; });
  for (uint32_t i = 1; i <= buckets; i++) histogram[i] += histogram[i - 1];
  each_entry(job, [&](Entry e) { order.entries[histogram[order.bucket(e)]++] = e; });
  return order;
}

// Odd-even transposition: neighbours change places until none has to. What comes in is in order but
// for the few that share a bucket, so this takes about as many turns as the largest bucket has
// entries, and each turn is a few vector operations without a branch, where to insert one by one is
// a guess for every entry.
GV_NOINLINE static void sort_chosen(Chosen& c, uint32_t n) {
  const Entry last = ~(Entry)0 >> 1;  // entries are below 2^63: their first bit is a depth's sign
  if (n & 1) c.odd[n / 2] = last;
  uint32_t pairs = (n + 1) / 2;
  c.even[pairs] = last;
  for (;;) {
    int64_t moved = 0;  // negative once two have changed places
    for (uint32_t i = 0; i < pairs; i++) {
      int64_t a = (int64_t)c.even[i], b = (int64_t)c.odd[i];
      moved |= b - a;
      c.even[i] = a < b ? a : b;
      c.odd[i] = a < b ? b : a;
    }
    for (uint32_t i = 0; i < pairs; i++) {
      int64_t a = (int64_t)c.odd[i], b = (int64_t)c.even[i + 1];
      moved |= b - a;
      c.odd[i] = a < b ? a : b;
      c.even[i + 1] = a < b ? b : a;
    }
    if (moved >= 0) return;
  }
}

// The next entries that touch a block of `alive`, at most CHUNK, in order; 0 when there are no
// more.
GV_NOINLINE static int next_chunk(DepthOrder& o, uint64_t alive, const Projection& p, Chosen& out) {
  const int index_shift = 4 * (3 - p.granularity);
  uint32_t n = 0;
  bool ordered = true;
  while (n < CHUNK / 2 && o.position < o.count) {
    uint32_t end = o.position + (CHUNK - n);
    if (end > o.count) end = o.count;
    bool in_order = o.position < o.sorted_until;
    if (in_order) {
      end = end < o.sorted_until ? end : o.sorted_until;
    } else if (end < o.count) {
      uint32_t last = o.bucket(o.entries[end - 1]), start = last ? o.ends[last - 1] : 0;
      if (o.ends[last] > end) {  // the last bucket does not fit as a whole
        if (start > o.position) {
          end = start;
        } else if (n) {
          break;
        } else {  // one bucket larger than a chunk
          o.sort(o.entries + o.position, o.ends[last] - o.position);
          o.sorted_until = o.ends[last];
          in_order = true;
        }
      }
    }
    ordered &= in_order;
    const Entry* from = o.entries + o.position;
    const Entry* to = o.entries + end;
    o.position = end;
    for (; from < to; from++) {
      Entry e = *from;
      out.at(n) = e;  // overwritten by the next one unless it counts
      n += (blocks_of(e, p) & alive) != 0;
      // Records lie in the order of the input, so each is a miss in the cache, and a wait when it
      // is read: begin now.
      __builtin_prefetch(&p.records[(uint32_t)e >> index_shift], 0, 2);
    }
  }
  if (!ordered) sort_chosen(out, n);
  return (int)n;
}

}  // namespace gv::GV_NAMESPACE
