#include "pool.h"

#include <chrono>
#include <system_error>
#include <thread>
#if defined(__linux__)
#include <sched.h>
#endif

namespace gv {
namespace {
inline void relax() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

inline double seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

constexpr uint64_t JOB = 1ull << 32;
}  // namespace

int Pool::available_cores() {
#if defined(__linux__)
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof set, &set) == 0 && CPU_COUNT(&set) > 0) return CPU_COUNT(&set);
#endif
  int n = (int)std::thread::hardware_concurrency();
  return n > 0 ? n : 1;
}

void Pool::resize(int threads) {
  if (threads <= 0) threads = available_cores();
  if (threads > 256) threads = 256;
  if (threads == size_) return;
  {
    std::lock_guard<std::mutex> lock(mutex_);
    size_ = threads;
    generation_++;
    started_ = 0;
  }
  wake_.notify_all();
}

bool Pool::take(uint64_t epoch, int thread) {
  uint64_t ticket = ticket_.load(std::memory_order_acquire);
  for (;;) {
    if ((ticket & ~(JOB - 1)) != epoch ||
        (uint32_t)ticket >= count_.load(std::memory_order_relaxed))
      return false;
    Task task = task_.load(std::memory_order_relaxed);
    void* context = context_.load(std::memory_order_relaxed);
    // Success means that the job was still open, hence that count, task and context above were its
    // own.
    if (ticket_.compare_exchange_weak(ticket, ticket + 1, std::memory_order_acq_rel)) {
      task(context, (uint32_t)ticket, thread);
      done_.fetch_add(1, std::memory_order_release);
      return true;
    }
  }
}

void Pool::work(int thread, uint32_t generation) {
  uint64_t seen = ticket_.load(std::memory_order_acquire) & ~(JOB - 1);
  seen -= JOB;  // the job at hand may be taken
  for (;;) {
    double until = seconds() + SPIN_SECONDS;
    uint64_t epoch;
    for (;;) {
      epoch = ticket_.load(std::memory_order_acquire) & ~(JOB - 1);
      // after the ticket: a job published by a resized pool must not be taken under an old thread
      // number
      if (generation_.load(std::memory_order_acquire) != generation) return;
      if (epoch != seen) break;
      if (seconds() > until) {
        std::unique_lock<std::mutex> lock(mutex_);
        sleeping_.fetch_add(1);
        wake_.wait(lock, [&] {
          return (ticket_.load() & ~(JOB - 1)) != seen || generation_.load() != generation;
        });
        sleeping_.fetch_sub(1);
        continue;
      }
      for (int i = 0; i < 16; i++) relax();
    }
    while (take(epoch, thread)) {}
    seen = epoch;
  }
}

void Pool::run(uint32_t count, Task task, void* context) {
  if (!count) return;
  if (!size_) resize(0);
  if (count == 1 || size_ == 1) {
    for (uint32_t i = 0; i < count; i++) task(context, i, 0);
    return;
  }
  while (started_ < size_ - 1) {
    try {
      std::thread(&Pool::work, this, started_ + 1, generation_.load()).detach();
      started_++;
    } catch (const std::system_error&) {  // no more threads to be had: fewer will do
      break;
    }
  }
  // Close the former job before count, task and context change: a late worker's compare-exchange
  // then fails.
  uint64_t epoch = (ticket_.load() & ~(JOB - 1)) + JOB;
  ticket_.store(epoch | (JOB - 1), std::memory_order_seq_cst);
  count_.store(count, std::memory_order_relaxed);
  task_.store(task, std::memory_order_relaxed);
  context_.store(context, std::memory_order_relaxed);
  done_.store(0, std::memory_order_relaxed);
  epoch += JOB;
  {
    // under the lock, so that no worker falls asleep between its look at the ticket and its wait
    std::lock_guard<std::mutex> lock(mutex_);
    ticket_.store(epoch, std::memory_order_seq_cst);
  }
  if (sleeping_.load() > 0) wake_.notify_all();
  while (take(epoch, 0)) {}
  // Tasks begun elsewhere are short; a worker that lost its core is worth giving ours to.
  for (int spins = 0; done_.load(std::memory_order_acquire) != count; spins++) {
    if (spins < 2000) relax();
    else std::this_thread::yield();
  }
}

}  // namespace gv
