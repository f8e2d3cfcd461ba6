// From sums over pixels to the gradients of Gaussians.
#pragma once
#include "covariance-inl.h"
#include "kernels.h"
#include "scalars-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

template <bool GENERAL, bool MORE>
static void backward_batch(const Projection& p, Sums* sums, MoreSums* more, const GvGradients& out, int64_t first,
                           int n) {
  const GvGaussians& in = p.gaussians;
  const float* scales = in.scales + (GENERAL ? 3 : 1) * first;
  const float* quaternions = GENERAL && in.quaternions ? in.quaternions + 4 * first : nullptr;
  CameraPoints c;
  to_camera(p, in.means + 3 * first, n, c);
  alignas(64) float S[8][BATCH], T[2][BATCH];
  alignas(64) float gx[BATCH], gy[BATCH], gz[BATCH], gs[3][BATCH], gq[4][BATCH];
  int done = 0;
#if GV_LANES == 8
  for (; done + 8 <= n; done += 8) {
    V m[8];
    for (int k = 0; k < 8; k++) m[k] = load(&sums[first + done + k].v_dx);
    transpose(m);
    for (int k = 0; k < 8; k++) store(&S[k][done], m[k]);
  }
#endif
  for (int j = done; j < n; j++) {
    const float* a = &sums[first + j].v_dx;
    for (int k = 0; k < 8; k++) S[k][j] = a[k];
  }
  for (int j = 0; j < n; j++) {
    T[0][j] = MORE ? more[first + j].v : 0.f;
    T[1][j] = MORE ? more[first + j].w_depth : 0.f;
  }
  const float* R = p.rotation_f;
  for (int j = 0; j < n; j++) {
    bool ahead = c.z[j] > NEAR;
    float inv_z = 1.f / (ahead ? c.z[j] : 1.f);
    float rx = c.x[j] * inv_z, ry = c.y[j] * inv_z;  // X/Z and Y/Z, and then clamped as in the Jacobian
    float tx = low(high(rx, p.x_low), p.x_high), ty = low(high(ry, p.y_low), p.y_high);
    Covariance cov;
    float M[9], Q[9], W[9], m0[3], m1[3];
    if (GENERAL) {
      const float identity[4] = {1, 0, 0, 0};
      rotated_axes(p, quaternions ? quaternions + 4 * j : identity, scales + 3 * j, M, Q, W);
      cov = general_covariance(p, W, inv_z, tx, ty, m0, m1);
    } else {
      cov = isotropic_covariance(p, scales[j] * inv_z, tx, ty);
    }
    float inv_det = 1.f / cov.det;
    float a = cov.C * inv_det, b = -cov.B * inv_det, d = cov.A * inv_det;  // conic [[a, b], [b, d]]
    float g_u = a * S[0][j] + b * S[1][j], g_v = b * S[0][j] + d * S[1][j];
    // dL/dconic = G, a symmetric matrix; dL/dcov = -conic G conic
    float ga = -0.5f * S[2][j], gb = -0.5f * S[3][j], gd = -0.5f * S[4][j];
    float h00 = a * ga + b * gb, h01 = a * gb + b * gd, h10 = b * ga + d * gb, h11 = b * gb + d * gd;
    float g_A = -(h00 * a + h01 * b), g_C = -(h10 * b + h11 * d), g_B = -(h00 * b + h01 * d) - (h10 * a + h11 * b);
    if (MORE && p.antialiased && T[0][j] != 0.f) {  // log of the compensation = (log det S - log det (S + low-pass)) / 2
      float sharp = 1.f / cov.sharp_det, v = 0.5f * T[0][j];
      g_A += v * ((cov.C - LOW_PASS) * sharp - cov.C * inv_det);
      g_C += v * ((cov.A - LOW_PASS) * sharp - cov.A * inv_det);
      g_B -= 2 * v * cov.B * (sharp - inv_det);
    }
    float g_tx, g_ty, g_z;
    if (GENERAL) {
      float ax = p.fx * inv_z, ay = p.fy * inv_z, d0[3], d1[3], dW[9];
      float along = 0, d0W2 = 0, d1W2 = 0;
      for (int k = 0; k < 3; k++) {
        d0[k] = 2 * g_A * m0[k] + g_B * m1[k];
        d1[k] = 2 * g_C * m1[k] + g_B * m0[k];
        along += d0[k] * m0[k] + d1[k] * m1[k];
        d0W2 += d0[k] * W[6 + k];
        d1W2 += d1[k] * W[6 + k];
        dW[k] = ax * d0[k];
        dW[3 + k] = ay * d1[k];
        dW[6 + k] = -(tx * dW[k] + ty * dW[3 + k]);
      }
      g_tx = -ax * d0W2;
      g_ty = -ay * d1W2;
      g_z = -along * inv_z;
      float dM[9], G[9];
      for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) dM[3 * r + k] = R[r] * dW[k] + R[3 + r] * dW[3 + k] + R[6 + r] * dW[6 + k];
      for (int k = 0; k < 3; k++) {
        gs[k][j] = Q[k] * dM[k] + Q[3 + k] * dM[3 + k] + Q[6 + k] * dM[6 + k];
        for (int r = 0; r < 3; r++) G[3 * r + k] = dM[3 * r + k] * scales[3 * j + k];
      }
      if (quaternions) {
        const float* q = quaternions + 4 * j;
        float norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
        float inverse = norm > 0 ? 1.f / __builtin_sqrtf(norm) : 0.f;
        float w = q[0] * inverse, x = q[1] * inverse, y = q[2] * inverse, z = q[3] * inverse;
        float gw = 2 * (x * (G[7] - G[5]) + y * (G[2] - G[6]) + z * (G[3] - G[1]));
        float gqx = 2 * (y * (G[1] + G[3]) + z * (G[2] + G[6]) + w * (G[7] - G[5]) - 2 * x * (G[4] + G[8]));
        float gqy = 2 * (x * (G[1] + G[3]) + z * (G[5] + G[7]) + w * (G[2] - G[6]) - 2 * y * (G[0] + G[8]));
        float gqz = 2 * (x * (G[2] + G[6]) + y * (G[5] + G[7]) + w * (G[3] - G[1]) - 2 * z * (G[0] + G[4]));
        float radial = gw * w + gqx * x + gqy * y + gqz * z;  // the norm has no influence
        gq[0][j] = (gw - radial * w) * inverse;
        gq[1][j] = (gqx - radial * x) * inverse;
        gq[2][j] = (gqy - radial * y) * inverse;
        gq[3][j] = (gqz - radial * z) * inverse;
      }
    } else {
      float kx = p.fx * inv_z, ky = p.fy * inv_z, s = scales[j];
      float shape = g_A * kx * kx * (1 + tx * tx) + g_C * ky * ky * (1 + ty * ty) + g_B * kx * ky * tx * ty;
      gs[0][j] = 2 * s * shape;
      g_z = -2 * s * s * shape * inv_z;
      g_tx = s * s * (2 * g_A * kx * kx * tx + g_B * kx * ky * ty);
      g_ty = s * s * (2 * g_C * ky * ky * ty + g_B * kx * ky * tx);
    }
    // the clamped ratio has zero derivative; the centre is not clamped
    g_tx = (rx == tx ? g_tx : 0.f) + g_u * p.fx;
    g_ty = (ry == ty ? g_ty : 0.f) + g_v * p.fy;
    gx[j] = g_tx * inv_z;
    gy[j] = g_ty * inv_z;
    gz[j] = g_z - (g_tx * rx + g_ty * ry) * inv_z + T[1][j];
  }
  // Where no pixel contributed, the arithmetic above may have met NaN inputs or an overflow: nothing of it is let out.
  alignas(64) uint32_t touched[BATCH];
  for (int j = 0; j < n; j++) {
    float any = T[1][j] != 0.f ? 1.f : 0.f;
    for (int k = 0; k < 8; k++) any += S[k][j] != 0.f ? 1.f : 0.f;
    touched[j] = any > 0.f;
  }
  float* gm = out.means + 3 * first;
  for (int j = 0; j < n; j++) {
    float x = gx[j], y = gy[j], z = gz[j];
    gm[3 * j] = touched[j] ? R[0] * x + R[3] * y + R[6] * z : 0.f;
    gm[3 * j + 1] = touched[j] ? R[1] * x + R[4] * y + R[7] * z : 0.f;
    gm[3 * j + 2] = touched[j] ? R[2] * x + R[5] * y + R[8] * z : 0.f;
  }
  if (out.scales)
    for (int j = 0; j < n; j++) {
      if (GENERAL)
        for (int k = 0; k < 3; k++) out.scales[3 * (first + j) + k] = touched[j] ? gs[k][j] : 0.f;
      else
        out.scales[first + j] = touched[j] ? gs[0][j] : 0.f;
    }
  if (out.quaternions)
    for (int j = 0; j < n; j++)
      for (int k = 0; k < 4; k++)
        out.quaternions[4 * (first + j) + k] = quaternions && touched[j] ? gq[k][j] : 0.f;
  if (out.colors)
    for (int j = 0; j < n; j++)
      for (int k = 0; k < 3; k++) out.colors[3 * (first + j) + k] = S[5 + k][j];
  if (out.opacities)
    for (int j = 0; j < n; j++) {
      float o = in.opacities ? in.opacities[first + j] : 1.f;
      out.opacities[first + j] = touched[j] ? T[0][j] / o : 0.f;
    }
  for (int j = 0; j < n; j++) sums[first + j] = Sums{};
  if (MORE)
    for (int j = 0; j < n; j++) more[first + j] = MoreSums{};
}

static void backward_project(const Projection* p, Sums* sums, MoreSums* more, const GvGradients* out, int64_t begin,
                             int64_t end) {
  bool general = p->gaussians.scale_columns == 3;
  auto batch = general ? (more ? backward_batch<true, true> : backward_batch<true, false>)
                       : (more ? backward_batch<false, true> : backward_batch<false, false>);
  for (int64_t i = begin; i < end; i += BATCH) batch(*p, sums, more, *out, i, (int)(end - i < BATCH ? end - i : BATCH));
}

}  // namespace gv::GV_NAMESPACE
