#include "frame.h"

#include <cstring>
#include <new>

#include "thread_bins.h"

namespace gv {
namespace {

// Depths, indices and ranges of blocks share the 64 bits of an entry: 32 for the depth, and what
// the index leaves of the rest for the range, of which `granularity` bits a number are given up.
int32_t granularity_for(int64_t count) {
  int32_t granularity = 0;
  while (granularity < 3 && count > (1ll << (32 - 4 * (3 - granularity)))) granularity++;
  return granularity;
}

// The blocks of each range of columns and of rows.
void fill_ranges(Projection& p) {
  const int g = p.granularity, b = 3 - g;  // a block's number loses g bits and keeps b
  for (uint32_t code = 0; code < 1u << 2 * b; code++) {
    uint32_t first = (code & ((1u << b) - 1)) << g, last = ((code >> b) << g) + (1u << g) - 1;
    p.columns[code] = p.rows[code] = 0;
    for (uint32_t i = first; i <= last; i++) {
      p.columns[code] |= 0x0101010101010101ull << i;  // bit i of every row of eight
      p.rows[code] |= 0xffull << 8 * i;
    }
  }
}

}  // namespace

Projection make_projection(const GvGaussians& gaussians, const GvCamera& camera,
                           const GvOptions& options) {
  Projection p{};
  p.gaussians = gaussians;
  std::memcpy(p.rotation, camera.rotation, sizeof p.rotation);
  std::memcpy(p.translation, camera.translation, sizeof p.translation);
  for (int i = 0; i < 9; i++) p.rotation_f[i] = (float)camera.rotation[i];
  p.fx = (float)camera.fx, p.fy = (float)camera.fy, p.cx = (float)camera.cx,
  p.cy = (float)camera.cy;
  p.width = camera.width, p.height = camera.height;
  for (int i = 0; i < 3; i++) {  // the camera's centre is -R^T t
    double eye = 0;
    for (int k = 0; k < 3; k++) eye -= camera.rotation[3 * k + i] * camera.translation[k];
    p.eye[i] = (float)eye;
  }
  p.backface = gaussians.normals ? options.backface : 0;
  p.antialiased = options.antialiased != 0;
  double wide = FRUSTUM_MARGIN * 0.5 * camera.width / camera.fx;
  double tall = FRUSTUM_MARGIN * 0.5 * camera.height / camera.fy;
  p.x_low = (float)(-camera.cx / camera.fx - wide);
  p.x_high = (float)((camera.width - camera.cx) / camera.fx + wide);
  p.y_low = (float)(-camera.cy / camera.fy - tall);
  p.y_high = (float)((camera.height - camera.cy) / camera.fy + tall);
  p.tiles_x = (camera.width + TILE - 1) / TILE;
  p.tiles_y = (camera.height + TILE - 1) / TILE;
  p.granularity = granularity_for(gaussians.count);
  fill_ranges(p);
  p.grow = ThreadBins::grow;
  return p;
}

}  // namespace gv

int64_t GvFrame::bytes() const {
  size_t buffers = records.bytes() + lift.bytes() + kept_index.bytes() + kept_blocks.bytes() +
                   kept_depth.bytes();
  size_t tiles = kept.capacity() * sizeof(gv::Kept) + (counts.capacity() + order.capacity()) * 4;
  return (int64_t)(buffers + tiles);
}

GV_API GvFrame* gv_frame_new(void) { return new (std::nothrow) GvFrame; }
GV_API void gv_frame_free(GvFrame* frame) { delete frame; }
GV_API int64_t gv_frame_bytes(const GvFrame* frame) { return frame->bytes(); }
