// The C interface: chooses the instruction set, owns threads and buffers, and runs the kernels' stages.
#include "kernels.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <new>
#include <vector>
#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

#include "pool.h"

namespace gv {

// ---- instruction sets ---------------------------------------------------------------------------------------------
#if defined(__x86_64__) && !defined(GV_BASELINE_ONLY)
extern const Kernels kernels_sse4, kernels_avx2, kernels_avx512;
#else
extern const Kernels kernels_baseline;
#endif

namespace {

struct Isa {
  const char* name;
  const Kernels* kernels;
  bool (*supported)();
};
#if defined(__x86_64__) && !defined(GV_BASELINE_ONLY)
bool supports_avx2() {  // with all that setup.py lets the compiler use
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
         __builtin_cpu_supports("bmi2");
}
#endif
const Isa ISAS[] = {
#if defined(__x86_64__) && !defined(GV_BASELINE_ONLY)
    {"sse4", &kernels_sse4, [] { return __builtin_cpu_supports("sse4.1") != 0; }},
    {"avx2", &kernels_avx2, supports_avx2},
    {"avx512", &kernels_avx512,
     [] {
       return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
              __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") && supports_avx2();
     }},
#else
    {"baseline", &kernels_baseline, [] { return true; }},
#endif
};
constexpr int ISA_COUNT = sizeof ISAS / sizeof ISAS[0];

// ---- buffers ------------------------------------------------------------------------------------------------------

// Memory that only grows, aligned for vectors, contents not kept across growth and not initialised.
template <class T>
class Buffer {
 public:
  Buffer() = default;
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  ~Buffer() { std::free(data_); }
  T* reserve(size_t n) {
    if (n > capacity_) {
      std::free(data_);
      data_ = nullptr;
      capacity_ = 0;
      size_t wanted = n + n / 4 + 64, bytes = (wanted * sizeof(T) + 63) / 64 * 64;
      data_ = static_cast<T*>(std::aligned_alloc(64, bytes));
      if (!data_) throw std::bad_alloc();
      capacity_ = wanted;
    }
    return data_;
  }
  T* reserve_zeroed(size_t n) {  // zero when it grows; whoever writes puts the zeros back
    size_t before = capacity_;
    reserve(n);
    if (capacity_ != before) std::memset(static_cast<void*>(data_), 0, capacity_ * sizeof(T));
    return data_;
  }
  T* data() const { return data_; }
  size_t bytes() const { return capacity_ * sizeof(T); }

 private:
  T* data_ = nullptr;
  size_t capacity_ = 0;
};

double clock_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void sort_entries(Entry* entries, size_t n) { std::sort(entries, entries + n); }

// A thread's entries: lists of blocks, which come from slabs that are used again by the next frame.
struct ThreadBins {
  Bins bins{};
  Buffer<Entry*> cursors;
  std::vector<EntryBlock*> slabs;
  size_t used = 0;
  uint64_t frame = 0;  // the frame these bins belong to
  static constexpr size_t SLAB = 128;

  ~ThreadBins() {
    for (EntryBlock* slab : slabs) std::free(slab);
  }
  EntryBlock* grow(EntryBlock* previous) {
    if (used == slabs.size() * SLAB) {
      void* slab = std::aligned_alloc(sizeof(EntryBlock), sizeof(EntryBlock) * SLAB);
      if (!slab) throw std::bad_alloc();
      slabs.push_back(static_cast<EntryBlock*>(slab));
    }
    EntryBlock* block = slabs[used / SLAB] + used % SLAB;
    used++;
    block->first = previous ? previous->first : block;
    block->before = previous ? previous->before + EntryBlock::CAPACITY : 0;
    if (previous) previous->next = block;
    return block;
  }
  void begin(uint64_t number, size_t tiles) {
    frame = number;
    used = 0;
    bins.cursors = cursors.reserve(tiles);
    std::fill_n(bins.cursors, tiles, NO_ENTRIES);
    bins.visible = bins.dropped = 0;
    bins.owner = this;
  }
};
EntryBlock* grow_bins(Bins* bins, EntryBlock* previous) {
  return static_cast<ThreadBins*>(bins->owner)->grow(previous);
}

struct Worker {
  ThreadBins bins;
  Buffer<Entry> sort_room;
  Buffer<char> scratch;
  double sort_s = 0, blend_s = 0;
};

struct Engine {
  std::mutex mutex;
  Pool* pool = new Pool;  // never destroyed: its threads may outlive static destruction
  std::vector<Worker*> workers;
  int isa = -1;
  uint64_t frames = 0;
  Buffer<Sums> sums, tile_sums;
  Buffer<MoreSums> more, tile_more;

