"""Masks as tools write them: each kind gives the same alpha, or is refused in one sentence."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from footage_folder import footage_folder, frame, mask

from gavatar.preparation.footage.mask_pictures import survey_masks, upright
from gavatar.preparation.footage_source import open_source
from gavatar_runtime.errors import UserError

COUNT = 3
NAMES = [f"{t:06d}.png" for t in range(COUNT)]


def colour(m, inside, outside=(0, 0, 0)):
    return np.where(m[..., None] > 0, np.array(inside, np.uint8), np.array(outside, np.uint8))


def cut_out(m, image):
    return np.dstack([image, m])


KINDS = {
    "cut-outs with alpha": cut_out,
    "grey with alpha": lambda m, image: np.dstack([cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)] * 3 + [m]),
    "16 bit with alpha": lambda m, image: cut_out(m, image).astype(np.uint16) * 257,
    "zero and one": lambda m, image: m // 255,
    "16 bit": lambda m, image: m.astype(np.uint16) * 257,
    "16 bit, zero and one": lambda m, image: (m // 255).astype(np.uint16),
    "16 bit, as bytes": lambda m, image: m.astype(np.uint16),
    "one label": lambda m, image: m // 255 * 15,
    "white in three channels": lambda m, image: np.dstack([m] * 3),
    "red on black": lambda m, image: colour(m, (0, 0, 255)),
    "opaque alpha over white on black": lambda m, image: np.dstack([m, m, m, np.full_like(m, 255)]),
    "inverted": lambda m, image: 255 - m,
    "inverted alpha": lambda m, image: cut_out(255 - m, image),
    "purple with a yellow person": lambda m, image: colour(m, (37, 231, 253), (84, 1, 68)),
}


def written(tmp_path, as_stored):
    return footage_folder(tmp_path / "f", NAMES, NAMES, as_stored)


def masks_of(folder):
    footage = open_source(folder).footage[0]
    return list(footage.masks())


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_mask_gives_the_same_alpha(tmp_path, kind):
    """After dbash/zerowaste #8 and wuhuikai/GP-GAN #1 (0 and 1), aleju/imgaug #202 (16 bit), smlab-niser/clean-gs #2
    (cut-outs), Comfy-Org/ComfyUI #2539 (alpha the other way), facebookresearch/segment-anything #675 (inverted)."""
    source = open_source(written(tmp_path, KINDS[kind]))
    for t, found in enumerate(source.footage[0].masks()):
        np.testing.assert_array_equal(found, mask(t))
    said = " ".join(source.notes)
    assert ("inverted" in said) == ("inverted" in kind)
    assert ("their alpha is the mask" in said) == ("alpha" in kind and "opaque" not in kind)


def palette_png(path, indices, colours, transparency=b""):
    """A PNG with a palette, 8 bit, as DAVIS, SAM 2 and Pillow's mode P write it."""
    height, width = indices.shape

    def chunk(kind, body):
        return struct.pack(">I4s", len(body), kind) + body + struct.pack(">I", zlib.crc32(kind + body))

    rows = b"".join(b"\0" + row.tobytes() for row in indices)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0))
    palette = chunk(b"PLTE", np.array(colours, np.uint8).tobytes())
    palette += chunk(b"tRNS", transparency) if transparency else b""
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + header + palette + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    )


DAVIS = [(0, 0, 0), (128, 0, 0), (0, 128, 0)]


@pytest.mark.parametrize(
    ("colours", "index", "transparency"),
    [
        (DAVIS, 1, b""),  # dark red: grey level 38
        ([(0, 0, 0), (1, 1, 1)], 1, b""),
        ([(255, 255, 255), (0, 0, 0)], 0, b""),  # the palette says which is white
        ([(10, 200, 30), (90, 20, 60)], 1, b"\x00\xff"),  # a cut-out of few colours: its transparency is the mask
    ],
)
def test_masks_with_a_palette(tmp_path, colours, index, transparency):
    """After facebookresearch/detectron2 #1760 and lxx1991/VS-ReID #3: read as grey, they are black."""
    folder = written(tmp_path, lambda m, image: m)
    for t, name in enumerate(NAMES):
        person = mask(t) > 0
        palette_png(folder / "masks" / name, np.where(person, index, 1 - index).astype(np.uint8), colours, transparency)
    for t, found in enumerate(masks_of(folder)):
        np.testing.assert_array_equal(found, mask(t))


