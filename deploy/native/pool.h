// A small pool of threads for short jobs.
//
// A job is `count` tasks; whoever is free takes the next one, the calling thread too, so that a
// worker that wakes late (another pool has the core) costs nothing: the caller never waits for a
// thread, only for tasks already begun. Workers look for a new job for SPIN_SECONDS and then sleep.
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>

namespace gv {

class Pool {
 public:
  // `task(context, index, thread)` for every index below `count`; thread is below size(). Not
  // reentrant.
  typedef void (*Task)(void* context, uint32_t index, int thread);
  void run(uint32_t count, Task task, void* context);

  template <class F>
  void for_each(uint32_t count, F& body) {
    auto call = [](void* f, uint32_t i, int thread) { (*static_cast<F*>(f))(i, thread); };
    run(count, call, &body);
  }

  int size() const { return size_; }
  void resize(int threads);  // 0: available_cores()
  static int available_cores();

 private:
  static constexpr double SPIN_SECONDS = 30e-6;
  void work(int thread, uint32_t generation);
  bool take(uint64_t epoch, int thread);

  int size_ = 0;
  int started_ = 0;                      // workers that exist, numbered from 1
  std::atomic<uint32_t> generation_{0};  // a worker of an older generation ends
  // The job's number (high half) and its next task (low half) in one word, so that a worker that
  // comes late can never take a task of a later job for one of the job that it saw.
  std::atomic<uint64_t> ticket_{0};
  std::atomic<uint32_t> count_{0}, done_{0};
  std::atomic<Task> task_{nullptr};
  std::atomic<void*> context_{nullptr};
  std::atomic<int> sleeping_{0};
  std::mutex mutex_;
  std::condition_variable wake_;
};

}  // namespace gv
