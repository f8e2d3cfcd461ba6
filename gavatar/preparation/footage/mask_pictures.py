"""What a folder of mask pictures means: white on black, cut-outs with alpha, labels, 0 and 1, 16 bit, inverted.

All files of a camera are looked at before one is read, because a single one does not tell: an empty frame of a folder
of cut-outs looks like any other black picture.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gavatar_runtime.errors import UserError

from .pictures import palette_indices, read_as_stored

FEW = 32  # different values: more are soft edges or a photograph, not labels
GREY = 8  # levels by which the channels of a grey picture differ at most (JPEG stores colour coarsely)
SURROUNDED = 0.5  # share of the picture's edge that no person fills, but the background of an inverted mask does
MIDDLING = 0.1  # share of a mask that is neither dark nor bright: no soft edge is as wide
VOID = 255  # the label of object borders in PASCAL VOC and DAVIS


@dataclasses.dataclass(frozen=True)
class Look:
    """What one file holds. kind: 'alpha', 'grey', 'labels'. levels: its values if they are few, else None. top: its
    largest value. bits: 8 or 16. middling: share of its pixels above 0 that are neither dark nor bright."""

    kind: str
    levels: tuple[int, ...] | None
    top: int
    bits: int
    middling: float


@dataclasses.dataclass(frozen=True)
class MaskReader:
    """Reads the masks of one folder as alpha. alpha: they are cut-outs. labels: every value but 0 is the person. full:
    the value that is wholly the person."""

    alpha: bool
    labels: bool
    full: int

    def __call__(self, path: Path) -> np.ndarray:
        """(H, W) uint8, 255 where the person is."""
        return upright(self.stored(path))[0]

    def stored(self, path: Path) -> np.ndarray:
        """As `__call__`, not turned from inverted to upright."""
        look, values = _look(path)
        if self.alpha and look.kind != "alpha":
            image = read_as_stored(path)  # of one value: nobody, or everything
            values = image[..., 3] if image.ndim == 3 and image.shape[2] == 4 else values
        if self.labels or look.kind == "labels":
            return np.where((values != 0) & ~((values == VOID) & (look.top == VOID) & (look.kind == "labels")), 255, 0
                            ).astype(np.uint8)  # fmt: skip
        if self.full == 255 and values.dtype == np.uint8:
            return values
        return np.round(np.clip(values.astype(np.float64) * (255 / self.full), 0, 255)).astype(np.uint8)


def upright(mask: np.ndarray) -> tuple[np.ndarray, bool]:
    """A mask whose border is mostly person is inverted. Returns the mask with the person white, and whether it was."""
    border = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    inverted = bool((border > 127).mean() > SURROUNDED)
    return (255 - mask if inverted else mask), inverted


def survey_masks(folder: Path, files: list[Path]) -> tuple[MaskReader, list[str]]:
    """How the masks `files` are to be read, and sentences for the user. Raises UserError for pictures that are no
    masks."""
    different = list(dict.fromkeys(files))
    looks = [_look(path)[0] for path in different]
    said = []
    alpha = any(look.kind == "alpha" for look in looks)
    bits = max(look.bits for look in looks)
    if alpha:
        said.append(f"{folder}: the masks are pictures with alpha: their alpha is the mask")
        reader = MaskReader(True, False, 255 if bits == 8 else 65535)
    else:
        reader, notes = _of_values(folder, looks, bits)
        said += notes
    turned, empty = 0, 0
    for path in different:
        mask, inverted = upright(reader.stored(path))
        turned += inverted
        empty += not (mask > 127).any()
    if turned:
        said.append(
            f"{folder}: {turned} of {len(different)} masks are white (or opaque) along the picture's edge: taken as "
            "inverted, the person black"
        )
    if empty == len(different):
        raise UserError(f"{folder}: no mask shows anybody: give masks that are white where the person is")
    return reader, said


def _of_values(folder: Path, looks: list[Look], bits: int) -> tuple[MaskReader, list[str]]:
    """How masks without alpha are read."""
    top = max(look.top for look in looks)
    told = [look.levels for look in looks if look.levels is not None]
    levels = sorted({v for values in told for v in values}) if len(told) == len(looks) else None
    seen = [v for v in levels or [] if v and not (v == VOID and any(look.kind == "labels" for look in looks))]
    if any(look.kind == "labels" for look in looks):
        return MaskReader(False, True, 255), _labels_note(folder, seen, "colours")
    if top <= 1:
        return MaskReader(False, False, 1), []
    largest = 255 if top <= 255 else 65535
    if top > largest // 2:
        middle = [v for v in seen if largest // 16 < v < largest - largest // 16]
        if middle and np.mean([look.middling for look in looks]) > MIDDLING:
            shown = ", ".join(str(v) for v in middle[:6])
            return MaskReader(False, False, largest), [
                f"{folder}: the masks have {len(seen)} grey levels above black; those above {largest // 2} are the "
                f"person (between are {shown})"
            ]
        return MaskReader(False, False, largest), []
    if levels is None or len(seen) > FEW:
        raise UserError(f"{folder}: no mask is brighter than {top} of {largest}: give masks that are white where the "
                        "person is")  # fmt: skip
    return MaskReader(False, True, 255), _labels_note(folder, seen, "grey levels")


def _labels_note(folder: Path, seen: list[int], what: str) -> list[str]:
    if len(seen) < 2:
        return []
    shown = ", ".join(str(v) for v in seen[:8]) + (", ..." if len(seen) > 8 else "")
    return [
        f"{folder}: the masks hold {len(seen)} {what} (labels {shown}): all of them are taken as the person; where "
        "some are somebody else, give masks of one person"
    ]


def _look(path: Path) -> tuple[Look, np.ndarray]:
    """What a file holds, and its values (H, W): alpha, grey, or labels with 0 for the background."""
    indexed = palette_indices(path)
    if indexed is not None and not indexed[2]:
        labels = _palette_labels(*indexed[:2])
        if labels is not None:
            return _summary("labels", labels, 8), labels
    image = read_as_stored(path)
    bits = 16 if image.dtype == np.uint16 else 8
    if image.ndim == 3 and image.shape[2] == 4:
        alpha = image[..., 3]
        if alpha.min() != alpha.max() or alpha.max() == 0:
            return _summary("alpha", alpha, bits), alpha
        image = image[..., :3]
    if image.ndim == 2:
        return _summary("grey", image, bits), image
    spread = image.max(2).astype(int) - image.min(2)
    if spread.max() <= GREY * (257 if bits == 16 else 1):
        grey = image[..., 1].copy()
        return _summary("grey", grey, bits), grey
    labels = _colour_labels(path, image)
    return _summary("labels", labels, 8), labels


def _palette_labels(indices: np.ndarray, colours: np.ndarray) -> np.ndarray | None:
    """Labels of a palette's indices, 0 where its colour is black (or the first); None for a palette of greys, which is
    what it looks like."""
    used = np.unique(indices)
    if used.max() >= len(colours):
        return indices
    shown = colours[used].astype(int)
    if (shown.max(1) - shown.min(1)).max() <= GREY and (shown.max() > 127 or len(used) == 1):
        return None
    black = np.flatnonzero(colours.max(1) == 0)
    background = int(black[0]) if len(black) and black[0] in used else 0
    return np.where(indices == background, 0, np.where(indices == 0, used.max() + 1, indices)).astype(np.uint8)


def _colour_labels(path: Path, image: np.ndarray) -> np.ndarray:
    """Labels of a picture with few colours: 0 for black, or else for the most frequent colour along the edge."""
    if image.dtype == np.uint16:
        image = (image // 257).astype(np.uint8)
    code = (image.astype(np.uint32) * np.array([1, 256, 65536], np.uint32)).sum(2)
    colours, counts = np.unique(code, return_counts=True)
    if len(colours) > FEW and counts[counts > 0.001 * code.size].sum() < 0.9 * code.size:
        raise UserError(f"{path} is a picture in {len(colours)} colours, no mask: a mask is white where the person is, "
                        "or has alpha")  # fmt: skip
    if len(colours) > 254:
        raise UserError(f"{path} is a mask in {len(colours)} colours: store it as PNG, white where the person is")
    border = np.concatenate([code[0], code[-1], code[:, 0], code[:, -1]])
    values, often = np.unique(border, return_counts=True)
    background = 0 if 0 in colours else values[often.argmax()]
    labels = np.searchsorted(colours, code).astype(np.uint8) + 1
    labels[code == background] = 0
    return labels


def _summary(kind: str, values: np.ndarray, bits: int) -> Look:
    counts = np.bincount(values.reshape(-1))
    levels = np.flatnonzero(counts)
    few = tuple(int(v) for v in levels) if len(levels) <= FEW + 1 else None
    low, high = (15 * 256, 240 * 256) if bits == 16 else (15, 240)
    middling = counts[low + 1 : high].sum() / max(1, counts[1:].sum())
    return Look(kind, few, int(levels[-1]), bits, float(middling))