  const Kernels& kernels() {
    if (isa < 0) choose(-1);
    return *ISAS[isa].kernels;
  }
  int choose(int wanted) {
    isa = 0;
    for (int i = 0; i < ISA_COUNT; i++)
      if (ISAS[i].supported() && (wanted < 0 || i == wanted)) isa = i;
    return isa;
  }
  void prepare() {
    if (!pool->size()) pool->resize(0);
    while ((int)workers.size() < pool->size()) workers.push_back(new Worker);
  }
};

Engine& engine() {
  static Engine* e = [] {
    auto* made = new Engine;
#if defined(__unix__) || defined(__APPLE__)
    static Engine* shared;
    shared = made;
    // A fork copies only the calling thread. The child starts a pool of its own when it first needs one; the parent's
    // threads are not there to be ended, so the copied pool is simply forgotten.
    pthread_atfork([] { shared->mutex.lock(); }, [] { shared->mutex.unlock(); },
                   [] {
                     int size = shared->pool->size();
                     shared->pool = new Pool;
                     if (size) shared->pool->resize(size);
                     shared->mutex.unlock();
                   });
#endif
    return made;
  }();
  return *e;
}

Projection make_projection(const GvGaussians& gaussians, const GvCamera& camera, const GvOptions& options) {
  Projection p{};
  p.gaussians = gaussians;
  std::memcpy(p.rotation, camera.rotation, sizeof p.rotation);
  std::memcpy(p.translation, camera.translation, sizeof p.translation);
  for (int i = 0; i < 9; i++) p.rotation_f[i] = (float)camera.rotation[i];
  p.fx = (float)camera.fx, p.fy = (float)camera.fy, p.cx = (float)camera.cx, p.cy = (float)camera.cy;
  p.width = camera.width, p.height = camera.height;
  for (int i = 0; i < 3; i++) {
    double eye = 0;
    for (int k = 0; k < 3; k++) eye -= camera.rotation[3 * k + i] * camera.translation[k];
    p.eye[i] = (float)eye;
  }
  p.backface = gaussians.normals ? options.backface : 0;
  p.antialiased = options.antialiased != 0;
  double wide = FRUSTUM_MARGIN * 0.5 * camera.width / camera.fx, tall = FRUSTUM_MARGIN * 0.5 * camera.height / camera.fy;
  p.x_low = (float)(-camera.cx / camera.fx - wide);
  p.x_high = (float)((camera.width - camera.cx) / camera.fx + wide);
  p.y_low = (float)(-camera.cy / camera.fy - tall);
  p.y_high = (float)((camera.height - camera.cy) / camera.fy + tall);
  p.tiles_x = (camera.width + TILE - 1) / TILE;
  p.tiles_y = (camera.height + TILE - 1) / TILE;
  p.granularity = 0;
  while (p.granularity < 3 && gaussians.count > (1ll << (32 - 4 * (3 - p.granularity)))) p.granularity++;
  const int g = p.granularity, b = 3 - g;
  for (uint32_t code = 0; code < 1u << 2 * b; code++) {
    uint32_t first = (code & ((1u << b) - 1)) << g, last = ((code >> b) << g) + (1u << g) - 1;
    p.columns[code] = p.rows[code] = 0;
    for (uint32_t i = first; i <= last; i++) {
      p.columns[code] |= 0x0101010101010101ull << i;
      p.rows[code] |= 0xffull << 8 * i;
    }
  }
  p.grow = grow_bins;
  return p;
}

}  // namespace
}  // namespace gv

using namespace gv;

// What a backward needs of its forward. Tiles were blended by any thread in any order; each has its own place in the
// kept arrays, so that nothing depends on which thread did it and results are the same to the last bit.
struct GvFrame {
  Buffer<Record> records;
  Buffer<float> lift;
  Buffer<uint32_t> kept_index;
  Buffer<uint64_t> kept_blocks;
  Buffer<float> kept_depth;
  std::vector<Kept> kept;
  std::vector<uint32_t> counts, order;  // entries of each tile; those that have any, with most entries first
  bool has_opacity = false;

  int64_t bytes() const {
    return (int64_t)(records.bytes() + lift.bytes() + kept_index.bytes() + kept_blocks.bytes() +
                     kept_depth.bytes() + kept.capacity() * sizeof(Kept) + counts.capacity() * 8);
  }
};

