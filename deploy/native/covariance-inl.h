// Camera points and 2D covariances of Gaussians by the splatting rule: J Sigma J^T + LOW_PASS I
// with J = [[fx/z, 0, -fx/z tx], [0, fy/z, -fy/z ty]], where tx = X/Z and ty = Y/Z are clamped.
#pragma once
#include "kernels.h"
#include "scalars-inl.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

// The camera point of each Gaussian of a batch, computed in double: the order of depths is then
// that of the float64 reference, and large world coordinates cost no precision.
struct CameraPoints {
  alignas(64) float x[BATCH], y[BATCH], z[BATCH];
};
GV_INLINE void to_camera(const Projection& p, const float* means, int n, CameraPoints& out) {
  const double *R = p.rotation, *t = p.translation;
  for (int j = 0; j < n; j++) {
    double X = means[3 * j], Y = means[3 * j + 1], Z = means[3 * j + 2];
    out.x[j] = (float)(R[0] * X + R[1] * Y + R[2] * Z + t[0]);
    out.y[j] = (float)(R[3] * X + R[4] * Y + R[5] * Z + t[1]);
    out.z[j] = (float)(R[6] * X + R[7] * Y + R[8] * Z + t[2]);
  }
}

// A Gaussian's axes, as columns of row-major 3x3 matrices.
struct Axes {
  float Q[9];  // directions in the world: the rotation of the quaternion
  float M[9];  // Q diag(scales): Sigma = M M^T in the world
  float W[9];  // M in the camera
};
GV_INLINE void rotated_axes(const Projection& p, const float* q, const float* s, Axes& out) {
  float *Q = out.Q, *M = out.M, *W = out.W;
  float w = q[0], x = q[1], y = q[2], z = q[3], norm = w * w + x * x + y * y + z * z;
  float inverse = norm > 0 ? 1.f / __builtin_sqrtf(norm) : 0.f;  // all zero is the identity
  w *= inverse, x *= inverse, y *= inverse, z *= inverse;
  Q[0] = 1 - 2 * (y * y + z * z), Q[1] = 2 * (x * y - w * z), Q[2] = 2 * (x * z + w * y);
  Q[3] = 2 * (x * y + w * z), Q[4] = 1 - 2 * (x * x + z * z), Q[5] = 2 * (y * z - w * x);
  Q[6] = 2 * (x * z - w * y), Q[7] = 2 * (y * z + w * x), Q[8] = 1 - 2 * (x * x + y * y);
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 3; c++) M[3 * r + c] = Q[3 * r + c] * s[c];
  const float* R = p.rotation_f;
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 3; c++)
      W[3 * r + c] = R[3 * r] * M[c] + R[3 * r + 1] * M[3 + c] + R[3 * r + 2] * M[6 + c];
}

// [[A, B], [B, C]] with the low-pass; its determinant, and that without the low-pass. Determinants
// are summed from positive terms: A C - B^2 would lose all digits for the large and the thin.
struct Covariance {
  float A, B, C, det, sharp_det;
};
GV_INLINE void add_low_pass(Covariance& c, float det) {
  c.sharp_det = det;
  c.det = det + LOW_PASS * (c.A + c.C) + LOW_PASS * LOW_PASS;
  c.A += LOW_PASS;
  c.C += LOW_PASS;
}

// Of a sphere, from its scale over its depth.
GV_INLINE Covariance isotropic_covariance(const Projection& p, float s_over_z, float tx, float ty) {
  float kx = s_over_z * p.fx, ky = s_over_z * p.fy;
  Covariance c;
  c.A = kx * kx * (1 + tx * tx);
  c.B = kx * ky * tx * ty;
  c.C = ky * ky * (1 + ty * ty);
  add_low_pass(c, kx * ky * (kx * ky) * (1 + tx * tx + ty * ty));
  return c;
}

// Of axes W in the camera. m0 and m1: the rows of J W, so that A, B and C are their dot products.
GV_INLINE Covariance general_covariance(const Projection& p, const float W[9], float inv_z,
                                        float tx, float ty, float m0[3], float m1[3]) {
  float ax = p.fx * inv_z, ay = p.fy * inv_z;
  for (int k = 0; k < 3; k++) {
    m0[k] = ax * (W[k] - tx * W[6 + k]);
    m1[k] = ay * (W[3 + k] - ty * W[6 + k]);
  }
  Covariance c;
  c.A = m0[0] * m0[0] + m0[1] * m0[1] + m0[2] * m0[2];
  c.B = m0[0] * m1[0] + m0[1] * m1[1] + m0[2] * m1[2];
  c.C = m1[0] * m1[0] + m1[1] * m1[1] + m1[2] * m1[2];
  // by Cauchy and Binet, |m0|^2 |m1|^2 - (m0 . m1)^2 is the squared length of the cross product
  float n0 = m0[1] * m1[2] - m0[2] * m1[1];
  float n1 = m0[2] * m1[0] - m0[0] * m1[2];
  float n2 = m0[0] * m1[1] - m0[1] * m1[0];
  add_low_pass(c, n0 * n0 + n1 * n1 + n2 * n2);
  return c;
}

}  // namespace gv::GV_NAMESPACE
