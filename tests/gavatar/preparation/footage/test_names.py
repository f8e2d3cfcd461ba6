"""Names of frames and masks as tools and systems write them."""

import os

import numpy as np
import pytest
from footage_folder import footage_folder, frame, mask, write_landmarks

from gavatar.preparation.footage.listing import IMAGE_SUFFIXES, footage_files
from gavatar.preparation.footage.mask_names import match_masks
from gavatar.preparation.footage_source import SourceOptions, open_source
from gavatar_runtime.errors import UserError

COUNT = 12
PADDED = [f"frame_{t:04d}.png" for t in range(COUNT)]


@pytest.mark.parametrize(
    ("frames", "masks", "said"),
    [
        (PADDED, [f"frame_{t:04d}_mask.png" for t in range(COUNT)], None),
        (PADDED, [f"frame_{t:04d}.png.mask.png" for t in range(COUNT)], None),
        (PADDED, [f"alpha-frame_{t:04d}.png" for t in range(COUNT)], None),
        ([f"{t}.png" for t in range(COUNT)], [f"{t}_bgrem.png" for t in range(COUNT)], None),
        (PADDED, [f"{t:06d}_alpha_v2.png" for t in range(COUNT)], "by their numbers"),
        (PADDED, [f"m{t + 1:03d}.png" for t in range(COUNT)], "by their order"),
        (PADDED, [f"{chr(97 + t)}.png" for t in range(COUNT)], "by their order"),
    ],
)
def test_masks_are_found_by_name_number_or_order(tmp_path, frames, masks, said):
    """After smlab-niser/clean-gs #2 (NAME_bgrem), MrNeRF/LichtFeld-Studio #547 and #551 (NAME.EXT.mask)."""
    source = open_source(footage_folder(tmp_path / "f", frames, masks))
    for t, found in enumerate(source.footage[0].masks()):
        np.testing.assert_array_equal(found, mask(t))
    notes = [note for note in source.notes if "matched" in note]
    assert len(notes) == (said is not None)
    assert said is None or said in notes[0]


def test_a_mask_too_few_is_refused_and_named(tmp_path):
    folder = footage_folder(tmp_path / "f", PADDED, [f"{t:04d}_mask.png" for t in range(COUNT - 1)])
    with pytest.raises(UserError, match=r"frame_0000\.png is missing \(12 of 12 masks\).*holds 11 images"):
        open_source(folder)


def test_one_is_not_part_of_ten(tmp_path):
    for name in ("1_mask", "10_mask", "2_mask"):
        (tmp_path / f"{name}.png").touch()
    files, said = match_masks(tmp_path, ["1", "2", "10"], [0, 2])
    assert [p.name for p in files] == ["1_mask.png", "10_mask.png"]
    assert said is None


@pytest.mark.parametrize(
    "names",
    [
        [f"{t + 1}.png" for t in range(COUNT)],
        [f"frame{t + 1}_xxx.png" for t in range(COUNT)],
        [f"0000{t}.png" for t in range(COUNT)],  # 00009, 000010
    ],
)
def test_frames_are_taken_in_the_order_of_their_numbers(tmp_path, names):
    """After n00mkrad/flowframes #228, ryouchinsa/Rectlabel-support #147 and ChiWeiHsiao/DeepVO-pytorch #37."""
    source = open_source(footage_folder(tmp_path / "f", names, names))
    for t, image in enumerate(source.footage[0].images()):
        np.testing.assert_array_equal(image, frame(t))
    assert any("in the order of their numbers" in note for note in source.notes)


def test_numbers_with_zeros_say_nothing(tmp_path):
    assert open_source(footage_folder(tmp_path / "f", PADDED, PADDED)).notes == []


def test_what_systems_leave_behind_is_passed_over(tmp_path):
    """After OpenNeuroOrg/openneuro #2520."""
    folder = footage_folder(tmp_path / "f", PADDED, PADDED)
    for part in ("frames", "masks"):
        for name in ("._frame_0000.png", ".DS_Store", "Thumbs.db", "desktop.ini", ".hidden.png"):
            (folder / part / name).write_bytes(b"\0\5\x16\7")
    (folder / "._clip.mp4").write_bytes(b"\0\5\x16\7")
    (folder / "__MACOSX").mkdir()
    source = open_source(folder)
    assert (len(source.footage[0].numbers), source.notes) == (COUNT, [])
    assert len(footage_files(folder / "masks", IMAGE_SUFFIXES)) == COUNT


def test_a_frame_that_is_there_twice_is_refused(tmp_path):
    folder = footage_folder(tmp_path / "f", [*PADDED, "frame_0003.jpg"], PADDED)
    with pytest.raises(UserError, match=r"holds frame_0003\.jpg and frame_0003\.png"):
        open_source(folder)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
def test_odd_signs_in_names_of_frames(tmp_path):
    names = [f"a:b %03d [{t}] é?.png" for t in range(3)]
    source = open_source(footage_folder(tmp_path / "f", names, names))
    for t, image in enumerate(source.footage[0].images()):
        np.testing.assert_array_equal(image, frame(t))


def test_landmarks_named_by_the_option_are_read(tmp_path):
    folder = footage_folder(tmp_path / "f", PADDED, PADDED)
    (folder / "landmarks.npz").unlink()
    named = write_landmarks(tmp_path / "clip.npz", COUNT)
    source = open_source(folder, SourceOptions(landmarks=named))
    assert source.footage[0].landmarks.image[5, 0, 0] == 8
