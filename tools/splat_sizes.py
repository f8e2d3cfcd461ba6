"""How many bytes each format takes for a Gaussian of an avatar, in the middle of a wave.

python tools/splat_sizes.py NAME.gavatar
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.outputs import save_gaussians


def main(bundle: str) -> None:
    avatar = Avatar(bundle)
    motion = avatar.fit(read_motion("wave"))[0]
    gaussians = avatar.gaussians(*motion.at(len(motion) // 2))
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".ply", ".splat", ".spz", ".sog", ".glb"):
            path = Path(folder) / f"a{suffix}"
            save_gaussians(path, gaussians)
            print(f"{suffix:6}  {path.stat().st_size / len(gaussians):5.1f} bytes a Gaussian")


if __name__ == "__main__":
    main(*sys.argv[1:])
