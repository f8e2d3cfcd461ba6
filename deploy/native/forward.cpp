// gv_forward: Gaussians to entries of tiles, and tiles to pixels.
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <vector>

#include "engine.h"
#include "frame.h"

namespace gv {
namespace {

constexpr int64_t PIECE = 4096;  // Gaussians that a thread projects at a time

// One forward on its way. The stages follow each other as the functions below.
struct Forward {
  Engine& engine;
  const Kernels& kernels;
  GvFrame& frame;
  Projection projection;
  const GvOptions& options;
  const GvImages& images;
  std::vector<Bins*> bins{};     // of the threads that have entries
  std::vector<size_t> offset{};  // of each tile in the frame's kept arrays
  std::atomic<int64_t> blended{0};

  size_t tiles() const { return (size_t)projection.tiles_x * projection.tiles_y; }
};

void project(Forward& f, int64_t count) {
  uint64_t number = ++f.engine.frames;
  auto piece = [&](uint32_t i, int thread) {
    ThreadBins& bins = f.engine.workers[thread]->bins;
    if (!bins.holds(number)) bins.begin(number, f.tiles());
    f.kernels.project(&f.projection, &bins.bins, i * PIECE, std::min(count, (i + 1) * PIECE));
  };
  for_each_task(f.engine, pieces_of(count, PIECE), piece);
  for (Worker* worker : f.engine.workers)
    if (worker->bins.holds(number)) f.bins.push_back(&worker->bins.bins);
}

uint32_t entries_of(const Forward& f, size_t tile) {
  uint32_t n = 0;
  for (const Bins* bins : f.bins) {
    const Entry* cursor = bins->cursors[tile];
    if (const EntryBlock* block = block_of(cursor))
      n += (uint32_t)(block->before + (cursor - block->entry));
  }
  return n;
}

// Counts the entries of all tiles, puts the tiles in order and makes room for what is kept.
size_t plan_tiles(Forward& f) {
  GvFrame& frame = f.frame;
  const size_t tiles = f.tiles(), kept_tiles = f.options.keep ? tiles : 0;
  frame.counts.assign(tiles, 0);
  frame.order.clear();
  frame.kept.assign(kept_tiles, Kept{});
  f.offset.resize(kept_tiles);
  size_t entries = 0;
  for (size_t t = 0; t < tiles; t++) {
    frame.counts[t] = entries_of(f, t);
    if (frame.counts[t]) frame.order.push_back((uint32_t)t);
    if (f.options.keep) f.offset[t] = entries;
    entries += frame.counts[t];
  }
  // the largest first, so that no thread begins a long tile when the others are done
  std::sort(frame.order.begin(), frame.order.end(), [&](uint32_t a, uint32_t b) {
    uint32_t n = frame.counts[a], m = frame.counts[b];
    return n != m ? n > m : a < b;
  });
  if (f.options.keep) {
    frame.kept_index.reserve(entries);
    frame.kept_blocks.reserve(entries);
    frame.kept_depth.reserve(entries);
  }
  return entries;
}

void sort_entries(Entry* entries, size_t n) { std::sort(entries, entries + n); }

void blend_tile(Forward& f, uint32_t tile, Worker& worker) {
  TileJob job{};
  job.projection = &f.projection;
  job.options = &f.options;
  job.images = &f.images;
  job.tile_x = (int32_t)(tile % f.projection.tiles_x);
  job.tile_y = (int32_t)(tile / f.projection.tiles_x);
  job.bins = f.bins.data();
  job.bin_count = (int32_t)f.bins.size();
  job.count = f.frame.counts[tile];
  job.work = worker.sort_room.reserve(job.count);
  job.scratch = worker.scratch.reserve(f.kernels.scratch_bytes);
  job.sort = sort_entries;
  job.clock = clock_seconds;
  if (f.options.keep) {
    job.kept_index = f.frame.kept_index.data() + f.offset[tile];
    job.kept_blocks = f.frame.kept_blocks.data() + f.offset[tile];
    job.kept_depth = f.frame.kept_depth.data() + f.offset[tile];
  }
  f.kernels.forward_tile(&job);
  if (f.options.keep)
    f.frame.kept[tile] = Kept{job.kept_index, job.kept_blocks, job.kept_depth, job.blended};
  f.blended += job.blended;
  worker.sort_s += job.sort_s;
  worker.blend_s += job.blend_s;
}

// The background where no Gaussian reaches, in a row of tiles.
void fill_background(Forward& f, int32_t row, Worker& worker) {
  const Projection& p = f.projection;
  const uint32_t* counts = f.frame.counts.data() + (size_t)row * p.tiles_x;
  double begun = clock_seconds();
  for (int32_t x = 0, end; x < p.tiles_x; x = end + 1) {
    for (end = x; end < p.tiles_x && !counts[end];) end++;  // the empty tiles from x on
    if (end > x)
      f.kernels.background(&p, &f.options, &f.images, x * TILE, std::min(end * TILE, p.width),
                           row * TILE, std::min((row + 1) * TILE, p.height));
  }
  worker.blend_s += clock_seconds() - begun;
}

// The background goes last: being short, it also fills up the time of who is done first.
void blend(Forward& f) {
  const uint32_t filled = (uint32_t)f.frame.order.size();
  auto task = [&](uint32_t i, int thread) {
    Worker& worker = *f.engine.workers[thread];
    if (i < filled) blend_tile(f, f.frame.order[i], worker);
    else fill_background(f, (int32_t)(i - filled), worker);
  };
  for (Worker* worker : f.engine.workers) worker->sort_s = worker->blend_s = 0;
  for_each_task(f.engine, filled + (uint32_t)f.projection.tiles_y, task);
}

// Sorting and blending as shares of the wall time that the tiles took.
void share_time(const Forward& f, double wall, GvReport& report) {
  double sort_s = 0, blend_s = 0;
  for (const Worker* worker : f.engine.workers) {
    sort_s += worker->sort_s;
    blend_s += worker->blend_s;
  }
  double busy = sort_s + blend_s;
  report.sort_s = busy > 0 ? wall * sort_s / busy : 0;
  report.blend_s = wall - report.sort_s;
}

void forward(Engine& engine, GvFrame& frame, const GvGaussians& gaussians, const GvCamera& camera,
             const GvOptions& options, const GvImages& images, GvReport& report) {
  double started = clock_seconds();
  Forward f{engine, engine.kernels(), frame, make_projection(gaussians, camera, options), options,
            images};
  size_t room = (size_t)gaussians.count + BATCH;  // batches are projected whole
  f.projection.records = frame.records.reserve(room);
  frame.has_opacity = gaussians.opacities || f.projection.antialiased;
  if (frame.has_opacity) f.projection.lift = frame.lift.reserve(room);

  project(f, gaussians.count);
  report = GvReport{};
  for (const Bins* bins : f.bins) {
    report.visible += bins->visible;
    report.dropped += bins->dropped;
  }
  report.entries = (int64_t)plan_tiles(f);
  double projected = clock_seconds();
  report.project_s = projected - started;

  blend(f);
  report.blended = f.blended;
  share_time(f, clock_seconds() - projected, report);
}

}  // namespace
}  // namespace gv

GV_API int32_t gv_forward(GvFrame* frame, const GvGaussians* gaussians, const GvCamera* camera,
                          const GvOptions* options, const GvImages* images, GvReport* report) {
  return gv::guarded([&](gv::Engine& engine) {
    gv::forward(engine, *frame, *gaussians, *camera, *options, *images, *report);
    return GV_DONE;
  });
}