namespace {

void forward(Engine& e, GvFrame& frame, const GvGaussians& gaussians, const GvCamera& camera, const GvOptions& options,
             const GvImages& images, GvReport& report) {
  const Kernels& kernels = e.kernels();
  e.prepare();
  Pool& pool = *e.pool;
  double started = clock_seconds();
  uint64_t number = ++e.frames;
  Projection p = make_projection(gaussians, camera, options);
  p.records = frame.records.reserve((size_t)gaussians.count + BATCH);
  frame.has_opacity = gaussians.opacities || p.antialiased;
  if (frame.has_opacity) p.lift = frame.lift.reserve((size_t)gaussians.count + BATCH);
  size_t tiles = (size_t)p.tiles_x * p.tiles_y;

  constexpr int64_t PIECE = 4096;
  std::atomic<bool> failed{false};  // an exception must not leave a worker thread
  auto project = [&](uint32_t i, int thread) {
    try {
      ThreadBins& bins = e.workers[thread]->bins;
      if (bins.frame != number) bins.begin(number, tiles);
      kernels.project(&p, &bins.bins, i * PIECE, std::min(gaussians.count, (int64_t)(i + 1) * PIECE));
    } catch (const std::bad_alloc&) {
      failed = true;
    }
  };
  pool.for_each((uint32_t)((gaussians.count + PIECE - 1) / PIECE), project);
  if (failed) throw std::bad_alloc();

  std::vector<Bins*> bins;
  report = GvReport{};
  for (Worker* w : e.workers) {
    w->sort_s = w->blend_s = 0;
    if (w->bins.frame != number) continue;
    bins.push_back(&w->bins.bins);
    report.visible += w->bins.bins.visible;
    report.dropped += w->bins.bins.dropped;
  }
  frame.counts.assign(tiles, 0);
  frame.order.clear();
  frame.kept.assign(options.keep ? tiles : 0, Kept{});
  size_t entries = 0;
  std::vector<size_t> offset(options.keep ? tiles : 0);
  for (size_t t = 0; t < tiles; t++) {
    uint32_t n = 0;
    for (Bins* b : bins)
      if (const EntryBlock* block = block_of(b->cursors[t]))
        n += (uint32_t)(block->before + (b->cursors[t] - block->entry));
    frame.counts[t] = n;
    if (n) frame.order.push_back((uint32_t)t);
    if (options.keep) offset[t] = entries;
    entries += n;
  }
  report.entries = (int64_t)entries;
  // the largest first, so that no thread begins a long tile when the others are done
  std::sort(frame.order.begin(), frame.order.end(), [&](uint32_t a, uint32_t b) {
    return frame.counts[a] != frame.counts[b] ? frame.counts[a] > frame.counts[b] : a < b;
  });
  if (options.keep) {
    frame.kept_index.reserve(entries);
    frame.kept_blocks.reserve(entries);
    frame.kept_depth.reserve(entries);
  }
  double projected = clock_seconds();
  report.project_s = projected - started;

  std::atomic<int64_t> blended{0};
  auto tile = [&](uint32_t i, int thread) {
    try {
      Worker& worker = *e.workers[thread];
      uint32_t t = frame.order[i];
      TileJob job{};
      job.projection = &p;
      job.options = &options;
      job.images = &images;
      job.tile_x = (int32_t)(t % p.tiles_x);
      job.tile_y = (int32_t)(t / p.tiles_x);
      job.bins = bins.data();
      job.bin_count = (int32_t)bins.size();
      job.count = frame.counts[t];
      job.work = worker.sort_room.reserve(job.count);
      job.scratch = worker.scratch.reserve(std::max(kernels.forward_scratch_bytes, kernels.backward_scratch_bytes));
      job.sort = sort_entries;
      job.clock = clock_seconds;
      if (options.keep) {
        job.kept_index = frame.kept_index.data() + offset[t];
        job.kept_blocks = frame.kept_blocks.data() + offset[t];
        job.kept_depth = frame.kept_depth.data() + offset[t];
      }
      kernels.forward_tile(&job);
      if (options.keep) frame.kept[t] = Kept{job.kept_index, job.kept_blocks, job.kept_depth, job.blended};
      blended += job.blended;
      worker.sort_s += job.sort_s;
      worker.blend_s += job.blend_s;
    } catch (const std::bad_alloc&) {
      failed = true;
    }
  };
  // What no Gaussian reaches, by rows of tiles: last and short, it also fills up the time of who is done first.
  auto background = [&](uint32_t row, int thread) {
    const uint32_t* counts = frame.counts.data() + (size_t)row * p.tiles_x;
    double begun = clock_seconds();
    for (int32_t x = 0, end; x < p.tiles_x; x = end + 1) {
      for (end = x; end < p.tiles_x && !counts[end];) end++;
      if (end > x)
        kernels.background(&p, &options, &images, x * TILE, std::min(end * TILE, p.width), (int32_t)row * TILE,
                           std::min((int32_t)(row + 1) * TILE, p.height));
    }
    e.workers[thread]->blend_s += clock_seconds() - begun;
  };
  const uint32_t filled = (uint32_t)frame.order.size();
  auto task = [&](uint32_t i, int thread) { i < filled ? tile(i, thread) : background(i - filled, thread); };
  pool.for_each(filled + (uint32_t)p.tiles_y, task);
  if (failed) throw std::bad_alloc();
  report.blended = blended;
  double sort_s = 0, blend_s = 0;
  for (Worker* w : e.workers) {
    sort_s += w->sort_s;
    blend_s += w->blend_s;
  }
  // the stages as shares of the wall time that the tiles took
  double wall = clock_seconds() - projected, busy = sort_s + blend_s;
  report.sort_s = busy > 0 ? wall * sort_s / busy : 0;
  report.blend_s = wall - report.sort_s;
}

void backward(Engine& e, GvFrame& frame, const GvGaussians& gaussians, const GvCamera& camera, const GvOptions& options,
              const GvImages& images, const GvImages& upstream, const GvGradients& out, GvBackwardReport& report) {
  const Kernels& kernels = e.kernels();
  e.prepare();
  Pool& pool = *e.pool;
  double started = clock_seconds();
  Projection p = make_projection(gaussians, camera, options);
  p.records = frame.records.data();
  p.lift = frame.has_opacity ? frame.lift.data() : nullptr;
  bool want_more = out.opacities || upstream.depth || p.antialiased;
  size_t tiles = frame.kept.size(), total = 0;
  std::vector<size_t> offset(tiles);
  for (size_t t = 0; t < tiles; t++) {
    offset[t] = total;
    total += frame.kept[t].count;
  }
  Sums* tile_sums = e.tile_sums.reserve(total);
  MoreSums* tile_more = want_more ? e.tile_more.reserve(total) : nullptr;
  Sums* sums = e.sums.reserve_zeroed((size_t)gaussians.count + BATCH);
  MoreSums* more = want_more ? e.more.reserve_zeroed((size_t)gaussians.count + BATCH) : nullptr;

  std::atomic<bool> failed{false};
  auto tile = [&](uint32_t i, int thread) {
    try {
      uint32_t t = frame.order[i];
      if (!frame.kept[t].count) return;
      BackwardTileJob job{};
      job.projection = &p;
      job.options = &options;
      job.images = &images;
      job.upstream = &upstream;
      job.tile_x = (int32_t)(t % p.tiles_x);
      job.tile_y = (int32_t)(t / p.tiles_x);
      job.kept = frame.kept[t];
      job.sums = tile_sums + offset[t];
      job.more = want_more ? tile_more + offset[t] : nullptr;
      job.scratch = e.workers[thread]->scratch.reserve(
          std::max(kernels.forward_scratch_bytes, kernels.backward_scratch_bytes));
      kernels.backward_tile(&job);
    } catch (const std::bad_alloc&) {
      failed = true;
    }
  };
  pool.for_each((uint32_t)frame.order.size(), tile);
  if (failed) throw std::bad_alloc();
  double blended = clock_seconds();

  // Each task owns a range of Gaussians and adds up their sums in order of tiles: no locks, and the same result
  // whatever the number of threads.
  int64_t pieces = std::max<int64_t>(1, std::min<int64_t>(pool.size() * 2, gaussians.count / 4096));
  int64_t piece = (gaussians.count + pieces - 1) / pieces;
  piece = std::max<int64_t>((piece + BATCH - 1) / BATCH * BATCH, BATCH);
  auto gather = [&](uint32_t i, int) {
    int64_t begin = i * piece, end = std::min(gaussians.count, begin + piece);
    if (begin >= end) return;
    for (size_t t = 0; t < tiles; t++) {
      const Kept& kept = frame.kept[t];
      for (uint32_t j = 0; j < kept.count; j++) {
        if (j + 16 < kept.count) __builtin_prefetch(&sums[kept.index[j + 16]], 1);
        int64_t at = (int64_t)kept.index[j] - begin;
        if ((uint64_t)at >= (uint64_t)(end - begin)) continue;
        float* to = &sums[begin + at].v_dx;
        const float* from = &tile_sums[offset[t] + j].v_dx;
        for (int k = 0; k < 8; k++) to[k] += from[k];
        if (want_more) {
          more[begin + at].v += tile_more[offset[t] + j].v;
          more[begin + at].w_depth += tile_more[offset[t] + j].w_depth;
        }
      }
    }
    kernels.backward_project(&p, sums, more, &out, begin, end);
  };
  pool.for_each((uint32_t)pieces, gather);
  report.blend_s = blended - started;
  report.project_s = clock_seconds() - blended;
}

template <class F>
int32_t guarded(F body) {
  Engine& e = engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  try {
    body(e);
    return 0;
  } catch (const std::bad_alloc&) {
    return -1;
  }
}

}  // namespace

