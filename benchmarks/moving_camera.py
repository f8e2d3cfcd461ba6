"""What a camera that is held by hand costs: a studio capture before a room, panned and shaken, as a plain video.

    python benchmarks/moving_camera.py studio_male --room real_p2s/videos/cam02.mp4 --room-masks real_p2s/masks/cam02 \\
        --out DIR

The picture is the capture's own, in a larger frame, seen by a camera that turns on the spot and zooms, so that the
truth of every frame is known. Prepared twice: as it is, and with the measured motion left out (`still`). Joints: MPJPE
around the pelvis along each frame's camera axes, millimetres; place: error of the pelvis in the room after one
similarity for the whole clip, millimetres; camera: error of the turn between each frame and the middle one, degrees.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
from masks import before_room, room_arguments, room_picture

from gavatar.capture.capture import Capture, View, read_capture
from gavatar.images.metrics import joint_errors
from gavatar.preparation.detect import Detector
from gavatar.preparation.footage_source import SourceOptions, open_source
from gavatar.preparation.pipeline import fit_and_write
from gavatar.preparation.write import CaptureFacts
from gavatar.registry import BODIES, load_plugins
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle

LARGER = 2.0  # times the capture's picture: the frame in which the camera turns


def hand(frames: int, fps: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 3) turns of a camera that pans by 12 degrees and shakes, and (T,) its zoom."""
    rng, time = np.random.default_rng(seed), np.arange(frames) / fps
    kernel = np.exp(-0.5 * (np.arange(-8, 9) / 2.0) ** 2)
    shake = np.stack([np.convolve(rng.normal(size=frames + 16), kernel / np.sqrt((kernel**2).sum()), "valid")
                      for _ in range(3)], -1)  # fmt: skip
    angles = np.radians([0.4, 0.4, 0.5]) * shake
    angles[:, 1] += np.radians(6) * np.sin(0.9 * time)
    angles[:, 0] += np.radians(1.5) * np.sin(0.5 * time)
    return matrix_from_axis_angle(angles), np.exp(0.04 * np.sin(0.7 * time))


def write_clip(capture: Capture, frames: range, room: np.ndarray, path: Path) -> tuple[np.ndarray, Path]:
    camera, rng = capture.cameras["cam0"], np.random.default_rng(0)
    turns, zooms = hand(len(frames), capture.motion.fps / frames.step)
    h, w = room.shape[:2]
    left, top = (w - camera.width) // 2, (h - camera.height) // 2
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    shift, centres = np.eye(3), np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    shift[:2, 2] = -left, -top
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), capture.motion.fps / frames.step,
                             (camera.width, camera.height))  # fmt: skip
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 95)
    for t, R, zoom in zip(frames, turns, zooms, strict=True):
        color, alpha = capture.load(View("cam0", t))
        sides = ((top, h - top - camera.height), (left, w - left - camera.width))
        picture = before_room(np.pad(color, (*sides, (0, 0))), np.pad(alpha, sides), room, rng)
        H = np.diag([zoom, zoom, 1.0])
        H = K @ H @ R @ np.linalg.inv(K) @ shift
        writer.write(cv2.warpPerspective(picture, np.linalg.inv(centres) @ H @ centres, (camera.width, camera.height)))
    writer.release()
    return turns, path


def similar(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Points a (T, 3) brought onto b by one rotation, scale and shift."""
    x, y = a - a.mean(0), b - b.mean(0)
    U, S, Vt = np.linalg.svd(x.T @ y)
    D = np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))])
    return x @ (U @ D @ Vt) * (S * np.diag(D)).sum() / (x**2).sum() + b.mean(0)


def score(found: Capture, given: Capture, rows: list[int], turns: np.ndarray) -> dict:
    data, truth = BODIES.build("free").data, given.truth
    P = found.motion.poses.reshape(len(rows), -1, 3)
    ours = np.array([data.posed(p, found.motion.betas, t)[1] for p, t in zip(P, found.motion.trans, strict=True)])
    true = np.array([data.posed(truth.poses[t].reshape(-1, 3), truth.betas, truth.trans[t])[1] for t in rows])
    cameras = [found.camera(View("cam0", t)).T_camera_world[:3, :3] for t in range(len(rows))]
    theirs = turns @ given.cameras["cam0"].T_camera_world[:3, :3]
    errors = joint_errors(np.einsum("tab,tjb->tja", cameras, ours), np.einsum("tab,tjb->tja", theirs, true))
    middle = len(rows) // 2
    off = [a @ cameras[middle].T @ (b @ theirs[middle].T).T for a, b in zip(cameras, theirs, strict=True)]
    feet = ours[:, [7, 8], 1].min(1)
    off = np.linalg.norm(axis_angle_from_matrix(np.array(off)), axis=-1)
    place = np.linalg.norm(similar(ours[:, 0], true[:, 0]) - true[:, 0], axis=-1)
    return {
        "mpjpe_mm": round(errors[0], 1), "pa_mpjpe_mm": round(errors[1], 1),
        "place_mm": round(float(1000 * place.mean()), 1), "camera_deg": round(float(np.degrees(off).mean()), 2),
        "lower_ankle_height_mm": round(float(1000 * feet.std()), 1),
    }  # fmt: skip


def main() -> None:
    parser = room_arguments(__doc__)
    parser.add_argument("--fov", type=float, default=29.1, help="degrees; the capture's own by default")
    arguments = parser.parse_args()
    load_plugins()
    given, out = read_capture(arguments.capture), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    camera = given.cameras["cam0"]
    size = round(LARGER * camera.width), round(LARGER * camera.height)
    room = room_picture(arguments.room, arguments.room_masks, size)
    frames = range(0, arguments.frames, arguments.step)
    turns, clip = write_clip(given, frames, room, out / "clip.avi")
    source = open_source(clip, SourceOptions(detector=Detector(out / "masks", progress=False)))
    (footage,) = source.footage
    rows = [frames[t] for t in footage.numbers]
    turns = turns[footage.numbers]
    still = dataclasses.replace(source, footage=[dataclasses.replace(footage, motion=None)])
    result: dict = {"frames": len(rows), "notes": source.notes}
    for name, taken in (("measured", source), ("still", still)):
        data = BODIES.build("free").data
        quality = fit_and_write(taken, data, out / name, CaptureFacts(name, "free"), fov=arguments.fov, overwrite=True,
                                progress=False)  # fmt: skip
        result[name] = score(read_capture(out / name), given, rows, turns) | {
            "iou": round(float(quality.iou.mean()), 3)
        }
        print(json.dumps({name: result[name]}), flush=True)
    (out / "moving_camera.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
