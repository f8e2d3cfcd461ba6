// A tile from its entries to pixels, front to back.
#pragma once
#include <stdint.h>

#include "block-inl.h"
#include "depth_order-inl.h"
#include "kernels.h"
#include "simd-inl.h"
#include "write-inl.h"

namespace gv::GV_NAMESPACE {

struct ForwardScratch {
  BlockState state[BLOCKS];
  Lists lists;
  Chosen chosen;
  uint32_t histogram[MOST_BUCKETS + 2];
};

// Gaussians between two looks at whether the block still lives, a multiple of GROUP.
constexpr int STRETCH = 8;

// Blend a block's Gaussians of a chunk; false when all of its pixels have stopped. What came too
// late is taken out of `kept`, the blocks of the chunk's Gaussians for the backward, unless null.
template <bool DEPTH, bool FAST>
static bool blend_block(BlockState& state, const Lists& lists, const Pixels& at, int block,
                        int words, float stop, float block_stop, uint64_t* kept) {
  Members members;
  list_members(lists, block, words, members);
  if (!members.count) return true;
  BlockState now = state;
  Px left = running_part(now.T);
  bool alive = true;
  int i = 0;
  while (i < members.count && alive) {
    // All alphas of a stretch first, which wait for nothing, then what goes from one Gaussian to
    // the next.
    const int end = i + STRETCH < members.count ? i + STRETCH : members.count;
    V alphas[STRETCH * PARTS];
    for (int first = i; first < end; first += GROUP) {
      V e[GROUP * PARTS], p[GROUP * PARTS];
      for (int j = 0; j < GROUP; j++) {
        int m = members.at[first + j];
        exponent(lists.local[m], lists.lift[m], at, e + j * PARTS);
      }
      power<FAST>(e, p);
      for (int j = 0; j < GROUP * PARTS; j++)
        alphas[(first - i) * PARTS + j] = drop(negative(e[j]), minimum(p[j], splat(ALPHA_MAX)));
    }
    for (const V* alpha = alphas; i < end; i++) {
      const Record& s = lists.local[members.at[i]];
      for (int k = 0; k < PARTS; k++, alpha++) {
        V weight = left.part[k] * *alpha, after = left.part[k] - weight;
        I stopped = negative(after - stop);  // the rule: before the Gaussian that would go below
        weight = drop(stopped, weight);
        left.part[k] = after;
        now.T.part[k] = (V)(((I)now.T.part[k] & stopped) | ((I)after & ~stopped));
        now.r.part[k] += weight * s.r;
        now.g.part[k] += weight * s.g;
        now.b.part[k] += weight * s.b;
        if (DEPTH) now.d.part[k] += weight * lists.depth[members.at[i]];
      }
    }
    drop_stopped(left, stop);
    alive = above(left, FAST ? block_stop : 0.5f * stop);
  }
  sign_stopped(now.T, left);
  state = now;
  if (!alive && kept)
    for (; i < members.count; i++) kept[members.at[i]] &= ~(1ull << block);
  return alive;
}

// Nothing blended yet; pixels beyond the image's border have stopped from the start.
GV_NOINLINE static void start_blocks(const Projection& p, BlockState* state, int x0, int y0) {
  for (int block = 0; block < BLOCKS; block++) {
    BlockState& s = state[block];
    int bx = x0 + block_x(block), by = y0 + block_y(block);
    float T[16];
    for (int i = 0; i < 16; i++)
      T[i] = bx + (i & 3) < p.width && by + (i >> 2) < p.height ? 1.f : -1.f;
    for (int k = 0; k < PARTS; k++) {
      s.T.part[k] = load(T + k * LANES);
      s.r.part[k] = s.g.part[k] = s.b.part[k] = s.d.part[k] = V{};
    }
  }
}

// The chosen entries' records to the lists, and to what is kept for the backward.
GV_INLINE void fetch_chunk(TileJob& job, ForwardScratch& scratch, int count, uint64_t alive) {
  const Projection& p = *job.projection;
  Lists& lists = scratch.lists;
  const int index_shift = 4 * (3 - p.granularity);
  for (int i = 0; i < count; i++) {
    Entry e = scratch.chosen.at(i);
    uint32_t index = (uint32_t)e >> index_shift;
    float depth = depth_of(e);
    fetch(p, index, depth, lists, i);
    lists.blocks[i] = blocks_of(e, p) & alive;
    if (job.kept_index) {
      uint32_t at = job.blended + i;
      job.kept_index[at] = index;
      job.kept_blocks[at] = lists.blocks[i];
      job.kept_depth[at] = depth;
    }
  }
}

template <bool DEPTH, bool FAST>
static void blend_tile(TileJob& job) {
  const Projection& p = *job.projection;
  ForwardScratch& scratch = *(ForwardScratch*)job.scratch;
  Lists& lists = scratch.lists;
  int x0 = job.tile_x * TILE, y0 = job.tile_y * TILE;
  double started = job.clock();
  DepthOrder order = bucket_entries(job, scratch.histogram);
  start_blocks(p, scratch.state, x0, y0);
  add_unseen(lists);
  uint64_t alive = blocks_inside(p, x0, y0);
  while (alive) {
    int count = next_chunk(order, alive, p, scratch.chosen);
    if (!count) break;
    fetch_chunk(job, scratch, count, alive);
    uint64_t* kept = job.kept_blocks ? job.kept_blocks + job.blended : nullptr;
    job.blended += count;
    list_by_block(lists, count);
    double sorted = job.clock();
    job.sort_s += sorted - started;
    int words = (count + 63) / 64;
    for (uint64_t left = alive; left; left &= left - 1) {
      int block = __builtin_ctzll(left);
      if (!blend_block<DEPTH, FAST>(scratch.state[block], lists, pixels_of(x0, y0, block), block,
                                    words, job.options->transmittance_stop, job.options->block_stop,
                                    kept))
        alive &= ~(1ull << block);
    }
    started = job.clock();
    job.blend_s += started - sorted;
  }
  write_blocks(job, scratch.state, x0, y0);
  job.blend_s += job.clock() - started;
}

static void forward_tile(TileJob* job) {
  job->blended = 0;
  job->sort_s = job->blend_s = 0;
  bool depth = job->images->depth != nullptr, fast = job->options->fast != 0;
  (depth ? (fast ? blend_tile<true, true> : blend_tile<true, false>)
         : (fast ? blend_tile<false, true> : blend_tile<false, false>))(*job);
}

}  // namespace gv::GV_NAMESPACE
