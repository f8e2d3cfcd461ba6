// A frame: what a backward needs of its forward, and buffers that the next forward reuses.
#pragma once
#include <cstdint>
#include <vector>

#include "buffer.h"
#include "kernels.h"

namespace gv {

// Everything of a projection but where records and lifts are.
Projection make_projection(const GvGaussians&, const GvCamera&, const GvOptions&);

}  // namespace gv

// Tiles are blended by any thread in any order; each has its own place in the kept arrays, so that
// nothing depends on which thread did it and results are the same to the last bit.
struct GvFrame {
  gv::Buffer<gv::Record> records;
  gv::Buffer<float> lift;
  gv::Buffer<uint32_t> kept_index;
  gv::Buffer<uint64_t> kept_blocks;
  gv::Buffer<float> kept_depth;
  std::vector<gv::Kept> kept;
  std::vector<uint32_t> counts;  // entries of each tile
  std::vector<uint32_t> order;   // tiles that have any, those with most entries first
  bool has_opacity = false;      // `lift` is in use

  int64_t bytes() const;
};
