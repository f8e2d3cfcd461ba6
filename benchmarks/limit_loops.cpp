// Stripped loops that benchmarks/kernel_limit.py times: what the stages of the kernel would cost without lists, tiles
// and bookkeeping. One thread; built with -march=native. Not part of any package.
#include <cstdint>
#include <cstring>
#include <ctime>
#include <vector>

typedef float V __attribute__((vector_size(64)));
typedef int32_t I __attribute__((vector_size(64)));

namespace {
// Processor time: other work on the machine does not count.
double now() { return (double)std::clock() / CLOCKS_PER_SEC; }
V splat(float x) { return V{} + x; }
}  // namespace

// Multiply-adds of 16 floats a second: twelve chains that wait for nothing but themselves.
extern "C" double limit_multiply_adds(int64_t turns) {
  V chain[12];
  for (int k = 0; k < 12; k++) chain[k] = splat(0.001f * (float)k);
  const V a = splat(0.999f), b = splat(1e-3f);
  double start = now();
  for (int64_t i = 0; i < turns; i++) {
    for (int k = 0; k < 12; k++) chain[k] = chain[k] * a + b;
    for (int k = 0; k < 12; k++) asm volatile("" : "+v"(chain[k]));
  }
  return 12 * (double)turns / (now() - start);
}

// Seconds to read `count` Gaussians (position, colour, scale) and write records of eight floats, with the arithmetic of
// an isotropic projection and no bins. camera: rotation rows, translation, focal length.
extern "C" double limit_project(int64_t count, const float* means, const float* colors, const float* scales,
                                const float* camera, float* records) {
  constexpr int BATCH = 64;
  alignas(64) float f[8][BATCH];
  double start = now();
  for (int64_t i = 0; i + BATCH <= count; i += BATCH) {
    for (int j = 0; j < BATCH; j++) {
      const float* m = means + 3 * (i + j);
      const float* R = camera;
      float x = R[0] * m[0] + R[1] * m[1] + R[2] * m[2] + R[9];
      float y = R[3] * m[0] + R[4] * m[1] + R[5] * m[2] + R[10];
      float z = R[6] * m[0] + R[7] * m[1] + R[8] * m[2] + R[11];
      float inv = 1.f / z, tx = x * inv, ty = y * inv, s = scales[i + j] * inv * R[12], s2 = s * s;
      float A = s2 * (1 + tx * tx) + 0.3f, B = s2 * tx * ty, C = s2 * (1 + ty * ty) + 0.3f;
      float det = A * C - B * B;
      f[0][j] = R[12] * tx, f[1][j] = R[12] * ty;
      f[2][j] = __builtin_sqrtf(0.72f / A), f[3][j] = __builtin_sqrtf(0.72f * (A / det));
      f[4][j] = -f[3][j] * (B / A);
    }
    for (int j = 0; j < BATCH; j++)
      for (int k = 0; k < 3; k++) f[5 + k][j] = colors[3 * (i + j) + k];
    for (int j = 0; j < BATCH; j++)
      for (int k = 0; k < 8; k++) records[8 * (i + j) + k] = f[k][j];
  }
  return now() - start;
}

// Seconds to put `count` 64-bit entries in order of buckets that are known: one pass that counts, one that moves.
extern "C" double limit_order(int64_t count, const uint64_t* entries, int32_t buckets, uint64_t* out) {
  std::vector<uint32_t> at((size_t)buckets + 1);
  double start = now();
  for (int64_t i = 0; i < count; i++) at[(entries[i] >> 32) + 1]++;
  for (int32_t b = 0; b < buckets; b++) at[b + 1] += at[b];
  for (int64_t i = 0; i < count; i++) out[at[entries[i] >> 32]++] = entries[i];
  return now() - start;
}

// Blends Gaussians that lie ready, block after block, front to back, until all 16 pixels have stopped.
// first: (blocks + 1,) where each block's records begin; records: u and v from the block's corner, then as
// the kernel's. Gives seconds, and through `pairs` the number of Gaussians evaluated.
extern "C" double limit_blend(int64_t blocks, const int64_t* first, const float* records, float* image,
                              int64_t* pairs) {
  V column, row;
  for (int i = 0; i < 16; i++) column[i] = (float)(i & 3), row[i] = (float)(i >> 2);
  int64_t done = 0;
  double start = now();
  for (int64_t block = 0; block < blocks; block++) {
    V T = splat(1), r{}, g{}, b{};
    int64_t i = first[block];
    for (; i < first[block + 1]; i++) {
      const float* s = records + 8 * i;
      V dx = column - s[0], x = dx * s[2], y = (row - s[1]) * s[3] + dx * s[4];
      V e = splat(7.994353f) - x * x - y * y;
      I whole = __builtin_convertvector(e, I);
      V part = e - __builtin_convertvector(whole, V);
      V p = ((((part * 0.00190f + 0.00891f) * part + 0.05588f) * part + 0.24013f) * part + 0.69315f) * part + 1.f;
      V alpha = (V)((I)(p * (1.f / 255)) + (whole << 23));
      alpha = (V)((I)alpha & (e >= 0.f));
      alpha = alpha < 0.99f ? alpha : splat(0.99f);
      V weight = T * alpha;
      T = T - weight;
      r += weight * s[5], g += weight * s[6], b += weight * s[7];
      if (((i - first[block]) & 7) == 7) {
        I open = T > 1e-4f;
        uint64_t any[8];
        memcpy(any, &open, sizeof any);
        if (!(any[0] | any[1] | any[2] | any[3] | any[4] | any[5] | any[6] | any[7])) break;
      }
    }
    done += i - first[block];
    memcpy(image + 48 * block, &r, 64), memcpy(image + 48 * block + 16, &g, 64);
    memcpy(image + 48 * block + 32, &b, 64);
  }
  double seconds = now() - start;
  *pairs = done;
  return seconds;
}
