// From sums over pixels to the gradients of Gaussians, backwards along project-inl.h.
#pragma once
#include <stdint.h>

#include "covariance-inl.h"
#include "kernels.h"
#include "scalars-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// The sums of a batch, a sum after the other: those of Sums in its order, then those of MoreSums.
struct BatchSums {
  alignas(64) float S[8][BATCH], T[2][BATCH];
};

template <bool MORE>
GV_INLINE void load_sums(const Sums* sums, const MoreSums* more, int n, BatchSums& out) {
  int done = 0;
#if GV_LANES == 8
  for (; done + 8 <= n; done += 8) {
    V m[8];
    for (int k = 0; k < 8; k++) m[k] = load(&sums[done + k].v_dx);
    transpose(m);
    for (int k = 0; k < 8; k++) store(&out.S[k][done], m[k]);
  }
#endif
  for (int j = done; j < n; j++) {
    const float* a = &sums[j].v_dx;
    for (int k = 0; k < 8; k++) out.S[k][j] = a[k];
  }
  for (int j = 0; j < n; j++) {
    out.T[0][j] = MORE ? more[j].v : 0.f;
    out.T[1][j] = MORE ? more[j].w_depth : 0.f;
  }
}

// dL/d(A, B, C) of a covariance, of which B stands for both entries off the diagonal.
struct CovarianceGradient {
  float A, B, C;
};
// From the conic's, the inverse covariance [[a, b], [b, d]]: dL/dconic is the symmetric matrix
// [[ga, gb], [gb, gd]], and dL/dcovariance = -conic dL/dconic conic.
GV_INLINE CovarianceGradient covariance_gradient(float a, float b, float d, float ga, float gb,
                                                 float gd) {
  float h00 = a * ga + b * gb, h01 = a * gb + b * gd;  // conic dL/dconic
  float h10 = b * ga + d * gb, h11 = b * gb + d * gd;
  CovarianceGradient g;
  g.A = -(h00 * a + h01 * b);
  g.C = -(h10 * b + h11 * d);
  g.B = -(h00 * b + h01 * d) - (h10 * a + h11 * b);
  return g;
}

// Adds what the compensation of antialiased opacities asks for: dL/dlog(alpha) is `v`, and the log
// of the compensation is (log det S - log det (S + low-pass)) / 2.
GV_INLINE void add_compensation_gradient(const Covariance& cov, float inv_det, float v,
                                         CovarianceGradient& g) {
  float sharp = 1.f / cov.sharp_det, half = 0.5f * v;
  g.A += half * ((cov.C - LOW_PASS) * sharp - cov.C * inv_det);
  g.C += half * ((cov.A - LOW_PASS) * sharp - cov.A * inv_det);
  g.B -= 2 * half * cov.B * (sharp - inv_det);
}

// What a covariance's gradient says of the clamped ratios tx, ty and of the depth.
struct PlaceGradient {
  float tx, ty, z;
};

// Of a sphere. `scale`: dL/dscale.
GV_INLINE PlaceGradient isotropic_gradient(const Projection& p, const CovarianceGradient& g,
                                           float s, float inv_z, float tx, float ty, float* scale) {
  float kx = p.fx * inv_z, ky = p.fy * inv_z;
  float shape = g.A * kx * kx * (1 + tx * tx) + g.C * ky * ky * (1 + ty * ty) +
                g.B * kx * ky * tx * ty;
  *scale = 2 * s * shape;
  PlaceGradient out;
  out.z = -2 * s * s * shape * inv_z;
  out.tx = s * s * (2 * g.A * kx * kx * tx + g.B * kx * ky * ty);
  out.ty = s * s * (2 * g.C * ky * ky * ty + g.B * kx * ky * tx);
  return out;
}

// Of axes W in the camera with the rows m0 and m1 of J W. dW: dL/dW.
GV_INLINE PlaceGradient general_gradient(const Projection& p, const CovarianceGradient& g,
                                         const float W[9], const float m0[3], const float m1[3],
                                         float inv_z, float tx, float ty, float dW[9]) {
  float ax = p.fx * inv_z, ay = p.fy * inv_z, d0[3], d1[3];  // d0, d1: dL/dm0, dL/dm1
  float along = 0, d0W2 = 0, d1W2 = 0;
  for (int k = 0; k < 3; k++) {
    d0[k] = 2 * g.A * m0[k] + g.B * m1[k];
    d1[k] = 2 * g.C * m1[k] + g.B * m0[k];
    along += d0[k] * m0[k] + d1[k] * m1[k];
    d0W2 += d0[k] * W[6 + k];
    d1W2 += d1[k] * W[6 + k];
    dW[k] = ax * d0[k];
    dW[3 + k] = ay * d1[k];
    dW[6 + k] = -(tx * dW[k] + ty * dW[3 + k]);
  }
  PlaceGradient out;
  out.tx = -ax * d0W2;
  out.ty = -ay * d1W2;
  out.z = -along * inv_z;  // m0 and m1 go with 1/z
  return out;
}

