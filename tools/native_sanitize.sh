#!/bin/sh
# The native kernel under the sanitizers of GCC: addresses and undefined behaviour on the tests, and data
# races on a threaded run of the player's binding (torch's own threads are not instrumented, so they stay out of it).
#   PYTHON=python3 tools/native_sanitize.sh
set -eu
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}
CXX=${CXX:-g++}
WORK=$(mktemp -d)
trap 'rm -rf "$WORK"' EXIT
export CXX PYTHONPATH=".:deploy:tests/support${PYTHONPATH:+:$PYTHONPATH}" PYTHONDONTWRITEBYTECODE=1

build() { # name, flags...
    name=$1; shift
    "$PYTHON" -c 'import pathlib, sys, setup; setup.compile_library(pathlib.Path(sys.argv[1]), sys.argv[2:])' \
        "$WORK/$name.so" -g -O1 -fno-omit-frame-pointer "$@"
}

# A library that cannot be loaded would skip every test.
LOADS='from gavatar_runtime import native_library as nl; nl.library()'

echo '== address, undefined'
build asan -fsanitize=address,undefined -fno-sanitize-recover=undefined
sanitized() {
    GAVATAR_NATIVE_LIBRARY=$WORK/asan.so \
        LD_PRELOAD="$($CXX -print-file-name=libasan.so) $($CXX -print-file-name=libubsan.so)" \
        ASAN_OPTIONS=detect_leaks=0:verify_asan_link_order=0 UBSAN_OPTIONS=print_stacktrace=1 "$@"
}
sanitized "$PYTHON" -c "$LOADS"
sanitized "$PYTHON" -m pytest -q -p no:cacheprovider tests/runtime/render tests/plugins/rasterizers \
    tests/runtime/geometry/test_native_skinning.py -k native
sanitized "$PYTHON" -m pytest -q -p no:cacheprovider tests/gavatar/images/test_ssim.py \
    tests/gavatar/avatar/test_uv_sampling.py tests/gavatar/avatar/test_torch_skinning.py \
    tests/runtime/decoding/test_residuals.py

echo '== threads'
build tsan -fsanitize=thread
cat > "$WORK/threads.py" <<'PY'
import threading

import numpy as np
from gavatar_runtime import native_library as nl
from gavatar_runtime.render.rasterizers.native import NativeRasterizer
from gavatar_runtime.geometry.skinning import skin
from splat_scenes import as_numpy, random_scene, simple_camera


def draw(seed):
    player, scene = NativeRasterizer(), as_numpy(random_scene(seed, 12000, scale=0.01, isotropic=seed % 2 == 0))
    for _ in range(15):
        player.render(scene, simple_camera(160, 120))
        skin(scene.means, np.zeros((12000, 4), np.int32), np.ones((12000, 4), np.float32), np.eye(4, dtype=np.float32)[None])


threads = [threading.Thread(target=draw, args=(seed,)) for seed in range(3)]
for thread in threads:
    thread.start()
for turn in range(12):
    nl.set_threads(1 + turn % 4)
    threading.Event().wait(0.02)
for thread in threads:
    thread.join()
print("threads: done")
PY
# setarch: thread sanitizer cannot live with the kernel's randomisation of high addresses
GAVATAR_NATIVE_LIBRARY=$WORK/tsan.so LD_PRELOAD=$($CXX -print-file-name=libtsan.so) \
    TSAN_OPTIONS=halt_on_error=1:report_signal_unsafe=0 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
    setarch -R "$PYTHON" "$WORK/threads.py"
echo '== clean'
