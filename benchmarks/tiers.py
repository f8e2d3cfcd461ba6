"""Every stored tier of a bundle in poses far from its capture's: limbs high, deep squat, a bow, all joints at random.

    python benchmarks/tiers.py NAME.gavatar --out docs/figures/tiers.jpg

One row a tier, one column a pose. Prints the PSNR of each picture against the full model and the largest distance of a
Gaussian from the body's surface, so that an explosion shows in numbers too.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.formats.files import atomic
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.tiers import stored_tiers
from gavatar_runtime.values.motion import Motion

WHITE = (1, 1, 1)


def poses(joint_names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """(J, 3) axis-angle poses by name."""
    place = {name: j for j, name in enumerate(joint_names)}

    def pose(**rotations) -> np.ndarray:
        result = np.zeros((len(joint_names), 3), np.float32)
        for name, rotation in rotations.items():
            result[place[name]] = rotation
        return result

    rng = np.random.default_rng(0)
    wild = np.zeros((len(joint_names), 3), np.float32)
    wild[1:22] = rng.normal(0, 0.8, (21, 3))
    return {
        "arms high": pose(left_shoulder=(0, 0, 1.4), right_shoulder=(0, 0, -1.4)),
        "deep squat": pose(
            left_hip=(-1.9, 0.3, 0.2), right_hip=(-1.9, -0.3, -0.2), left_knee=(2.2, 0, 0), right_knee=(2.2, 0, 0),
            left_ankle=(-0.5, 0, 0), right_ankle=(-0.5, 0, 0), left_shoulder=(0, -1.3, -0.3),
            right_shoulder=(0, 1.3, 0.3),
        ),
        "bow": pose(
            spine1=(0.7, 0, 0), spine2=(0.5, 0, 0), spine3=(0.4, 0, 0),
            left_shoulder=(0, 0, -1.1), right_shoulder=(0, 0, 1.1)),
        "high kick": pose(left_hip=(-2.1, 0, 0.2), right_shoulder=(0, 1.4, 0), left_shoulder=(0, 0, -0.8)),
        "0.8 rad at random": wild,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatar")
    parser.add_argument("--out", default="docs/figures/tiers.jpg")
    parser.add_argument("--size", type=int, default=320)
    a = parser.parse_args()
    bundle = read_bundle(a.avatar)
    rasterizer = build_rasterizer()
    rows, full = [], {}
    for tier in stored_tiers(bundle):
        avatar = Avatar(bundle, tier=tier)
        row = []
        for name, pose in poses(avatar.joint_names).items():
            motion = Motion(pose[None], np.zeros((1, 3), np.float32), 30.0)
            camera = frame_motion(avatar, motion, a.size, a.size)
            gaussians = avatar.gaussians(pose)
            image = np.clip(rasterizer.render(gaussians, camera, WHITE).color, 0, 1).copy()
            full.setdefault(name, image)
            mse = np.mean(np.square(image - full[name]))
            off = 1000 * np.linalg.norm(gaussians.means - avatar.surface.posed(pose), axis=1).max()
            quality = "itself" if mse == 0 else f"{-10 * np.log10(mse):.1f} dB"
            print(f"{tier:<11} {name:<18} against full: {quality:>8}   farthest from the body: {off:5.1f} mm")
            picture = np.rint(image * 255).astype(np.uint8)
            row.append(cv2.putText(picture, f"{tier}, {name}", (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1))
        rows.append(np.concatenate(row, 1))
    with atomic(Path(a.out)) as temporary:
        cv2.imwrite(str(temporary), np.concatenate(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()
