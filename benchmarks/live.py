"""Driving an avatar live: how right the poses are, how they tremble before and after the filter, how fast, how late.

    python benchmarks/live.py CAPTURE                                   the pictures of its first camera, in order
    python benchmarks/live.py CAPTURE --avatar NAME.gavatar             and the rate of frames that are ready to be sent

CAPTURE has `body_truth.npz` of gavatar's own body. Joints are the 22 of the body, of the true shape; the true motion is
what they are held against. `behind` is the shift in time at which the error is least. The rate is measured as the
viewer works: pictures at 30 a second go in, a page asks for the next frame when it has the last, JPEG and all.
"""

from __future__ import annotations

import argparse
import json
import threading
from pathlib import Path
from time import perf_counter, process_time, sleep

import cv2
import numpy as np

from gavatar.images.metrics import joint_errors
from gavatar.preparation.initial import DEFAULT_FOV
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.avatar.played_body import PlayedBody
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.live.drivers import build_driver
from gavatar_runtime.live.following import Steadied
from gavatar_runtime.live.smoothing import PLACES, TURNS
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.values.body import SMPL_BODY_JOINTS
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.view.drive import LIVE, Drive
from gavatar_runtime.view.frame_encoding import encoded
from gavatar_runtime.view.viewed_avatar import ViewedAvatar, Wish

CAMERA_RATE = 30.0  # pictures a second of a usual webcam
WARM_UP = 45  # pictures in which a driver measures the person, who stays in place until then
WARM = 30  # frames that are not counted: buffers fill, the clock of the processor rises


def pictures(capture: Path) -> list[np.ndarray]:
    """Those of the capture's first camera, in order."""
    camera = sorted((capture / "images").iterdir())[0]
    return [cv2.imread(str(path)) for path in sorted(camera.iterdir())]


