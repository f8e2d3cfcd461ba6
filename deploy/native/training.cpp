// What training alone asks for: SSIM with its gradient, and sparse products.
#include <cstdint>

#include "engine.h"

GV_API int32_t gv_ssim(int64_t planes, int32_t height, int32_t width, int32_t taps_y,
                       int32_t taps_x, const float* column, const float* line, const float* x,
                       const float* y, double* values, float* gradients) {
  using gv::SSIM_TAPS;
  if (taps_y < 1 || taps_y > SSIM_TAPS || taps_y > height) return GV_OUT_OF_RANGE;
  if (taps_x < 1 || taps_x > SSIM_TAPS || taps_x > width) return GV_OUT_OF_RANGE;
  return gv::guarded([&](gv::Engine& engine) {
    const gv::Kernels& kernels = engine.kernels();
    const size_t pixels = (size_t)height * width;
    const size_t floats = kernels.ssim_scratch_floats(width, taps_x, taps_y);  // a thread
    gv::Buffer<float> scratch;
    scratch.reserve(floats * engine.pool->size());
    gv::for_each_task(engine, (uint32_t)planes, [&](uint32_t i, int thread) {
      kernels.ssim_plane(height, width, taps_y, taps_x, column, line, x + pixels * i,
                         y + pixels * i, values + i, gradients ? gradients + pixels * i : nullptr,
                         scratch.data() + floats * thread);
    });
    return GV_DONE;
  });
}

GV_API int32_t gv_sparse_product(int64_t count, int32_t channels, int32_t rows,
                                 const int32_t* offset, const int32_t* index, const float* weight,
                                 const float* table, float* out) {
  constexpr int64_t PIECE = 1024;  // rows of the matrix that a thread takes at a time
  return gv::guarded([&](gv::Engine& engine) {
    const gv::Kernels& kernels = engine.kernels();
    return gv::for_each_piece(engine, count, PIECE, [&](int64_t begin, int64_t end) {
      return kernels.sparse_product(begin, end, channels, rows, offset, index, weight, table, out);
    });
  });
}
