"""What becomes of footage that shows half a person: a capture with known truth is cut off and prepared as a video.

    python benchmarks/half_person.py studio_male --out DIR

For each cut: what was said to be fitted, the landmarks' error (pixels, of those in the picture that the network is sure
of), the joints' errors relative to neck and shoulders along the camera's axes, millimetres, and the silhouette's
intersection over union. The error of wrists counts arms that left the picture too.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from gavatar.capture.capture import Capture, View, read_capture
from gavatar.preparation.coverage import CERTAIN, in_picture
from gavatar.preparation.detect import Detector
from gavatar.preparation.footage_source import SourceOptions, open_source
from gavatar.preparation.landmarks import landmark_rows
from gavatar.preparation.pipeline import fit_and_write
from gavatar.preparation.write import CaptureFacts
from gavatar.registry import BODIES, load_plugins
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

# Share of the person's height that is seen, and of the picture's width left and right of their first place.
CUTS = {"head and shoulders": (0.36, 0.31, 2.0), "to the hips": (0.58, 0.39, 1.5), "to the knees": (0.8, 0.43, 1.5)}
UPPER = ("head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist")
MIDDLE = ("neck", "left_shoulder", "right_shoulder")


def write_cut(capture: Capture, frames: range, cut: tuple[float, float, float], path: Path) -> Path:
    """The frames of cam0 on white, cut off, enlarged, as an mp4."""
    share, beside, scale = cut
    _, alpha = capture.load(View("cam0", 0))
    x, y, w, h = cv2.boundingRect((alpha > 0.5).astype(np.uint8))
    width, top = alpha.shape[1], max(0, y - 20)
    rows, columns = slice(top, top + round(share * h)), slice(*(round(x + w / 2 + s * beside * width) for s in (-1, 1)))
    size, writer = None, None
    for t in frames:
        color, alpha = capture.load(View("cam0", t))
        part = (color + 1 - alpha[..., None])[rows, max(0, columns.start) : columns.stop]
        size = size or tuple(int(scale * n) // 2 * 2 for n in part.shape[1::-1])
        image = cv2.resize(np.uint8(255 * np.clip(part, 0, 1))[..., ::-1], size, interpolation=cv2.INTER_CUBIC)
        writer = writer or cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), capture.motion.fps / 2, size)
        writer.write(image)
    writer.release()
    return path


def joints_of(data, motion: Motion, betas, camera: Camera, rows) -> np.ndarray:
    """(T, J, 3) joints along the camera's axes, around neck and shoulders, metres."""
    poses = motion.poses.reshape(len(motion.trans), -1, 3)
    joints = np.array([data.posed(poses[t], betas, motion.trans[t])[1] for t in rows]) @ camera.T_camera_world[:3, :3].T
    return joints - joints[:, [list(data.joint_names).index(name) for name in MIDDLE]].mean(1, keepdims=True)


def landmark_error(data, found: Capture, marks) -> np.ndarray:
    """Pixels between certain landmarks in the picture and their places on the body."""
    regressor, weights = landmark_rows(data)
    motion, camera = found.motion, found.cameras["cam0"]
    rest, points = regressor @ data.shaped(motion.betas)[0], []
    for pose, trans in zip(motion.poses.reshape(len(motion.trans), -1, 3), motion.trans, strict=True):
        A = data.skinning(pose, motion.betas)
        points.append(np.einsum("kj,jab,kb->ka", weights, A[:, :3], np.c_[rest, np.ones(33)]) + trans)
    miss = np.linalg.norm(camera.project(np.array(points))[..., :2] - marks.image, axis=-1)
    return miss[(marks.visibility > CERTAIN) & in_picture(camera, marks.image)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    load_plugins()
    given, data, out = read_capture(arguments.capture), BODIES.build("free").data, arguments.out
    out.mkdir(parents=True, exist_ok=True)
    frames, result = range(0, 140, 2), {}
    for name, cut in CUTS.items():
        folder = out / name.replace(" ", "_")
        clip = write_cut(given, frames, cut, out / f"{folder.name}.mp4")
        source = open_source(clip, SourceOptions(detector=Detector(out / "masks" / folder.name, progress=False)))
        quality = fit_and_write(source, data, folder, CaptureFacts(name, "free"), overwrite=True, progress=False)
        found, rows = read_capture(folder), [frames[t] for t in source.footage[0].numbers]
        ours = joints_of(data, found.motion, found.motion.betas, found.cameras["cam0"], range(len(rows)))
        error = ours - joints_of(data, given.truth, given.truth.betas, given.cameras["cam0"], rows)
        millimetres = 1000 * np.linalg.norm(error, axis=-1).mean(0)
        names, miss = list(data.joint_names), landmark_error(data, found, source.footage[0].landmarks)
        result[name] = {
            "said": quality.coverage.sentence(), "frames": len(rows), "iou": round(float(quality.iou.mean()), 3),
            "landmarks_px": [round(float(np.percentile(miss, q)), 1) for q in (50, 95)],
            "joints_mm": {joint: round(float(millimetres[names.index(joint)])) for joint in UPPER},
            "ankles_mm": round(float(millimetres[[names.index(f"{s}_ankle") for s in ("left", "right")]].mean())),
        }  # fmt: skip
        print(json.dumps({name: result[name]}), flush=True)
    (out / "half_person.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
