// Images at another size, linearly, pixel centres at +0.5 and borders repeated: what cv2.resize
// calls INTER_LINEAR.
#include <algorithm>
#include <cmath>
#include <new>
#include <vector>

#include "gavatar_native.h"

namespace {

// Where each output pixel of one axis lies between two input pixels.
struct Axis {
  std::vector<int32_t> first, second;
  std::vector<float> weight;  // of the second
  Axis(int32_t from, int32_t to) : first(to), second(to), weight(to) {
    for (int32_t i = 0; i < to; i++) {
      double at = std::min(std::max((i + 0.5) * from / to - 0.5, 0.0), from - 1.0);
      first[i] = (int32_t)at;
      second[i] = std::min(first[i] + 1, from - 1);
      weight[i] = (float)(at - first[i]);
    }
  }
};

void put(const float* row, int64_t count, float* to) { std::copy_n(row, count, to); }
void put(const float* row, int64_t count, uint8_t* to) {
  // rounded; a mean of bytes is within their range
  for (int64_t i = 0; i < count; i++) to[i] = (uint8_t)(int32_t)(row[i] + 0.5f);
}

template <int CHANNELS, class T>
void resize(int32_t height, int32_t width, const T* image, int32_t new_height, int32_t new_width,
            T* out) {
  Axis rows(height, new_height), columns(width, new_width);
  int64_t across = (int64_t)width * CHANNELS, new_across = (int64_t)new_width * CHANNELS;
  std::vector<float> line(across), row(new_across);
  for (int32_t y = 0; y < new_height; y++) {
    const T *above = image + rows.first[y] * across, *below = image + rows.second[y] * across;
    float weight = rows.weight[y];
    for (int64_t i = 0; i < across; i++)
      line[i] = above[i] + weight * ((float)below[i] - (float)above[i]);
    float* to = row.data();
    for (int32_t x = 0; x < new_width; x++, to += CHANNELS) {
      const float* left = &line[columns.first[x] * CHANNELS];
      const float* right = &line[columns.second[x] * CHANNELS];
      for (int c = 0; c < CHANNELS; c++) to[c] = left[c] + columns.weight[x] * (right[c] - left[c]);
    }
    put(row.data(), new_across, out + y * new_across);
  }
}

template <class T>
int32_t resized(int32_t height, int32_t width, int32_t channels, const T* image, int32_t new_height,
                int32_t new_width, T* out) {
  if (std::min({height, width, new_height, new_width}) < 1 || (channels != 1 && channels != 3))
    return GV_OUT_OF_RANGE;
  try {
    (channels == 3 ? resize<3, T> : resize<1, T>)(height, width, image, new_height, new_width, out);
    return GV_DONE;
  } catch (const std::bad_alloc&) {
    return GV_OUT_OF_MEMORY;
  }
}

}  // namespace

GV_API int32_t gv_resize(int32_t height, int32_t width, int32_t channels, const float* image,
                         int32_t new_height, int32_t new_width, float* out) {
  return resized(height, width, channels, image, new_height, new_width, out);
}

GV_API int32_t gv_resize8(int32_t height, int32_t width, int32_t channels, const uint8_t* image,
                          int32_t new_height, int32_t new_width, uint8_t* out) {
  return resized(height, width, channels, image, new_height, new_width, out);
}
