"""Pictures that a page's camera sends: JPEG, of bounded size, from whoever may reach the page."""

from __future__ import annotations

import numpy as np

from ..errors import UserError, WrongValue

MOST_BYTES, MOST_SIDE = 2 << 20, 2048
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers with a picture's size: start of frame
_BARE = {0x01, *range(0xD0, 0xD8)}  # markers without a length


def jpeg_size(data: bytes) -> tuple[int, int]:
    """(width, height) that a JPEG says, (0, 0) where it does not; read before anything is made that large."""
    if data[:2] != b"\xff\xd8":
        return 0, 0
    place = 2
    while place + 4 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF or marker in _BARE:
            place += 1 if marker == 0xFF else 2
            continue
        length = int.from_bytes(data[place + 2 : place + 4], "big")
        if marker in _FRAMES:
            head = data[place + 5 : place + 9]
            return (int.from_bytes(head[2:4], "big"), int.from_bytes(head[:2], "big")) if len(head) == 4 else (0, 0)
        if length < 2 or marker == 0xDA:
            break
        place += 2 + length
    return 0, 0


def decoded(data: bytes) -> np.ndarray:
    """(H, W, 3) uint8, blue first. Raises WrongValue for anything but a JPEG of a size that a camera has."""
    if len(data) > MOST_BYTES:
        raise WrongValue(f"the camera's picture has {len(data)} bytes: send at most {MOST_BYTES}")
    width, height = jpeg_size(data)
    if min(width, height) < 1 or max(width, height) > MOST_SIDE:
        raise WrongValue(f"the camera's picture is no JPEG of 1 to {MOST_SIDE} pixels a side")
    try:
        import cv2
    except ImportError:
        raise UserError("reading a camera's pictures needs OpenCV: pip install 'gavatar[video]'") from None
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None or max(image.shape[:2]) > MOST_SIDE:
        raise WrongValue("the camera's picture is a JPEG that cannot be read")
    return image
