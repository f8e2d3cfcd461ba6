"""How far wrists and fingers of a prepared capture are from the truth, along the camera's axes.

python benchmarks/finger_errors.py PREPARED TRUTH_CAPTURE
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gavatar.capture.capture import read_capture
from gavatar.preparation.hands.anatomy import hand_anatomy
from gavatar.preparation.hands.landmarks import SIDES
from gavatar.registry import BODIES, load_plugins
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.body import BodyData


def seen_hands(data: BodyData, motion_file: Path, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 2, 15, 3) finger joints around their wrists, metres, and (T, 2, 3, 3) the wrists' rotations, both along the
    axes of the camera whose rotation from the world is `view`."""
    with np.load(motion_file) as file:
        poses, betas, trans = (file[key].astype(np.float64) for key in ("poses", "betas", "trans"))
    poses = poses.reshape(len(poses), -1, 3)
    chosen = hand_anatomy(data, betas).joints
    joints = np.stack([data.posed(p, betas, t)[1] for p, t in zip(poses, trans, strict=True)]) @ view.T
    local, turned = matrix_from_axis_angle(poses), []
    for j, parent in enumerate(data.parents):
        turned.append(local[:, j] if parent < 0 else turned[parent] @ local[:, j])
    wrists = view @ np.stack([turned[j] for j in chosen[:, 0]], 1)
    return joints[:, chosen[:, 1:]] - joints[:, chosen[:, :1]], wrists


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("prepared", type=Path)
    parser.add_argument("truth", type=Path, help="a capture with body_truth.npz, of the same frames and camera")
    parser.add_argument("--camera", default="cam0")
    arguments = parser.parse_args()
    load_plugins()
    data = BODIES.build("free", {}).data
    pairs = []
    for folder, name in ((arguments.prepared, "body.npz"), (arguments.truth, "body_truth.npz")):
        camera = read_capture(folder).cameras[arguments.camera]
        pairs.append(seen_hands(data, folder / name, camera.T_camera_world[:3, :3]))
    (found, wrists), (truth, true_wrists) = pairs
    error = 1000 * np.linalg.norm(found - truth, axis=-1)
    own = 1000 * np.linalg.norm(
        np.einsum("thba,thjb->thja", wrists, found) - np.einsum("thba,thjb->thja", true_wrists, truth), axis=-1
    )
    trace = np.einsum("thab,thab->th", wrists, true_wrists)
    angle = np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
    for h, side in enumerate(SIDES):
        print(
            f"{side}: finger joints {error[:, h].mean():.1f} mm (median {np.median(error[:, h]):.1f}) from the wrist, "
            f"{own[:, h].mean():.1f} mm along the wrist's own axes; "
            f"wrist turned by {angle[:, h].mean():.1f} degrees (median {np.median(angle[:, h]):.1f})"
        )


if __name__ == "__main__":
    main()
