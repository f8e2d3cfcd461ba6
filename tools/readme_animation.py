"""The moving picture at the top of the README, and the still one of the guide's page on Python, from a bundle.

    python tools/readme_animation.py gavatar_demo/studio_demo.gavatar

Writes docs/figures/avatar.webp (the avatar turns, then waves) and docs/figures/from_python.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import gavatar_runtime as gr
from gavatar_runtime.formats.files import atomic
from gavatar_runtime.play.framing import frame_motion

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"
SIZE, FPS = 320, 12


def frames(avatar: gr.Avatar, name: str) -> list[np.ndarray]:
    """The built-in motion `name` at 12 frames a second, (320, 320, 3) uint8 each, one camera for all."""
    motion, _ = avatar.fit(gr.read_motion(name).resampled(FPS))
    camera = frame_motion(avatar, motion, SIZE, SIZE)
    return [avatar.render(pose, camera, trans=trans) for pose, trans in zip(motion.poses, motion.trans, strict=True)]


def main(bundle: str) -> None:
    avatar = gr.load(bundle)
    images = [Image.fromarray(image) for name in ("turn", "wave") for image in frames(avatar, name)]
    options = {"save_all": True, "append_images": images[1:], "duration": 1000 // FPS, "loop": 0, "quality": 70}
    with atomic(FIGURES / "avatar.webp") as temporary:
        images[0].save(temporary, format="WEBP", **options)
    pose = gr.read_motion("wave").poses[20]
    row = [avatar.render(pose, camera=camera, size=384) for camera in ("front", "left", "back")]
    with atomic(FIGURES / "from_python.png") as temporary:
        Image.fromarray(np.concatenate(row, 1)).save(temporary, format="PNG")


if __name__ == "__main__":
    main(sys.argv[1])
