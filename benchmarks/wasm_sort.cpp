// The page's sort (deploy/web/sorter.js) and the kernel's skinning as WebAssembly with SIMD, for wasm_sort.mjs.
#define GV_NAMESPACE wasm
#include "skin-inl.h"

extern "C" {
unsigned char __heap_base;
static uint32_t top = 0;
__attribute__((export_name("take"))) void* take(uint32_t bytes) {
  if (!top) top = (uint32_t)(uintptr_t)&__heap_base;
  top = (top + 63) & ~63u;
  uint32_t at = top;
  top += bytes;
  uint32_t pages = (top + 65535) >> 16, have = __builtin_wasm_memory_size(0);
  if (pages > have) __builtin_wasm_memory_grow(0, pages - have);
  return (void*)(uintptr_t)at;
}
__attribute__((export_name("skin"))) int skin_points(int n, int joints, const float* points, const int32_t* index,
                                                     const float* weight, const float* columns, float* out) {
  return gv::wasm::skin(0, n, 4, joints, points, index, weight, columns, out);
}
// rows: (J, 4). joints, weights: (N, 4) bytes. Returns how many lie before `near`.
__attribute__((export_name("sort"))) int sort(int n, const float* points, const uint8_t* joints,
                                              const uint8_t* weights, const float* rows, float near, float* depth,
                                              uint16_t* keys, uint32_t* starts, uint32_t* order) {
  using gv::wasm::Four;
  using gv::wasm::load4;
  float low = 1e30f, high = -1e30f;
  int seen = 0;
  for (int i = 0; i < n; i++) {
    const uint8_t *j = joints + 4 * i, *w = weights + 4 * i;
    Four sum = load4(rows + 4 * j[0]) * (float)w[0] + load4(rows + 4 * j[1]) * (float)w[1] +
               (load4(rows + 4 * j[2]) * (float)w[2] + load4(rows + 4 * j[3]) * (float)w[3]);
    const float* p = points + 3 * i;
    float d = (sum[0] * p[0] + sum[1] * p[1] + (sum[2] * p[2] + sum[3])) * (1 / 255.0f);
    depth[i] = d;
    bool in = d > near;
    seen += in;
    float a = in ? d : low, b = in ? d : high;
    low = a < low ? a : low;
    high = b > high ? b : high;
  }
  float scale = high > low ? 65535 / (high - low) : 0;
  __builtin_memset(starts, 0, 4 * 65537);
  for (int i = 0; i < n; i++) {
    if (!(depth[i] > near)) continue;
    int key = (int)((high - depth[i]) * scale);
    keys[i] = (uint16_t)key;
    starts[key + 1]++;
  }
  for (int k = 0; k < 65536; k++) starts[k + 1] += starts[k];
  for (int i = n - 1; i >= 0; i--)
    if (depth[i] > near) order[starts[keys[i]]++] = (uint32_t)i;
  return seen;
}
}
