#include "engine.h"

#include <chrono>

#include "instruction_sets.h"
#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

namespace gv {

const Kernels& Engine::kernels() {
  if (isa < 0) choose(-1);
  return *INSTRUCTION_SETS[isa].kernels;
}

int Engine::choose(int wanted) {
  isa = 0;
  for (int i = 0; i < INSTRUCTION_SET_COUNT; i++)
    if (INSTRUCTION_SETS[i].supported() && (wanted < 0 || i == wanted)) isa = i;
  return isa;
}

void Engine::prepare() {
  if (!pool->size()) pool->resize(0);
  while ((int)workers.size() < pool->size()) workers.push_back(new Worker);
}

namespace {

Engine* make_engine() {
  auto* made = new Engine;
#if defined(__unix__) || defined(__APPLE__)
  static Engine* shared;
  shared = made;
  // A fork copies only the calling thread. The child starts a pool of its own when it first needs
  // one; the parent's threads are not there to be ended, so the copied pool is simply forgotten.
  auto lock = [] { shared->mutex.lock(); };
  auto unlock = [] { shared->mutex.unlock(); };
  auto start_anew = [] {
    int size = shared->pool->size();
    shared->pool = new Pool;
    if (size) shared->pool->resize(size);
    shared->mutex.unlock();
  };
  pthread_atfork(lock, unlock, start_anew);
#endif
  return made;
}

}  // namespace

Engine& engine() {
  static Engine* made = make_engine();
  return *made;
}

double clock_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace gv

namespace {
bool is_isa(int32_t isa) { return isa >= 0 && isa < gv::INSTRUCTION_SET_COUNT; }
}  // namespace

GV_API int32_t gv_isa_count(void) { return gv::INSTRUCTION_SET_COUNT; }

GV_API const char* gv_isa_name(int32_t isa) {
  return is_isa(isa) ? gv::INSTRUCTION_SETS[isa].name : "";
}

GV_API int32_t gv_isa_supported(int32_t isa) {
  return is_isa(isa) && gv::INSTRUCTION_SETS[isa].supported();
}

GV_API int32_t gv_isa(void) {
  gv::Engine& e = gv::engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  e.kernels();
  return e.isa;
}

GV_API int32_t gv_set_isa(int32_t isa) {
  gv::Engine& e = gv::engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  return e.choose(isa);
}

GV_API int32_t gv_threads(void) {
  gv::Engine& e = gv::engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  if (!e.pool->size()) e.pool->resize(0);
  return e.pool->size();
}

GV_API void gv_set_threads(int32_t threads) {
  gv::Engine& e = gv::engine();
  std::lock_guard<std::mutex> lock(e.mutex);
  e.pool->resize(threads);
}
