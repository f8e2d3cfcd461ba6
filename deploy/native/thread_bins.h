// A thread's entries by tile, in lists of blocks.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

#include "buffer.h"
#include "kernels.h"

namespace gv {

// The blocks come from slabs that are used again by the next frame.
class ThreadBins {
 public:
  Bins bins{};

  ThreadBins() = default;
  ThreadBins(const ThreadBins&) = delete;
  ThreadBins& operator=(const ThreadBins&) = delete;
  ~ThreadBins() {
    for (EntryBlock* slab : slabs_) ::operator delete(slab, ALIGNMENT);
  }

  bool holds(uint64_t frame) const { return frame_ == frame; }
  void begin(uint64_t frame, size_t tiles) {
    frame_ = frame;
    used_ = 0;
    bins.cursors = cursors_.reserve(tiles);
    std::fill_n(bins.cursors, tiles, NO_ENTRIES);
    bins.visible = bins.dropped = 0;
    bins.owner = this;
  }
  // An empty block behind `previous`, for Projection::grow. Throws std::bad_alloc.
  static EntryBlock* grow(Bins* bins, EntryBlock* previous) {
    return static_cast<ThreadBins*>(bins->owner)->grow(previous);
  }

 private:
  static constexpr size_t SLAB = 128;  // blocks
  static constexpr std::align_val_t ALIGNMENT{alignof(EntryBlock)};

  EntryBlock* grow(EntryBlock* previous) {
    if (used_ == slabs_.size() * SLAB) {
      void* slab = ::operator new(sizeof(EntryBlock) * SLAB, ALIGNMENT);
      slabs_.push_back(static_cast<EntryBlock*>(slab));
    }
    EntryBlock* block = slabs_[used_ / SLAB] + used_ % SLAB;
    used_++;
    block->first = previous ? previous->first : block;
    block->before = previous ? previous->before + EntryBlock::CAPACITY : 0;
    if (previous) previous->next = block;
    return block;
  }

  Buffer<Entry*> cursors_;
  std::vector<EntryBlock*> slabs_;
  size_t used_ = 0;     // blocks of this frame
  uint64_t frame_ = 0;  // that the bins belong to
};

}  // namespace gv
