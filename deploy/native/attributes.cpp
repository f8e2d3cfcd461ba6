// Attributes of Gaussians for a pose: skinning with its gradients, blendshapes, upsampling.
#include <cstdint>
#include <cstring>
#include <vector>

#include "engine.h"

namespace {
constexpr int64_t PIECE = 8192;  // points that a thread takes at a time
}

GV_API int32_t gv_skin(int64_t count, int32_t slots, int32_t joints, int32_t stride,
                       const float* points, const int32_t* index, const float* weight,
                       const float* transforms, float* out) {
  return gv::guarded([&](gv::Engine& engine) {
    const gv::Kernels& kernels = engine.kernels();
    // the columns of each 3x4 transform, filled up to four floats
    std::vector<float> columns((size_t)joints * 16, 0.f);
    for (int32_t j = 0; j < joints; j++)
      for (int r = 0; r < 3; r++)
        for (int c = 0; c < 4; c++)
          columns[16 * j + 4 * c + r] = transforms[(size_t)stride * j + 4 * r + c];
    return gv::for_each_piece(engine, count, PIECE, [&](int64_t begin, int64_t end) {
      return kernels.skin(begin, end, slots, joints, points, index, weight, columns.data(), out);
    });
  });
}

GV_API int32_t gv_skin_backward(int64_t count, int32_t slots, int32_t joints, int32_t stride,
                                const float* points, const int32_t* index, const float* weight,
                                const float* transforms, const float* grad_out, float* grad_points,
                                float* grad_transforms) {
  return gv::guarded([&](gv::Engine& engine) {
    const gv::Kernels& kernels = engine.kernels();
    const size_t size = (size_t)joints * stride, pieces = gv::pieces_of(count, PIECE);
    // a sum for each piece, added up in order: the same result whatever the number of threads
    std::vector<float> sums(grad_transforms ? size * pieces : 0, 0.f);
    int32_t code = gv::for_each_piece(engine, count, PIECE, [&](int64_t begin, int64_t end) {
      float* sum = grad_transforms ? sums.data() + size * (begin / PIECE) : nullptr;
      return kernels.skin_backward(begin, end, slots, joints, stride, points, index, weight,
                                   transforms, grad_out, grad_points, sum);
    });
    if (code != GV_DONE || !grad_transforms) return code;
    std::memset(grad_transforms, 0, size * sizeof(float));
    for (size_t i = 0; i < pieces; i++)
      for (size_t k = 0; k < size; k++) grad_transforms[k] += sums[size * i + k];
    return code;
  });
}

GV_API int32_t gv_blendshapes(int64_t count, int32_t groups, int32_t parts, const float* base,
                              const uint8_t* part, const int8_t* basis, const float* coefficients,
                              const float* gains, float* points, float* colors, float* scales) {
  return gv::guarded([&](gv::Engine& engine) {
    const gv::Kernels& kernels = engine.kernels();
    return gv::for_each_piece(engine, count, PIECE, [&](int64_t begin, int64_t end) {
      return kernels.blendshapes(begin, end, groups, parts, base, part, basis, coefficients, gains,
                                 points, colors, scales);
    });
  });
}

GV_API int32_t gv_upsample(int64_t count, int32_t slots, int32_t rows, const float* base,
                           const int32_t* index, const float* weight, const float* table,
                           float* points, float* colors, float* scales) {
  return gv::guarded([&](gv::Engine& engine) {
    const gv::Kernels& kernels = engine.kernels();
    return gv::for_each_piece(engine, count, PIECE, [&](int64_t begin, int64_t end) {
      return kernels.upsample(begin, end, slots, rows, base, index, weight, table, points, colors,
                              scales);
    });
  });
}
