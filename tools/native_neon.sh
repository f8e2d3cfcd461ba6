#!/bin/sh
# The native kernel for 64-bit ARM: cross-compiled, and, where QEMU's user emulation is installed, run beside this
# machine's own build on the same scene (needs g++-aarch64-linux-gnu, qemu-user-static).
#   PYTHON=python3 tools/native_neon.sh
set -eu
cd "$(dirname "$0")/.."
command -v aarch64-linux-gnu-g++ > /dev/null || { echo "NEON: aarch64-linux-gnu-g++ is not installed, not run"; exit 0; }
PYTHON=${PYTHON:-python3}
WORK=$(mktemp -d)
trap 'rm -rf "$WORK"' EXIT
cat > "$WORK/draw.cpp" <<'CPP'
#include <cmath>
#include <cstdio>
#include <vector>

#include "gavatar_native.h"

// Forward and backward of a general scene; prints every value that another build must agree with.
int main() {
  const int N = 4000, W = 150, H = 110;
  unsigned seed = 1;
  auto uniform = [&] { return (float)((seed = seed * 1664525u + 1013904223u) >> 8) / (1 << 24); };
  std::vector<float> means, scales, colors, opacities, quaternions;
  for (int i = 0; i < N; i++) {
    float z = 1 + 2 * uniform();
    means.insert(means.end(), {(uniform() - .5f) * z, (uniform() - .5f) * z, z});
    for (int k = 0; k < 3; k++) scales.push_back(.005f + .03f * uniform()), colors.push_back(uniform());
    for (int k = 0; k < 4; k++) quaternions.push_back(uniform() - .5f);
    opacities.push_back(uniform());
  }
  GvGaussians g{N, means.data(), scales.data(), colors.data(), opacities.data(), quaternions.data(), nullptr, 3};
  GvCamera camera{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 150, 150, 75, 55, W, H};
  GvOptions options{};
  options.transmittance_stop = 1e-4f, options.keep = 1, options.antialiased = 1;
  std::vector<float> color(3 * W * H), alpha(W * H), depth(W * H), gm(3 * N), gs(3 * N), gc(3 * N), go(N), gq(4 * N);
  GvImages images{color.data(), alpha.data(), depth.data(), nullptr};
  GvReport report;
  GvBackwardReport times;
  GvFrame* frame = gv_frame_new();
  if (gv_forward(frame, &g, &camera, &options, &images, &report)) return 1;
  std::vector<float> up(3 * W * H);
  for (float& x : up) x = uniform() - .5f;
  GvImages upstream{up.data(), nullptr, nullptr, nullptr};
  GvGradients out{gm.data(), gs.data(), gc.data(), go.data(), gq.data()};
  if (gv_backward(frame, &g, &camera, &options, &images, &upstream, &out, &times)) return 1;
  gv_frame_free(frame);
  fprintf(stderr, "%s: %lld visible, %lld entries\n", gv_isa_name(gv_isa()), (long long)report.visible,
          (long long)report.entries);
  for (auto* values : {&color, &alpha, &depth, &gm, &gs, &gc, &go, &gq}) {
    fwrite(values->data(), 4, values->size(), stdout);
  }
}
CPP
PYTHONPATH=".${PYTHONPATH:+:$PYTHONPATH}" "$PYTHON" -c \
    'import pathlib, sys, setup; setup.write_rule(pathlib.Path(sys.argv[1]))' "$WORK"
build() { # compiler, output, flags...
    compiler=$1; output=$2; shift 2
    "$compiler" -std=c++17 -O2 -fno-math-errno -fno-trapping-math -ffp-contract=fast -Wall -Wextra -Werror \
        -DGV_BASELINE_ONLY -DGV_NAMESPACE=baseline -I"$WORK" -Ideploy/native "$@" \
        deploy/native/*.cpp "$WORK/draw.cpp" -o "$output" -pthread
}
build aarch64-linux-gnu-g++ "$WORK/arm" -static
echo "NEON: compiled, $(aarch64-linux-gnu-objdump -d "$WORK/arm" | grep -c 'fmla.*v[0-9]*\.4s') vector multiply-adds"
QEMU=$(command -v qemu-aarch64-static || command -v qemu-aarch64 || true)
[ -n "$QEMU" ] || { echo "NEON: qemu-user-static is not installed, not run"; exit 0; }
build "${CXX:-g++}" "$WORK/here"
"$QEMU" "$WORK/arm" > "$WORK/arm.bin"
"$WORK/here" > "$WORK/here.bin"
"$PYTHON" - "$WORK/arm.bin" "$WORK/here.bin" <<'PY'
import array
import sys

a, b = (array.array("f", open(path, "rb").read()) for path in sys.argv[1:])
pixels = 150 * 110
image = max(abs(x - y) for x, y in zip(a[: 5 * pixels], b[: 5 * pixels]))
g, h = a[5 * pixels :], b[5 * pixels :]
gradient = (sum((x - y) ** 2 for x, y in zip(g, h)) / sum(y * y for y in h)) ** 0.5
print(f"NEON: images differ by {image:.1e} at most, gradients by {gradient:.1e} in relative L2")
# float32 arithmetic in another order: a few hundred roundings of 6e-8; the 1/255 threshold may flip in a pixel
sys.exit(not (len(a) == len(b) and image < 1e-2 and gradient < 1e-3))
PY