def jitter(joints: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """Mean error of the acceleration of joints (T, J, 3) about the first, m/s^2 (Kanazawa et al., HMMR, 2019)."""
    second = [np.diff(j - j[:, :1], n=2, axis=0) for j in (joints, truth)]
    return float(np.linalg.norm(second[0] - second[1], axis=-1).mean() * fps**2)


def behind(joints: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """Milliseconds by which the joints follow the truth late: the shift of least PA-MPJPE."""
    times = np.arange(len(truth)) / fps
    flat = truth.reshape(len(truth), -1)

    def error(late: float) -> float:
        moved = np.stack([np.interp(times - late, times, column) for column in flat.T], -1).reshape(truth.shape)
        return joint_errors(joints, moved)[1]

    shifts = np.arange(0, 0.3001, 0.005)
    return float(1000 * shifts[np.argmin([error(s) for s in shifts])])


def accuracy(capture: Path, fov: float) -> dict[str, dict[str, float]]:
    """Errors of the driver's poses and of what is shown, in millimetres and m/s^2."""
    body, truth = load_free_body(), read_motion(capture / "body_truth.npz", up="y")
    rest = body.shaped(truth.betas)[1]
    steadied = Steadied(PlayedBody(tuple(body.joint_names), rest, None, None, 0))
    driver, raw, shown, walked, lost = build_driver({"fov": fov}), [], [], [], 0
    for k, image in enumerate(pictures(capture)):
        seen = driver(image, k / truth.fps)
        pose, trans, _ = steadied(seen, k / truth.fps)
        walked.append(trans)
        lost += seen is None
        shown.append(pose[:SMPL_BODY_JOINTS])
        raw.append(shown[-1] if seen is None else seen.pose[:SMPL_BODY_JOINTS])
    places = rest[:SMPL_BODY_JOINTS], body.parents[:SMPL_BODY_JOINTS]

    def joints(poses: np.ndarray) -> np.ndarray:
        return joint_transforms(np.asarray(poses, np.float64), *places)[..., :3, 3]

    true = joints(truth.poses[: len(raw), :SMPL_BODY_JOINTS])
    found = {}
    for name, poses in (("before the filter", raw), ("after the filter", shown)):
        mine = joints(np.stack(poses))
        mpjpe, pa = joint_errors(mine, true)
        found[name] = {"pa_mpjpe_mm": pa, "mpjpe_mm": mpjpe, "jitter_m_s2": jitter(mine, true, truth.fps),
                       "behind_ms": behind(mine, true, truth.fps)}  # fmt: skip
    found["after the filter"]["frames_without_a_person"] = lost
    for axis, name in ((0, "sideways"), (2, "towards_the_camera")):
        # the slope of the line through what was found over what is true, once the bones are measured
        there, here = (np.asarray(t, np.float64)[WARM_UP:, axis] for t in (truth.trans[: len(raw)], walked))
        found["after the filter"][f"walked_{name}_of_true"] = float(np.polyfit(there, here, 1)[0])
    return found


def rate(capture: Path, avatar: str, tier: str | None, size: int, seconds: float) -> dict[str, float]:
    """Frames a second, and milliseconds from a picture to a frame that is ready to be sent."""
    scene = ViewedAvatar(read_bundle(avatar), tier=tier)
    drive = Drive(scene.body, driver=build_driver())
    images = pictures(capture)
    page, over = threading.Event(), threading.Event()
    standing = Motion(drive.rest[0][None], np.zeros((1, 3)), 30.0)
    wish = Wish(LIVE, 0.0, frame_motion(scene.body, standing, size, size), (1.0, 1.0, 1.0), scene.tier, None)
    following = drive._started()

    def feed() -> None:  # as a page does: one picture after the other, none before its time
        start = perf_counter()
        k = 0
        while not over.is_set():
            sleep(max(0.0, start + k / CAMERA_RATE - perf_counter()))
            following.give(images[k % len(images)])
            k = max(k + 1, int((perf_counter() - start) * CAMERA_RATE))

    feeder = threading.Thread(target=feed, daemon=True)
    feeder.start()
    late, looked, drew, last, start, count, busy = [], [], [], 0, 0.0, 0, 0.0
    while count < WARM or perf_counter() - start < seconds:
        shown = drive.next(page)
        if shown is None or shown.number == last:
            continue
        began = perf_counter()
        image, _, gaussians = scene.draw_pose(wish, shown.pose, shown.trans)
        encoded(image)
        drive.beside(shown)
        last, count, now = shown.number, count + 1, perf_counter()
        if count == WARM:
            start, busy, late, looked, drew = now, process_time(), [], [], []
        late.append(1000 * (now - shown.taken))
        looked.append(1000 * shown.seconds)
        drew.append(1000 * (now - began))
    fps = (len(late) - 1) / (perf_counter() - start)
    processor = 1000 * (process_time() - busy) / (len(late) - 1)
    over.set()
    drive.close()
    return {
        "fps": fps, "delay_ms": float(np.median(late)), "delay_p95_ms": float(np.percentile(late, 95)),
        "landmarks_and_fit_ms": float(np.median(looked)), "draw_and_encode_ms": float(np.median(drew)),
        "processor_ms_a_frame": processor, "gaussians": gaussians, "size": size,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--avatar", metavar="NAME.gavatar")
    parser.add_argument("--tier")
    parser.add_argument("--size", type=int, default=512, help="pixels of a side of a frame")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--fov", type=float, default=DEFAULT_FOV, help="degrees that the camera is said to see")
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    found: dict[str, dict] = accuracy(a.capture, a.fov)
    for name, values in found.items():
        print(f"{name}: " + "  ".join(f"{key} {value:.1f}" for key, value in values.items()))
    print(
        f"delay of the filter: turns {1000 * TURNS.delay():.0f} ms at rest, {1000 * TURNS.delay(3):.0f} ms at 3 rad/s; "
        f"places {1000 * PLACES.delay():.0f} ms at rest, {1000 * PLACES.delay(1):.0f} ms at 1 m/s"
    )
    if a.avatar:
        found["rate"] = rate(a.capture, a.avatar, a.tier, a.size, a.seconds)
        print("live: " + "  ".join(f"{key} {value:.1f}" for key, value in found["rate"].items()))
    if a.json:
        a.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
