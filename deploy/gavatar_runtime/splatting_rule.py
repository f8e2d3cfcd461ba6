"""The splatting rule that every rasterizer follows (3D Gaussian Splatting, Kerbl et al. 2023, in EWA form).

For each Gaussian in front of the near plane:

1. camera point (X, Y, Z), pixel (fx X/Z + cx, fy Y/Z + cy);
2. 2D covariance J Sigma J^T + LOW_PASS I, where J is the Jacobian of the projection at the mean with X/Z and Y/Z
   clamped to the image's own bounds widened by FRUSTUM_MARGIN of its half-size (so that an off-centre principal point
   is treated like a centred one);
3. at a pixel centre offset by d: alpha = min(ALPHA_MAX, opacity exp(-d^T conic d / 2)); skipped below ALPHA_MIN;
4. front to back in (float32 depth, index) order; a pixel stops before the Gaussian that would bring its transmittance
   below TRANSMITTANCE_STOP.

The support of a Gaussian is exactly {alpha >= ALPHA_MIN}; tiles are an implementation matter and never visible.
A Gaussian with any non-finite field, or a scale below zero, is dropped and counted.
Gradients pass through the ALPHA_MAX clamp as if it were not there (as the 3DGS authors do), are zero for a skipped
Gaussian, and do not see the frustum clamp as a constant: the clamped ratio has zero derivative.
"""

LOW_PASS = 0.3  # px^2, added to both diagonal entries
ALPHA_MAX = 0.99
ALPHA_MIN = 1.0 / 255.0
TRANSMITTANCE_STOP = 1e-4
NEAR = 0.01  # metres
FRUSTUM_MARGIN = 0.3  # of the image's half-size, on each side
