"""The few file formats that a run is made of, written whole or not at all."""

from __future__ import annotations

import os
from typing import Any

import cv2
import numpy as np
import torch

from gavatar_runtime.errors import UserError
from gavatar_runtime.files import atomic, write_json
from gavatar_runtime.motion import Motion

__all__ = ["atomic", "load_tensors", "save_tensors", "write_image", "write_json", "write_motion"]


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
        raise UserError(
            f"{path} is not a readable checkpoint ({type(error).__name__}): delete it to start anew"
        ) from None
