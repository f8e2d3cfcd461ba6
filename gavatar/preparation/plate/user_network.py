"""A matting network that the user brings: its contract is MODNet's, so that its published file works unchanged."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from gavatar_runtime.decoding.network import session_options
from gavatar_runtime.errors import UserError

SIDE, MULTIPLE = 512, 32  # pixels of the shorter side where the network leaves it open, and what sides divide by
AROUND = 0.15  # of the person's box: how much of the picture the network is shown beside it


class MattingNetwork:
    """(image, coarse mask) -> mask, by an ONNX network of one input and one output.

    Input: (1, 3, h, w) float32, RGB in [-1, 1]; output: (1, 1, h, w) float32 alpha in [0, 1]. Where h and w are open,
    the shorter side is 512 and both are multiples of 32; else the picture is brought to the size that the network
    states. The network sees the picture around the person that is followed; what it finds far from them is left out.
    """

    def __init__(self, path: Path):
        try:
            self.session = onnxruntime.InferenceSession(
                str(path), session_options(), providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # the runtime's own error classes differ from version to version
            raise UserError(f"{path} cannot be read as an ONNX network: {error}") from None
        self.path, self.name = path, path.name
        inputs, outputs = self.session.get_inputs(), self.session.get_outputs()
        shape = inputs[0].shape if inputs else []
        if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3 or inputs[0].type != "tensor(float)" or not outputs:
            raise UserError(
                f"{path} takes {[(i.name, i.shape, i.type) for i in inputs]}: a matting network takes one input "
                "(1, 3, height, width) float32, RGB in [-1, 1], and gives alpha (1, 1, height, width) in [0, 1], as "
                "MODNet does"
            )
        self.input, self.output = inputs[0].name, outputs[0].name
        self.fixed = tuple(side if isinstance(side, int) and side > 0 else None for side in shape[2:])

    def __call__(self, image: np.ndarray, coarse: np.ndarray) -> np.ndarray:
        """(H, W) uint8 alpha. image: (H, W, 3) uint8 BGR. coarse: (H, W) uint8, where the person is."""
        x, y, w, h = cv2.boundingRect((coarse > 127).astype(np.uint8))
        if min(w, h) < 4:
            return coarse
        margin = max(8, round(AROUND * max(w, h)))
        part = slice(max(0, y - margin), y + h + margin), slice(max(0, x - margin), x + w + margin)
        crop = image[part]
        height, width = self._size(*crop.shape[:2])
        shown = cv2.resize(crop, (width, height), interpolation=cv2.INTER_AREA)[..., ::-1]
        tensor = np.ascontiguousarray(shown.transpose(2, 0, 1)[None], np.float32) / 127.5 - 1
        try:
            alpha = np.asarray(self.session.run([self.output], {self.input: tensor})[0], np.float32)
        except Exception as error:
            raise UserError(f"{self.path} fails on a picture of {width}x{height} pixels: {error}") from None
        if alpha.size != height * width or not np.isfinite(alpha).all():
            raise UserError(f"{self.path} gives {alpha.shape} for a picture of {width}x{height}: alpha (1, 1, height, "
                            "width) in [0, 1] is expected")  # fmt: skip
        full = cv2.resize(alpha.reshape(height, width).clip(0, 1), crop.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        mask = np.zeros(image.shape[:2], np.uint8)
        mask[part] = np.round(255 * full)
        return mask * cv2.dilate((coarse > 20).astype(np.uint8), np.ones((2 * margin + 1,) * 2))

    def _size(self, height: int, width: int) -> tuple[int, int]:
        scale = SIDE / min(height, width)
        free = [max(MULTIPLE, round(side * scale / MULTIPLE) * MULTIPLE) for side in (height, width)]
        h, w = (known or side for known, side in zip(self.fixed, free, strict=True))
        return h, w