GV_API int32_t gv_abi_version(void) { return GV_ABI_VERSION; }
GV_API const char* gv_compiler(void) { return __VERSION__; }

GV_API int32_t gv_isa_count(void) { return ISA_COUNT; }
GV_API const char* gv_isa_name(int32_t isa) { return isa >= 0 && isa < ISA_COUNT ? ISAS[isa].name : ""; }
GV_API int32_t gv_isa_supported(int32_t isa) { return isa >= 0 && isa < ISA_COUNT && ISAS[isa].supported(); }
GV_API int32_t gv_isa(void) {
  Engine& e = engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  e.kernels();
  return e.isa;
}
GV_API int32_t gv_set_isa(int32_t isa) {
  Engine& e = engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  return e.choose(isa);
}

GV_API int32_t gv_threads(void) {
  Engine& e = engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  if (!e.pool->size()) e.pool->resize(0);
  return e.pool->size();
}
GV_API void gv_set_threads(int32_t threads) {
  Engine& e = engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  e.pool->resize(threads);
}

GV_API GvFrame* gv_frame_new(void) { return new (std::nothrow) GvFrame; }
GV_API void gv_frame_free(GvFrame* frame) { delete frame; }
GV_API int64_t gv_frame_bytes(const GvFrame* frame) { return frame->bytes(); }