def test_several_labels_are_taken_as_one_person_and_said(tmp_path):
    """Parts of a body, as parsers of people write them; after zllrunning/face-parsing.PyTorch #23."""
    rows = np.arange(64)[:, None]
    folder = written(tmp_path, lambda m, image: np.where(m > 0, 1 + rows // 16, 0).astype(np.uint8))
    source = open_source(folder)
    assert any("labels 1, 2, 3" in note for note in source.notes)
    for t, found in enumerate(source.footage[0].masks()):
        np.testing.assert_array_equal(found, mask(t))


def test_an_empty_frame_among_cut_outs_stays_empty(tmp_path):
    folder = written(tmp_path, cut_out)
    cv2.imwrite(str(folder / "masks" / NAMES[1]), cut_out(np.zeros_like(mask(0)), frame(1)))
    found = masks_of(folder)
    assert not found[1].any()
    np.testing.assert_array_equal(found[2], mask(2))


def test_only_some_masks_are_inverted(tmp_path):
    """After aliaksandr960/segment-anything-eo #4."""
    folder = written(tmp_path, lambda m, image: m)
    cv2.imwrite(str(folder / "masks" / NAMES[2]), 255 - mask(2))
    source = open_source(folder)
    assert any("1 of 3 masks are white" in note for note in source.notes)
    np.testing.assert_array_equal(list(source.footage[0].masks())[2], mask(2))


def test_a_person_cut_off_by_the_picture_is_not_inverted():
    filled = np.zeros((64, 48), np.uint8)
    filled[10:, 8:40] = 255  # the lower edge and nothing else
    assert not upright(filled)[1]
    assert not upright(np.zeros((1, 1), np.uint8))[1]


def test_soft_edges_are_kept(tmp_path):
    """Good masks come back as they are, to the bit."""
    folder = written(tmp_path, lambda m, image: cv2.GaussianBlur(m, (5, 5), 1))
    source = open_source(folder)
    assert source.notes == []
    for t, found in enumerate(source.footage[0].masks()):
        np.testing.assert_array_equal(found, cv2.GaussianBlur(mask(t), (5, 5), 1))


@pytest.mark.parametrize(
    ("as_stored", "message"),
    [
        (lambda m, image: cv2.resize(np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8), (64, 64)),
         r"000000\.png is a picture in \d+ colours, no mask"),
        (lambda m, image: np.zeros_like(m), "no mask shows anybody"),
        (lambda m, image: np.full_like(m, 255), "no mask shows anybody"),
        (lambda m, image: (np.arange(64 * 64).reshape(64, 64) % 90).astype(np.uint8), "no mask is brighter than 89"),
        (lambda m, image: m[:32], r"is 64x32 pixels, but camera 'cam0' filmed 64x64"),
        (lambda m, image: m.astype(np.float32), r"pixels of type float32|cannot be read|no mask"),
    ],
)  # fmt: skip
def test_pictures_that_are_no_masks_are_refused(tmp_path, as_stored, message):
    name = "{}.tif" if as_stored(mask(0), frame(0)).dtype == np.float32 else "{}.png"
    folder = footage_folder(tmp_path / "f", NAMES, [name.format(n[:-4]) for n in NAMES], as_stored)
    with pytest.raises(UserError, match=message):
        masks_of(folder)


def test_an_empty_file_is_named(tmp_path):
    folder = written(tmp_path, lambda m, image: m)
    (folder / "masks" / NAMES[1]).write_bytes(b"")
    with pytest.raises(UserError, match=r"000001\.png cannot be read as an image: it is empty \(0 bytes\)"):
        survey_masks(folder / "masks", sorted((folder / "masks").iterdir()))
