"""The program ffmpeg, where there is one, for videos that OpenCV cannot decode."""

from __future__ import annotations

import dataclasses
import functools
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import cv2
import numpy as np

from gavatar_runtime.errors import UserError

_FRAME = re.compile(r"showinfo.*\bpts_time:\s*(\S+).*\bs:(\d+)x(\d+)")
_STREAM = re.compile(r"Stream #.*: Video: (\w+)(?:.*, ([\d.]+k?) fps)?")


@dataclasses.dataclass(frozen=True)
class ProgramFacts:
    """stamps: (T,) seconds, NaN where unknown. size: (width, height) upright. rate: that the file says."""

    stamps: np.ndarray
    size: tuple[int, int]
    rate: float | None
    codec: str


def program() -> str | None:
    """Its path, None where there is none on the PATH."""
    return shutil.which("ffmpeg")


@functools.lru_cache(maxsize=4)
def _each_frame(ffmpeg: str) -> tuple[str, str]:
    """The option that gives every frame once: renamed in ffmpeg 5.1."""
    asked = subprocess.run([ffmpeg, "-hide_banner", "-h", "long"], capture_output=True, text=True, check=False)
    return ("-fps_mode" if "-fps_mode" in asked.stdout else "-vsync"), "passthrough"


def _input(path: Path) -> list[str]:
    return ["-nostdin", "-hide_banner", "-i", f"file:{path.resolve()}", "-map", "0:v:0"]  # a: in a:b.mp4 is no protocol


def program_facts(path: Path) -> ProgramFacts:
    """By decoding all of it. UserError quotes the program where it gives up."""
    ffmpeg = str(program())
    ran = subprocess.run(
        [ffmpeg, *_input(path), "-vf", "showinfo", *_each_frame(ffmpeg), "-f", "null", "-"],
        capture_output=True, text=True, errors="replace", check=False,
    )  # fmt: skip
    frames = _FRAME.findall(ran.stderr)
    if not frames:
        words = [line for line in ran.stderr.splitlines() if line.strip()]
        raise UserError(f"{path} cannot be read as a video, nor by the program ffmpeg: "
                        f"{words[-1].strip() if words else f'exit code {ran.returncode}'}")  # fmt: skip
    stream = _STREAM.search(ran.stderr)
    rate = stream[2] if stream else None
    return ProgramFacts(
        np.array([float(time) if re.fullmatch(r"-?[\d.]+", time) else np.nan for time, _, _ in frames]),
        (int(frames[0][1]), int(frames[0][2])),
        None if not rate else 1000 * float(rate[:-1]) if rate.endswith("k") else float(rate),
        stream[1] if stream else "unknown",
    )


def program_frames(path: Path, numbers: np.ndarray) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 BGR of the frames `numbers`, which do not decrease, upright. UserError where they end early."""
    ffmpeg, wanted = str(program()), np.unique(numbers)
    choose = f"between(n,{wanted[0]},{wanted[-1]})"
    step = np.diff(wanted)
    if len(step) and (step == step[0]).all():
        choose += f"*not(mod(n-{wanted[0]},{step[0]}))"
        there = list(wanted)
    else:
        there = list(range(int(wanted[0]), int(wanted[-1]) + 1))
    running = subprocess.Popen(
        [ffmpeg, "-loglevel", "error", *_input(path), "-vf", f"select='{choose}'", *_each_frame(ffmpeg),
         "-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    assert running.stdout is not None
    try:
        at = iter(numbers)
        target = next(at)
        for k in there:
            image = _ppm(running.stdout)
            if image is None:
                raise UserError(f"{path} ends at frame {k}, but frame {numbers[-1]} was asked for: it is damaged")
            while target is not None and target == k:
                yield image
                target = next(at, None)
    finally:
        running.stdout.close()
        running.kill()
        running.wait()


def _ppm(stream: IO[bytes]) -> np.ndarray | None:
    """The next picture, None at the end."""
    header = stream.readline(), stream.readline(), stream.readline()
    if header[0].strip() != b"P6" or header[2].strip() != b"255":
        return None
    width, height = (int(number) for number in header[1].split())
    content = stream.read(width * height * 3)
    if len(content) < width * height * 3:
        return None
    return cv2.cvtColor(np.frombuffer(content, np.uint8).reshape(height, width, 3), cv2.COLOR_RGB2BGR)