// From G = dL/dQ, Q the rotation of q, to dL/dq.
GV_INLINE void quaternion_gradient(const float q[4], const float G[9], float out[4]) {
  float norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  float inverse = norm > 0 ? 1.f / __builtin_sqrtf(norm) : 0.f;
  float w = q[0] * inverse, x = q[1] * inverse, y = q[2] * inverse, z = q[3] * inverse;
  float gw = 2 * (x * (G[7] - G[5]) + y * (G[2] - G[6]) + z * (G[3] - G[1]));
  float gx = 2 *
             (y * (G[1] + G[3]) + z * (G[2] + G[6]) + w * (G[7] - G[5]) - 2 * x * (G[4] + G[8]));
  float gy = 2 *
             (x * (G[1] + G[3]) + z * (G[5] + G[7]) + w * (G[2] - G[6]) - 2 * y * (G[0] + G[8]));
  float gz = 2 *
             (x * (G[2] + G[6]) + y * (G[5] + G[7]) + w * (G[3] - G[1]) - 2 * z * (G[0] + G[4]));
  float radial = gw * w + gx * x + gy * y + gz * z;  // the norm has no influence
  out[0] = (gw - radial * w) * inverse;
  out[1] = (gx - radial * x) * inverse;
  out[2] = (gy - radial * y) * inverse;
  out[3] = (gz - radial * z) * inverse;
}

// Gradients of a batch, a number after the other; x, y and z by the camera point.
struct BatchGradients {
  alignas(64) float x[BATCH], y[BATCH], z[BATCH], scales[3][BATCH], quaternions[4][BATCH];
};

template <bool GENERAL, bool MORE>
GV_INLINE void gradients_of(const Projection& p, const float* scales, const float* quaternions,
                            const CameraPoints& c, const BatchSums& sums, int n,
                            BatchGradients& out) {
  const float* R = p.rotation_f;
  const auto& S = sums.S;
  const auto& T = sums.T;
  for (int j = 0; j < n; j++) {
    bool ahead = c.z[j] > NEAR;
    float inv_z = 1.f / (ahead ? c.z[j] : 1.f);
    float rx = c.x[j] * inv_z, ry = c.y[j] * inv_z;
    float tx = clamp(rx, p.x_low, p.x_high), ty = clamp(ry, p.y_low, p.y_high);
    Covariance cov;
    Axes axes;
    float m0[3], m1[3];
    if (GENERAL) {
      const float identity[4] = {1, 0, 0, 0};
      rotated_axes(p, quaternions ? quaternions + 4 * j : identity, scales + 3 * j, axes);
      cov = general_covariance(p, axes.W, inv_z, tx, ty, m0, m1);
    } else {
      cov = isotropic_covariance(p, scales[j] * inv_z, tx, ty);
    }
    float inv_det = 1.f / cov.det;
    float a = cov.C * inv_det, b = -cov.B * inv_det, d = cov.A * inv_det;  // conic
    float g_u = a * S[0][j] + b * S[1][j], g_v = b * S[0][j] + d * S[1][j];
    CovarianceGradient g =
        covariance_gradient(a, b, d, -0.5f * S[2][j], -0.5f * S[3][j], -0.5f * S[4][j]);
    if (MORE && p.antialiased && T[0][j] != 0.f)
      add_compensation_gradient(cov, inv_det, T[0][j], g);
    PlaceGradient place;
    if (GENERAL) {
      float dW[9], dM[9], G[9];
      place = general_gradient(p, g, axes.W, m0, m1, inv_z, tx, ty, dW);
      for (int r = 0; r < 3; r++)  // W = R M
        for (int k = 0; k < 3; k++)
          dM[3 * r + k] = R[r] * dW[k] + R[3 + r] * dW[3 + k] + R[6 + r] * dW[6 + k];
      const float* Q = axes.Q;
      for (int k = 0; k < 3; k++) {  // M = Q diag(scales)
        out.scales[k][j] = Q[k] * dM[k] + Q[3 + k] * dM[3 + k] + Q[6 + k] * dM[6 + k];
        for (int r = 0; r < 3; r++) G[3 * r + k] = dM[3 * r + k] * scales[3 * j + k];
      }
      if (quaternions) {
        float gq[4];
        quaternion_gradient(quaternions + 4 * j, G, gq);
        for (int k = 0; k < 4; k++) out.quaternions[k][j] = gq[k];
      }
    } else {
      place = isotropic_gradient(p, g, scales[j], inv_z, tx, ty, &out.scales[0][j]);
    }
    // the clamped ratio has zero derivative; the centre is not clamped
    float g_rx = (rx == tx ? place.tx : 0.f) + g_u * p.fx;
    float g_ry = (ry == ty ? place.ty : 0.f) + g_v * p.fy;
    out.x[j] = g_rx * inv_z;
    out.y[j] = g_ry * inv_z;
    out.z[j] = place.z - (g_rx * rx + g_ry * ry) * inv_z + T[1][j];
  }
}

