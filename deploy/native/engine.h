// What the process has one of: the threads, their memory and the instruction set in use.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <new>
#include <vector>

#include "buffer.h"
#include "kernels.h"
#include "pool.h"
#include "thread_bins.h"

namespace gv {

// What one thread works with.
struct Worker {
  ThreadBins bins;
  Buffer<Entry> sort_room;
  Buffer<char> scratch;
  double sort_s = 0, blend_s = 0;
};

struct Engine {
  std::mutex mutex;       // held by every call that uses the engine
  Pool* pool = new Pool;  // never destroyed: its threads may outlive static destruction
  std::vector<Worker*> workers;
  int isa = -1;         // of INSTRUCTION_SETS; below 0 before the first use
  uint64_t frames = 0;  // drawn so far
  Buffer<Sums> sums, tile_sums;
  Buffer<MoreSums> more, tile_more;

  const Kernels& kernels();  // of the instruction set in use
  int choose(int wanted);    // the instruction set in use from now on; the best one below 0
  void prepare();            // threads, and a worker for each
};

Engine& engine();

double clock_seconds();

// `body(engine)`, one call at a time, and its code; GV_OUT_OF_MEMORY where memory ran out.
template <class F>
int32_t guarded(F body) {
  Engine& e = engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  try {
    e.prepare();
    return body(e);
  } catch (const std::bad_alloc&) {
    return GV_OUT_OF_MEMORY;
  }
}

// `body(i, thread)` by the pool for every i below `count`. It may throw std::bad_alloc, and so does
// this function then: an exception must not leave a worker thread.
template <class F>
void for_each_task(Engine& e, uint32_t count, F body) {
  std::atomic<bool> failed{false};
  auto task = [&](uint32_t i, int thread) {
    try {
      body(i, thread);
    } catch (const std::bad_alloc&) {
      failed = true;
    }
  };
  e.pool->for_each(count, task);
  if (failed) throw std::bad_alloc();
}

inline uint32_t pieces_of(int64_t count, int64_t size) {
  return (uint32_t)((count + size - 1) / size);
}

// `body(begin, end)` by the pool for pieces of [0, count) of `size` each; GV_OUT_OF_RANGE if it is
// false for one of them.
template <class F>
int32_t for_each_piece(Engine& e, int64_t count, int64_t size, F body) {
  std::atomic<bool> sound{true};
  auto task = [&](uint32_t i, int) {
    if (!body(i * size, std::min(count, (i + 1) * size))) sound = false;
  };
  e.pool->for_each(pieces_of(count, size), task);
  return sound ? GV_DONE : GV_OUT_OF_RANGE;
}

}  // namespace gv
