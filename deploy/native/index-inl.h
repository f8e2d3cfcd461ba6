// Indices are looked at a few points ahead of their use, while they are in the cache anyway.
#pragma once
#include <stdint.h>

#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// Whether all indices are in [0, size).
GV_INLINE bool in_range(const int32_t* index, int64_t count, int32_t size) {
  uint32_t outside = 0;  // a negative index is a large number without its sign
  for (int64_t i = 0; i < count; i++) outside |= (uint32_t)index[i] >= (uint32_t)size;
  return !outside;
}

}  // namespace gv::GV_NAMESPACE
