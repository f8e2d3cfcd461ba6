"""A contact sheet of motions on an avatar, a row a clip: `motion_figure.py AVATAR CLIP... -o FILE.jpg`."""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.render.choice import build_rasterizer


def row(avatar: Avatar, rasterizer, clip: str, columns: int, side: int) -> np.ndarray:
    """(side, columns x side, 3) uint8 RGB: moments of a clip, each framed for itself, its name in the corner."""
    motion, _ = avatar.fit(read_motion(clip))
    front = motion.poses[:1]
    images = []
    for t in np.linspace(0.1, 0.9, columns) * (len(motion) - 1):
        t = int(t)
        one = type(motion)(np.concatenate([front, motion.poses[t : t + 1]]), motion.trans[[t, t]], 1.0)
        camera = frame_motion(avatar, one, side, side)
        gaussians = avatar.gaussians(*motion.at(t))
        images.append(
            rasterizer.render(gaussians, camera, (1, 1, 1)).color.copy()
        )  # the native kernel draws into the same memory
    picture = np.round(np.clip(np.concatenate(images, 1), 0, 1) * 255).astype(np.uint8)
    cv2.putText(picture, Path(clip).name, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (80, 80, 80), 1, cv2.LINE_AA)
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("avatar")
    parser.add_argument("clips", nargs="+")
    parser.add_argument("-o", "--out", required=True)
    parser.add_argument("--columns", type=int, default=6)
    parser.add_argument("--side", type=int, default=180)
    arguments = parser.parse_args()
    avatar, rasterizer = Avatar(arguments.avatar), build_rasterizer()
    rows = [row(avatar, rasterizer, clip, arguments.columns, arguments.side) for clip in arguments.clips]
    cv2.imwrite(arguments.out, np.concatenate(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
