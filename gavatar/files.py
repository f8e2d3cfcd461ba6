"""Writing files whole or not at all, and the few formats that a run is made of."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from gavatar_runtime.errors import UserError
from gavatar_runtime.motion import Motion


@contextlib.contextmanager
def atomic(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, renamed over it when the block succeeds and removed when not."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: str | os.PathLike, value: Any) -> None:
    """Write `value` as indented JSON."""
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def write_image(path: str | os.PathLike, image: np.ndarray) -> None:
    """image: (H, W, 3) RGB in [0, 1] -> a file of the suffix's format."""
    with atomic(path) as temporary:
        pixels = np.round(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
        if not cv2.imwrite(str(temporary), pixels[..., ::-1]):
            raise UserError(f"{path} could not be written: is its suffix one of .png, .jpg?")


def write_motion(path: str | os.PathLike, motion: Motion) -> None:
    """Write a motion with AMASS keys, which every reader of such files takes."""
    with atomic(path) as temporary:
        np.savez(
            temporary,
            poses=motion.poses.reshape(len(motion), -1).astype(np.float32),
            trans=motion.trans.astype(np.float32),
            betas=np.zeros(0) if motion.betas is None else motion.betas,
            mocap_framerate=np.float64(motion.fps),
            gender=np.array("neutral"),
        )


def save_tensors(path: str | os.PathLike, state: dict[str, Any]) -> None:
    """Write tensors and plain values so that `load_tensors` reads them."""
    with atomic(path) as temporary:
        torch.save(state, temporary)


def load_tensors(path: str | os.PathLike) -> dict[str, Any]:
    """Read what `save_tensors` wrote, tensors and plain values only (nothing is executed)."""
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise UserError(f"{path} is missing") from None
    except Exception as error:
        raise UserError(f"{path} is not a readable checkpoint ({type(error).__name__}): delete it to start anew") from None