GV_API int32_t gv_forward(GvFrame* frame, const GvGaussians* gaussians, const GvCamera* camera,
                          const GvOptions* options, const GvImages* images, GvReport* report) {
  return guarded([&](Engine& e) { forward(e, *frame, *gaussians, *camera, *options, *images, *report); });
}

GV_API int32_t gv_backward(GvFrame* frame, const GvGaussians* gaussians, const GvCamera* camera,
                           const GvOptions* options, const GvImages* images, const GvImages* upstream,
                           const GvGradients* gradients, GvBackwardReport* report) {
  return guarded([&](Engine& e) {
    backward(e, *frame, *gaussians, *camera, *options, *images, *upstream, *gradients, *report);
  });
}

namespace {
constexpr int64_t SKIN_PIECE = 8192;
uint32_t skin_pieces(int64_t count) { return (uint32_t)((count + SKIN_PIECE - 1) / SKIN_PIECE); }
}  // namespace

GV_API int32_t gv_skin(int64_t count, int32_t slots, int32_t joints, int32_t stride, const float* points,
                       const int32_t* index, const float* weight, const float* transforms, float* out) {
  std::atomic<bool> sound{true};
  int32_t code = guarded([&](Engine& e) {
    const Kernels& kernels = e.kernels();
    e.prepare();
    std::vector<float> columns((size_t)joints * 16, 0.f);
    for (int32_t j = 0; j < joints; j++)
      for (int r = 0; r < 3; r++)
        for (int c = 0; c < 4; c++) columns[16 * j + 4 * c + r] = transforms[(size_t)stride * j + 4 * r + c];
    auto piece = [&](uint32_t i, int) {
      if (!kernels.skin(i * SKIN_PIECE, std::min(count, (int64_t)(i + 1) * SKIN_PIECE), slots, joints, points, index,
                        weight, columns.data(), out))
        sound = false;
    };
    e.pool->for_each(skin_pieces(count), piece);
  });
  return sound ? code : -2;
}