// Where no pixel contributed, the arithmetic may have met NaN inputs or an overflow: nothing of it
// is let out. `quaternions`: whether there are any.
template <bool GENERAL>
GV_INLINE void write_gradients(const Projection& p, const BatchGradients& g, const BatchSums& sums,
                               bool quaternions, int64_t first, int n, const GvGradients& out) {
  const auto& S = sums.S;
  const auto& T = sums.T;
  alignas(64) uint32_t touched[BATCH];
  for (int j = 0; j < n; j++) {
    float any = T[1][j] != 0.f ? 1.f : 0.f;
    for (int k = 0; k < 8; k++) any += S[k][j] != 0.f ? 1.f : 0.f;
    touched[j] = any > 0.f;
  }
  const float* R = p.rotation_f;
  float* means = out.means + 3 * first;
  for (int j = 0; j < n; j++) {  // back to the world by R transposed
    float x = g.x[j], y = g.y[j], z = g.z[j];
    means[3 * j] = touched[j] ? R[0] * x + R[3] * y + R[6] * z : 0.f;
    means[3 * j + 1] = touched[j] ? R[1] * x + R[4] * y + R[7] * z : 0.f;
    means[3 * j + 2] = touched[j] ? R[2] * x + R[5] * y + R[8] * z : 0.f;
  }
  if (out.scales)
    for (int j = 0; j < n; j++) {
      if (GENERAL)
        for (int k = 0; k < 3; k++)
          out.scales[3 * (first + j) + k] = touched[j] ? g.scales[k][j] : 0.f;
      else out.scales[first + j] = touched[j] ? g.scales[0][j] : 0.f;
    }
  if (out.quaternions)
    for (int j = 0; j < n; j++)
      for (int k = 0; k < 4; k++)
        out.quaternions[4 * (first + j) + k] = quaternions && touched[j] ? g.quaternions[k][j]
                                                                         : 0.f;
  if (out.colors)
    for (int j = 0; j < n; j++)
      for (int k = 0; k < 3; k++) out.colors[3 * (first + j) + k] = S[5 + k][j];
  if (out.opacities)
    for (int j = 0; j < n; j++) {
      float o = p.gaussians.opacities ? p.gaussians.opacities[first + j] : 1.f;
      out.opacities[first + j] = touched[j] ? T[0][j] / o : 0.f;
    }
}

// Gaussians [first, first + n). GENERAL: scales of three columns. MORE: `more` is there.
template <bool GENERAL, bool MORE>
static void backward_batch(const Projection& p, Sums* sums, MoreSums* more, const GvGradients& out,
                           int64_t first, int n) {
  const GvGaussians& in = p.gaussians;
  const float* scales = in.scales + (GENERAL ? 3 : 1) * first;
  const float* quaternions = GENERAL && in.quaternions ? in.quaternions + 4 * first : nullptr;
  CameraPoints c;
  BatchSums batch;
  BatchGradients gradients;
  to_camera(p, in.means + 3 * first, n, c);
  load_sums<MORE>(sums + first, MORE ? more + first : nullptr, n, batch);
  gradients_of<GENERAL, MORE>(p, scales, quaternions, c, batch, n, gradients);
  write_gradients<GENERAL>(p, gradients, batch, quaternions != nullptr, first, n, out);
  for (int j = 0; j < n; j++) sums[first + j] = Sums{};
  if (MORE)
    for (int j = 0; j < n; j++) more[first + j] = MoreSums{};
}

static void backward_project(const Projection* p, Sums* sums, MoreSums* more,
                             const GvGradients* out, int64_t begin, int64_t end) {
  bool general = p->gaussians.scale_columns == 3;
  auto batch = general ? (more ? backward_batch<true, true> : backward_batch<true, false>)
                       : (more ? backward_batch<false, true> : backward_batch<false, false>);
  for (int64_t i = begin; i < end; i += BATCH)
    batch(*p, sums, more, *out, i, (int)(end - i < BATCH ? end - i : BATCH));
}

}  // namespace gv::GV_NAMESPACE
