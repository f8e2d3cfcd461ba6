// The C interface of gavatar's native kernel:
//
// - exact Gaussian splatting, forward and backward (gv_forward, gv_backward), by the rule of
//   gavatar_runtime/splatting_rule.py, and a frame (gv_frame_*) that holds what is kept from one to
//   the other;
// - linear blend skinning with its gradients, and attributes of Gaussians from blendshapes or by
//   upsampling;
// - SSIM with its gradient, and sparse products, for training;
// - resizing of images, and JPEG files of them;
// - which instruction set and how many threads do the work (gv_isa*, gv_threads).
//
// Arrays lie in host memory, C-contiguous, float32 where no other type is named. What is written
// must not overlap what is read.
// Calls from several threads are safe: those that share the pool of worker threads take turns, and
// gv_resize and gv_resize8 use no pool. A frame is one thread's at a time.
// Functions that can fail return GV_DONE, GV_OUT_OF_MEMORY, or GV_OUT_OF_RANGE for an index or a
// size; what they write is of no use unless GV_DONE.
//
// gavatar_runtime/native_library.py mirrors this file: GV_ABI_VERSION changes with what is declared
// here, and the sizes of the structs are compared when it loads the library.
#pragma once
#include <stdint.h>

#if defined(_WIN32)
#define GV_API extern "C" __declspec(dllexport)
#elif defined(__GNUC__)
#define GV_API extern "C" __attribute__((visibility("default")))
#else
#define GV_API extern "C"
#endif

#define GV_ABI_VERSION 5

enum { GV_DONE = 0, GV_OUT_OF_MEMORY = -1, GV_OUT_OF_RANGE = -2 };

struct GvGaussians {
  int64_t count;
  const float* means;        // (N, 3) metres, world
  const float* scales;       // (N,) or (N, 3) metres
  const float* colors;       // (N, 3)
  const float* opacities;    // (N,) or null for 1
  const float* quaternions;  // (N, 4) wxyz or null for the identity
  const float* normals;      // (N, 3) unit, world, or null; only read for `backface`
  int32_t scale_columns;     // 1 or 3
};

struct GvCamera {
  double rotation[9], translation[3];  // world to camera, row-major
  double fx, fy, cx, cy;               // pixels
  int32_t width, height;
};

struct GvOptions {
  float background[3];
  float transmittance_stop;  // the rule's TRANSMITTANCE_STOP
  float block_stop;          // a 4x4 block ends once no pixel lets more through; only with `fast`
  int32_t keep;              // 1: keep in the frame what gv_backward needs
  // 1: block_stop, and a cubic exponential (relative error 7.5e-5 instead of 1.6e-7)
  int32_t fast;
  // 1: opacities times sqrt(det S / det (S + low-pass)), so that the low-pass adds no light
  int32_t antialiased;
  // above 0: Gaussians whose normal makes a cosine below -backface with the view are left out
  float backface;
  // above 0, metres: what is so far behind the nearest Gaussian of its tile is left out
  float depth_cut;
};

struct GvImages {
  float* color;     // (H, W, 3), may be null
  float* alpha;     // (H, W), may be null
  float* depth;     // (H, W), may be null: then it is not computed
  uint8_t* color8;  // (H, W, 3) rounded to 0..255, may be null
};

struct GvReport {
  int64_t dropped;         // non-finite field or negative scale
  int64_t visible;         // reach at least one pixel
  int64_t entries;         // (Gaussian, tile) pairs
  int64_t blended;         // of those, the ones not behind opaque pixels
  double project_s;        // wall seconds of projection
  double sort_s, blend_s;  // of sorting and blending, the mean of the threads
};

// What is written, zero for Gaussians without influence; null: not wanted (means never null).
struct GvGradients {
  float* means;
  float* scales;
  float* colors;
  float* opacities;
  float* quaternions;
};

struct GvBackwardReport {
  double blend_s, project_s;
};

struct GvFrame;  // what a forward leaves for its backward, and buffers that the next forward reuses

GV_API int32_t gv_abi_version(void);
GV_API const char* gv_compiler(void);
// sizeof a struct of this file; -1 for another name.
GV_API int64_t gv_struct_size(const char* name);
// A constant of splatting_rule.py as it was compiled in; NaN for another name.
GV_API double gv_rule(const char* name);

// Instruction sets: index 0 is the baseline. `gv_isa_count` are compiled in, `gv_isa_supported` run
// on this processor.
GV_API int32_t gv_isa_count(void);
GV_API const char* gv_isa_name(int32_t isa);
GV_API int32_t gv_isa_supported(int32_t isa);
GV_API int32_t gv_isa(void);
// -1: the best one; returns what is used now: 0 where `isa` cannot be.
GV_API int32_t gv_set_isa(int32_t isa);

