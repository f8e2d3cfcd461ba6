"""The few file formats that a run is made of, written whole or not at all."""

from __future__ import annotations

import os
from typing import Any

import cv2
import numpy as np
import torch

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.files import atomic, write_json
from gavatar_runtime.motions.motion_file import write_motion

__all__ = ["atomic", "load_tensors", "save_tensors", "write_image", "write_json", "write_motion"]


def write_image(path: str | os.PathLike, image: np.ndarray) -> None:
    """image: (H, W, 3) RGB in [0, 1] -> a file of the suffix's format."""
    with atomic(path) as temporary:
        pixels = np.round(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
        if not cv2.imwrite(str(temporary), pixels[..., ::-1]):
            raise UserError(f"{path} could not be written: is its suffix one of .png, .jpg?")


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