GV_API int32_t gv_blendshapes(int64_t count, int32_t groups, int32_t parts, const float* base, const uint8_t* part,
                              const int8_t* basis, const float* coefficients, const float* gains, float* points,
                              float* colors, float* scales) {
  std::atomic<bool> sound{true};
  int32_t code = guarded([&](Engine& e) {
    const Kernels& kernels = e.kernels();
    e.prepare();
    auto piece = [&](uint32_t i, int) {
      if (!kernels.blendshapes(i * SKIN_PIECE, std::min(count, (int64_t)(i + 1) * SKIN_PIECE), groups, parts, base, part,
                               basis, coefficients, gains, points, colors, scales))
        sound = false;
    };
    e.pool->for_each(skin_pieces(count), piece);
  });
  return sound ? code : -2;
}

GV_API int32_t gv_upsample(int64_t count, int32_t slots, int32_t rows, const float* base, const int32_t* index,
                           const float* weight, const float* table, float* points, float* colors, float* scales) {
  std::atomic<bool> sound{true};
  int32_t code = guarded([&](Engine& e) {
    const Kernels& kernels = e.kernels();
    e.prepare();
    auto piece = [&](uint32_t i, int) {
      if (!kernels.upsample(i * SKIN_PIECE, std::min(count, (int64_t)(i + 1) * SKIN_PIECE), slots, rows, base, index,
                            weight, table, points, colors, scales))
        sound = false;
    };
    e.pool->for_each(skin_pieces(count), piece);
  });
  return sound ? code : -2;
}

GV_API int32_t gv_skin_backward(int64_t count, int32_t slots, int32_t joints, int32_t stride, const float* points,
                                const int32_t* index, const float* weight, const float* transforms,
                                const float* grad_out, float* grad_points, float* grad_transforms) {
  std::atomic<bool> sound{true};
  int32_t code = guarded([&](Engine& e) {
    const Kernels& kernels = e.kernels();
    e.prepare();
    uint32_t pieces = skin_pieces(count);
    size_t size = (size_t)joints * stride;
    // a sum for each piece, added up in order: the same result whatever the number of threads
    Buffer<float> sums;
    float* partial = grad_transforms ? sums.reserve(size * pieces) : nullptr;
    if (partial) std::memset(partial, 0, size * pieces * sizeof(float));
    auto piece = [&](uint32_t i, int) {
      if (!kernels.skin_backward(i * SKIN_PIECE, std::min(count, (int64_t)(i + 1) * SKIN_PIECE), slots, joints, stride,
                                 points, index, weight, transforms, grad_out, grad_points,
                                 partial ? partial + size * i : nullptr))
        sound = false;
    };
    e.pool->for_each(pieces, piece);
    if (!grad_transforms) return;
    std::memset(grad_transforms, 0, size * sizeof(float));
    for (uint32_t i = 0; i < pieces; i++)
      for (size_t k = 0; k < size; k++) grad_transforms[k] += partial[size * i + k];
  });
  return sound ? code : -2;
}

GV_API int32_t gv_ssim(int64_t planes, int32_t height, int32_t width, int32_t taps_y, int32_t taps_x,
                       const float* column, const float* line, const float* x, const float* y, double* values,
                       float* gradients) {
  if (taps_y < 1 || taps_x < 1 || taps_y > 11 || taps_x > 11 || taps_y > height || taps_x > width) return -2;
  return guarded([&](Engine& e) {
    const Kernels& kernels = e.kernels();
    e.prepare();
    size_t floats = kernels.ssim_scratch_floats(width, taps_x, taps_y), pixels = (size_t)height * width;
    Buffer<float> scratch;
    scratch.reserve(floats * e.pool->size());
    auto plane = [&](uint32_t i, int thread) {
      kernels.ssim_plane(height, width, taps_y, taps_x, column, line, x + pixels * i, y + pixels * i, values + i,
                         gradients ? gradients + pixels * i : nullptr, scratch.data() + floats * thread);
    };
    e.pool->for_each((uint32_t)planes, plane);
  });
}

GV_API int32_t gv_sparse_product(int64_t count, int32_t channels, int32_t rows, const int32_t* offset,
                                 const int32_t* index, const float* weight, const float* table, float* out) {
  std::atomic<bool> sound{true};
  int32_t code = guarded([&](Engine& e) {
    const Kernels& kernels = e.kernels();
    e.prepare();
    constexpr int64_t PIECE = 1024;
    auto piece = [&](uint32_t i, int) {
      if (!kernels.sparse_product(i * PIECE, std::min(count, (int64_t)(i + 1) * PIECE), channels, rows, offset, index,
                                  weight, table, out))
        sound = false;
    };
    e.pool->for_each((uint32_t)((count + PIECE - 1) / PIECE), piece);
  });
  return sound ? code : -2;
}