GV_API int32_t gv_threads(void);
GV_API void gv_set_threads(int32_t threads);  // 0: the cores this process may use

GV_API GvFrame* gv_frame_new(void);  // null when memory ran out
GV_API void gv_frame_free(GvFrame*);
GV_API int64_t gv_frame_bytes(const GvFrame*);
GV_API int32_t gv_forward(GvFrame*, const GvGaussians*, const GvCamera*, const GvOptions*,
                          const GvImages*, GvReport*);
// After a forward of this frame with `keep` and the same Gaussians, camera and options. `images`
// are the forward's outputs, `upstream` dL/d(images) (color, alpha, depth; null where zero).
// normals and color8 are not read.
GV_API int32_t gv_backward(GvFrame*, const GvGaussians*, const GvCamera*, const GvOptions*,
                           const GvImages* images, const GvImages* upstream, const GvGradients*,
                           GvBackwardReport*);

// Skinning: out_n = sum_k weight[n, k] (A[index[n, k]] applied to point n). A: (J, 3, 4) with
// `stride` floats a joint (12, or 16 for (J, 4, 4)). Indices outside [0, joints) fail.
GV_API int32_t gv_skin(int64_t count, int32_t slots, int32_t joints, int32_t stride,
                       const float* points, const int32_t* index, const float* weight,
                       const float* transforms, float* out);
// Gradients of gv_skin; `grad_transforms` (J, stride) is overwritten; either gradient may be null.
GV_API int32_t gv_skin_backward(int64_t count, int32_t slots, int32_t joints, int32_t stride,
                                const float* points, const int32_t* index, const float* weight,
                                const float* transforms, const float* grad_out, float* grad_points,
                                float* grad_transforms);

// Attributes of N Gaussians as base (N, 8: x y z r g b scale 0) + residual, colours clipped to
// [0, 1] and scales to 0 and up.
// Blendshapes, by body part: the residual is gains[part] * sum_k coefficients[part, k] basis[n, k].
// basis: (N, groups, 8, 4), basis k of channel c at [n, k / 4, c, k % 4]; coefficients:
// (parts, 4 groups); gains: (parts, 8). A part outside [0, parts) fails.
GV_API int32_t gv_blendshapes(int64_t count, int32_t groups, int32_t parts, const float* base,
                              const uint8_t* part, const int8_t* basis, const float* coefficients,
                              const float* gains, float* points, float* colors, float* scales);
// Upsampling: the residual is sum_k weight[n, k] table[index[n, k]]. table: (rows, 8). Indices
// outside [0, rows) fail.
GV_API int32_t gv_upsample(int64_t count, int32_t slots, int32_t rows, const float* base,
                           const int32_t* index, const float* weight, const float* table,
                           float* points, float* colors, float* scales);

// SSIM (Wang et al. 2004) of planes (P, H, W) with a separable, symmetric window of up to 11 x 11
// weights, `column` (taps_y,) by `line` (taps_x,), K1 = 0.01, K2 = 0.03 and range 1: values (P,)
// the mean over the positions where the window fits, gradients (P, H, W) of each value by its plane
// of x, or null. H >= taps_y and W >= taps_x.
GV_API int32_t gv_ssim(int64_t planes, int32_t height, int32_t width, int32_t taps_y,
                       int32_t taps_x, const float* column, const float* line, const float* x,
                       const float* y, double* values, float* gradients);
// A sparse matrix times a table (rows, channels): out (N, channels). Row n of the matrix has
// `weight` in the columns `index` from offset[n] to offset[n + 1]; offset: (N + 1,). Indices
// outside [0, rows) fail.
GV_API int32_t gv_sparse_product(int64_t count, int32_t channels, int32_t rows,
                                 const int32_t* offset, const int32_t* index, const float* weight,
                                 const float* table, float* out);
// An image (H, W) or (H, W, 3) at another size, linearly, as cv2.resize does it; of bytes: rounded.
// channels: 1 or 3.
GV_API int32_t gv_resize(int32_t height, int32_t width, int32_t channels, const float* image,
                         int32_t new_height, int32_t new_width, float* out);
GV_API int32_t gv_resize8(int32_t height, int32_t width, int32_t channels, const uint8_t* image,
                          int32_t new_height, int32_t new_width, uint8_t* out);
// An image (H, W, 3) as a JPEG file, baseline, 4:4:4, with a quality from 1 to 100. `out` has room
// for gv_jpeg_most bytes. Both return a number of bytes, or what functions that can fail return.
GV_API int64_t gv_jpeg_most(int32_t height, int32_t width);
GV_API int64_t gv_jpeg(int32_t height, int32_t width, const uint8_t* pixels, int32_t quality,
                       uint8_t* out);
