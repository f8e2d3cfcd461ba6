"""A wheel in an environment of its own, where no compiler is within reach: what it draws there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import scene
from build import ROOT

# In the fresh environment: through the package's own faces, by the rasterizer that it prefers there.
PROGRAM = """
import shutil, sys
import numpy as np
assert not [name for name in ("cc", "c++", "g++", "gcc", "clang", "clang++", "zig") if shutil.which(name)]
import gavatar_runtime
from gavatar_runtime import native_library
from gavatar_runtime.geometry.skinning import skin
from gavatar_runtime.render.choice import best_rasterizer, build_rasterizer
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians
assert gavatar_runtime.__file__.startswith(sys.prefix), gavatar_runtime.__file__
assert "torch" not in sys.modules
with np.load("scene.npz") as s:
    means = skin(s["rest"], s["index"], s["weight"], s["transforms"])
    gaussians = Gaussians(means, s["scales"], s["colors"], s["opacities"], s["quaternions"])
    camera = Camera(*(int(n) for n in s["size"]), *(float(x) for x in s["focal"]), s["view"])
    np.save("drawn.npy", build_rasterizer().render(gaussians, camera, s["background"]).color)
print(best_rasterizer(), *native_library.available(), sep="; ")
"""


def draw_installed(wheel: Path, folder: Path) -> np.ndarray:
    """The picture by `wheel`, installed with its dependencies into a fresh environment in `folder`."""
    run = dict(check=True, cwd=folder, text=True)
    folder.mkdir()
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / "venv")], **run)
    binaries = folder / "venv" / "bin"
    pip = [sys.executable, "-m", "pip", "--python", str(binaries / "python"), "install", "-q"]
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    environment |= {"PATH": str(binaries), "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PYTHONNOUSERSITE": "1"}
    subprocess.run([*pip, "-c", str(ROOT / "constraints.txt"), str(wheel)], env=environment, **run)
    made = scene.make_scene()
    g, camera = made.gaussians, made.camera
    np.savez(
        folder / "scene.npz", rest=made.rest, index=made.index, weight=made.weight, transforms=made.transforms,
        scales=g.scales, colors=g.colors, opacities=g.opacities, quaternions=g.quaternions,
        size=[camera.width, camera.height], focal=[camera.fx, camera.fy, camera.cx, camera.cy],
        view=camera.T_camera_world, background=scene.BACKGROUND,
    )  # fmt: skip
    said = subprocess.run(
        [str(binaries / "python"), "-c", PROGRAM], env=environment, **run, stdout=subprocess.PIPE
    ).stdout.strip()
    wanted = "numpy; False" if wheel.name.endswith("-any.whl") else "native; True"
    if not said.startswith(wanted):
        raise RuntimeError(f"{wheel.name}, installed, says: {said}; wanted {wanted}")
    print(f"{wheel.name}, installed without a compiler: {said}", file=sys.stderr)
    return np.load(folder / "drawn.npy")
