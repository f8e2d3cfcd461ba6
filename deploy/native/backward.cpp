// gv_backward: from gradients of pixels to those of Gaussians.
#include <algorithm>
#include <cstdint>
#include <vector>

#include "engine.h"
#include "frame.h"

namespace gv {
namespace {

// One backward on its way. `more` and `tile_more` are null unless opacity or depth gradients flow.
struct Backward {
  Engine& engine;
  const Kernels& kernels;
  const GvFrame& frame;
  Projection projection;
  const GvOptions& options;
  const GvImages& images;
  const GvImages& upstream;
  std::vector<size_t> offset{};                // of each tile in the sums of tiles
  Sums *sums = nullptr, *tile_sums = nullptr;  // of Gaussians; of tiles' Gaussians as they are kept
  MoreSums *more = nullptr, *tile_more = nullptr;
};

void make_room(Backward& b, int64_t count, bool want_more) {
  const size_t tiles = b.frame.kept.size(), room = (size_t)count + BATCH;
  size_t total = 0;
  b.offset.resize(tiles);
  for (size_t t = 0; t < tiles; t++) {
    b.offset[t] = total;
    total += b.frame.kept[t].count;
  }
  b.tile_sums = b.engine.tile_sums.reserve(total);
  b.sums = b.engine.sums.reserve_zeroed(room);
  if (!want_more) return;
  b.tile_more = b.engine.tile_more.reserve(total);
  b.more = b.engine.more.reserve_zeroed(room);
}

void replay_tile(const Backward& b, uint32_t tile, Worker& worker) {
  const Kept& kept = b.frame.kept[tile];
  if (!kept.count) return;
  BackwardTileJob job{};
  job.projection = &b.projection;
  job.options = &b.options;
  job.images = &b.images;
  job.upstream = &b.upstream;
  job.tile_x = (int32_t)(tile % b.projection.tiles_x);
  job.tile_y = (int32_t)(tile / b.projection.tiles_x);
  job.kept = kept;
  job.sums = b.tile_sums + b.offset[tile];
  job.more = b.more ? b.tile_more + b.offset[tile] : nullptr;
  job.scratch = worker.scratch.reserve(b.kernels.scratch_bytes);
  b.kernels.backward_tile(&job);
}

// Adds up the sums of Gaussians [begin, end) in order of tiles.
void gather(const Backward& b, int64_t begin, int64_t end) {
  Sums* const sums = b.sums;
  MoreSums* const more = b.more;
  for (size_t t = 0; t < b.frame.kept.size(); t++) {
    const Kept& kept = b.frame.kept[t];
    for (uint32_t j = 0; j < kept.count; j++) {
      if (j + 16 < kept.count) __builtin_prefetch(&sums[kept.index[j + 16]], 1);
      int64_t at = (int64_t)kept.index[j] - begin;
      if ((uint64_t)at >= (uint64_t)(end - begin)) continue;  // not of [begin, end)
      float* to = &sums[begin + at].v_dx;
      const float* from = &b.tile_sums[b.offset[t] + j].v_dx;
      for (int k = 0; k < 8; k++) to[k] += from[k];
      if (more) {
        more[begin + at].v += b.tile_more[b.offset[t] + j].v;
        more[begin + at].w_depth += b.tile_more[b.offset[t] + j].w_depth;
      }
    }
  }
}

// Gaussians that one task owns: whole batches, and about two tasks a thread.
int64_t piece_size(int64_t count, int threads) {
  int64_t pieces = std::max<int64_t>(1, std::min<int64_t>(threads * 2, count / 4096));
  int64_t piece = (count + pieces - 1) / pieces;
  return std::max<int64_t>((piece + BATCH - 1) / BATCH * BATCH, BATCH);
}

void backward(Engine& engine, const GvFrame& frame, const GvGaussians& gaussians,
              const GvCamera& camera, const GvOptions& options, const GvImages& images,
              const GvImages& upstream, const GvGradients& out, GvBackwardReport& report) {
  double started = clock_seconds();
  const int64_t count = gaussians.count;
  Backward b{engine,  engine.kernels(), frame,   make_projection(gaussians, camera, options),
             options, images,           upstream};
  b.projection.records = frame.records.data();
  b.projection.lift = frame.has_opacity ? frame.lift.data() : nullptr;
  make_room(b, count, out.opacities || upstream.depth || b.projection.antialiased);

  for_each_task(engine, (uint32_t)frame.order.size(), [&](uint32_t i, int thread) {
    replay_tile(b, frame.order[i], *engine.workers[thread]);
  });
  double blended = clock_seconds();
  report.blend_s = blended - started;

  // Each task owns a range of Gaussians: no locks, and the same result whatever the number of
  // threads.
  int64_t piece = piece_size(count, engine.pool->size());
  for_each_task(engine, pieces_of(count, piece), [&](uint32_t i, int) {
    int64_t begin = i * piece, end = std::min(count, begin + piece);
    gather(b, begin, end);
    b.kernels.backward_project(&b.projection, b.sums, b.more, &out, begin, end);
  });
  report.project_s = clock_seconds() - blended;
}

}  // namespace
}  // namespace gv

GV_API int32_t gv_backward(GvFrame* frame, const GvGaussians* gaussians, const GvCamera* camera,
                           const GvOptions* options, const GvImages* images,
                           const GvImages* upstream, const GvGradients* gradients,
                           GvBackwardReport* report) {
  return gv::guarded([&](gv::Engine& engine) {
    gv::backward(engine, *frame, *gaussians, *camera, *options, *images, *upstream, *gradients,
                 *report);
    return GV_DONE;
  });
}
