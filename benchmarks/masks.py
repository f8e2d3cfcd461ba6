"""How good the masks of a person before a real room are: a studio capture with known alpha is put before the picture
of a room, with shadows that move with the person and with noise, made into a video, and its masks are found again.

    python benchmarks/masks.py studio_male --room real_p2s/videos/cam02.mp4 --room-masks real_p2s/masks/cam02 --out DIR

Prints intersection over union, the mean absolute error of alpha within 5 pixels of the true border, and the error of
the premultiplied colours there (grey levels), with which the wall shows up.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np

from gavatar.capture.capture import Capture, View, read_capture
from gavatar.images.unmixing import without_background
from gavatar.preparation.detect import Detector
from gavatar.preparation.draw import iou
from gavatar.preparation.footage_source import SourceOptions, open_source

BAND = 5  # pixels
NOISE, SHADOW = 3.0, 0.4  # grey levels, standard deviation; share of the light that a shadow takes


def room_picture(video: Path, masks: Path, size: tuple[int, int]) -> np.ndarray:
    """(H, W, 3) float32 BGR in [0, 255]: the median of a video where its masks show nobody, the rest filled in."""
    film, images = cv2.VideoCapture(str(video)), []
    for path in sorted(masks.glob("*.png")):
        good, image = film.read()
        person = cv2.dilate(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.ones((41, 41))) > 20
        if good and int(path.stem) % 5 == 0:
            images.append(np.where(person[..., None], np.nan, image[:, : person.shape[1]].astype(np.float32)))
    with np.errstate(all="ignore"):
        room = np.nanmedian(images, axis=0)
    unknown = np.isnan(room[..., 0]).astype(np.uint8)
    room = cv2.inpaint(np.nan_to_num(room).astype(np.uint8), unknown, 5, cv2.INPAINT_TELEA)
    scale = max(size[0] / room.shape[1], size[1] / room.shape[0])
    room = cv2.resize(room, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    y = (room.shape[0] - size[1]) // 2
    return room[y : y + size[1], : size[0]].astype(np.float32)


def before_room(color: np.ndarray, alpha: np.ndarray, room: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) uint8 BGR. color: premultiplied RGB in [0, 1]."""
    h, w = alpha.shape
    rows = np.flatnonzero(alpha.max(1) > 0.5)
    foot, height = rows[-1], rows[-1] - rows[0]
    thrown = cv2.warpAffine(alpha, np.float32([[1, 0, 0.06 * height], [0, 1, 0.02 * height]]), (w, h))
    lying = cv2.warpAffine(alpha, np.float32([[1, 0.35, -0.35 * foot], [0, 0.15, 0.86 * foot]]), (w, h))
    shade = SHADOW * np.maximum(cv2.GaussianBlur(thrown, (0, 0), 6), cv2.GaussianBlur(lying, (0, 0), 4))
    picture = 255 * color[..., ::-1] + (1 - alpha[..., None]) * room * (1 - shade[..., None])
    return np.uint8(np.clip(np.round(picture + NOISE * rng.normal(size=picture.shape)), 0, 255))


def write_clip(capture: Capture, frames: range, room: np.ndarray, path: Path) -> Path:
    rng, size = np.random.default_rng(0), room.shape[1::-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), capture.motion.fps, size)
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 95)  # as a phone's high rate; mp4v would shift borders by a pixel
    for t in frames:
        writer.write(before_room(*capture.load(View("cam0", t)), room, rng))
    writer.release()
    return path


def band_of(alpha: np.ndarray) -> np.ndarray:
    inside = (alpha > 0.5).astype(np.uint8)
    return (cv2.distanceTransform(inside, cv2.DIST_L2, 5) + cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)) <= BAND


def room_arguments(description: str | None) -> argparse.ArgumentParser:
    """What every benchmark of a capture before a room is given."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--room", type=Path, required=True)
    parser.add_argument("--room-masks", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--step", type=int, default=2)
    parser.add_argument("--frames", type=int, default=140)
    return parser


def main() -> None:
    arguments = room_arguments(__doc__).parse_args()
    capture, out = read_capture(arguments.capture), arguments.out
    out.mkdir(parents=True, exist_ok=True)
    camera = capture.cameras["cam0"]
    room = room_picture(arguments.room, arguments.room_masks, (camera.width, camera.height))
    cv2.imwrite(str(out / "room.png"), room)
    frames = range(0, arguments.frames, arguments.step)
    clip = write_clip(capture, frames, room, out / "clip.avi")
    start = time.perf_counter()
    source = open_source(clip, SourceOptions(detector=Detector(out / "masks", progress=False)))
    seconds = time.perf_counter() - start
    (footage,) = source.footage
    rows, plate = [], footage.background
    for number, image, mask in zip(footage.numbers, footage.images(), footage.masks(), strict=True):
        color, alpha = capture.load(View("cam0", frames[number]))
        band, found = band_of(alpha), mask.astype(np.float32) / 255
        mixed = image.astype(np.float32) / 255 * found[..., None]
        if plate is not None:
            mixed = without_background(image.astype(np.float32) / 255, found, plate.astype(np.float32) / 255)
        wrong = np.abs(mixed[..., ::-1] - color)[band].mean()
        rows.append((iou(found > 0.5, alpha > 0.5), np.abs(found - alpha)[band].mean(), 255 * wrong))
    table = np.array(rows)
    result = {
        "frames": len(rows), "seconds": round(seconds, 1), "notes": source.notes,
        "iou": [round(float(table[:, 0].mean()), 4), round(float(table[:, 0].min()), 4)],
        "alpha_error": round(float(table[:, 1].mean()), 4), "colour_error": round(float(table[:, 2].mean()), 2),
    }  # fmt: skip
    print(json.dumps(result, indent=1))
    (out / "masks.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
