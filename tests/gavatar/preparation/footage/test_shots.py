"""Cuts and other people are found in footage that has them, and in no footage that has not."""

import functools
from itertools import permutations
from pathlib import Path

import cv2
import numpy as np
import places
import pytest
from demo_pictures import picture, true_mask

from gavatar.preparation.detect import Detector
from gavatar.preparation.footage.film import Film
from gavatar.preparation.footage.listing import IMAGE_SUFFIXES, footage_files
from gavatar.preparation.footage.shots import Wardrobe, find_cuts, longest
from gavatar.preparation.footage_source import SourceOptions, open_source

CAPTURES = places.SHARED / "captures"
HERE = pytest.mark.skipif(not CAPTURES.is_dir(), reason="../shared/captures is not here")
UNCUT = ["studio_demo/images/cam0", "studio_male/images/cam0", "studio_dress/images/cam0", "real_turn/video.mp4",
         "real_p2s/videos/cam01.mp4", "real_p2s/videos/cam02.mp4", "real_p2s/videos/cam03.mp4",
         "real_p2s/videos/cam04.mp4"]  # fmt: skip


def film_of(name: str) -> Film:
    path = CAPTURES / name
    return Film.of("cam0", path if path.is_file() else footage_files(path, IMAGE_SUFFIXES))


@functools.cache
def small(name: str) -> list[np.ndarray]:
    """All frames, 128x128: what they are compared at."""
    film = film_of(name)
    assert film.notes == []
    return [cv2.resize(image, (128, 128), interpolation=cv2.INTER_AREA) for image in film.images(film.order)]


@HERE
@pytest.mark.parametrize("name", UNCUT)
def test_uncut_footage_has_no_cut(name):
    for step in (1, 6):
        assert find_cuts(small(name)[::step]) == []


@HERE
def test_a_cut_between_any_two_scenes_is_found():
    """After facebookresearch/sam2 #334. Studio captures share their background and count as one scene."""
    scenes = [name for name in UNCUT if not name.startswith(("studio_male", "studio_dress"))]
    parts = {name: small(name)[:48:6] for name in scenes}
    for a, b in permutations(scenes, 2):
        assert find_cuts([*parts[a][:5], *parts[b][:7]]) == [5], (a, b)
    back_and_forth = [image for k in range(3) for name in scenes[:2] for image in parts[name][2 * k : 2 * k + 2]]
    assert find_cuts(back_and_forth) == [2, 4, 6, 8, 10]  # after mikel-brostrom/boxmot #1410


def test_light_that_jumps_is_no_cut():
    bright = [cv2.convertScaleAbs(picture(t), alpha=1.0 if t < 5 else 0.5) for t in range(10)]
    assert find_cuts(bright) == []
    flash = [cv2.convertScaleAbs(picture(t), alpha=1.0, beta=90 * (t == 4)) for t in range(10)]
    assert find_cuts(flash) == []


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_images_have_no_cut(count):
    assert find_cuts([picture(0)] * count) == []
    wardrobe = Wardrobe()
    for _ in range(count):
        wardrobe.add(picture(0), 255 * true_mask(0).astype(np.uint8))
    assert wardrobe.changes() == []


def test_the_longest_piece_is_taken():
    assert longest([], 7) == slice(0, 7)
    assert longest([2, 7], 9) == slice(2, 7)
    assert longest([5], 10) == slice(0, 5)


# ---------------------------------------------------------------- the person


def masked(name: str, step: int) -> list[tuple[np.ndarray, np.ndarray]]:
    frames = footage_files(CAPTURES / name / ("frames" if name == "real_turn" else "images/cam0"), IMAGE_SUFFIXES)
    masks = CAPTURES / name / ("masks" if name == "real_turn" else "masks/cam0")
    return [(cv2.imread(str(p)), cv2.imread(str(masks / f"{p.stem}.png"), cv2.IMREAD_GRAYSCALE))
            for p in frames[::step]]  # fmt: skip


@HERE
def test_another_person_is_seen_and_the_same_one_never_is():
    people = {name: masked(name, 6) for name in ("studio_demo", "studio_dress", "real_turn")}
    for seen in [*people.values(), masked("studio_male", 6)]:
        wardrobe = Wardrobe()
        for image, mask in seen:
            wardrobe.add(image, mask)
        assert wardrobe.changes() == []
    for a, b in permutations(people, 2):
        wardrobe = Wardrobe()
        for image, mask in [*people[a][:5], *people[b][:4]]:
            wardrobe.add(image, mask)
        assert wardrobe.changes() == [5], (a, b)


@HERE
def test_a_second_person_who_takes_over_is_noted_and_left_out(tmp_path):
    """After MotrixLab/SMPLest-X #24: one background, somebody else from frame 8 on."""
    for t, path in enumerate([*_files("studio_demo")[:16:2], *_files("studio_dress")[:10:2]]):
        (tmp_path / "frames").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "frames" / f"{t}.png"), cv2.resize(cv2.imread(str(path)), (256, 256)))
    source = open_source(tmp_path, SourceOptions(detector=Detector(tmp_path / "work", progress=False), fps=10.0))
    assert source.footage[0].numbers.tolist() == list(range(8))
    assert len(source.footage[0].landmarks) == len(source.footage[0].mask_files) == 8
    (note,) = (note for note in source.notes if "another person" in note)
    assert note.startswith("cam0: another person is followed at frame 8: only the longest part is taken, `frames=0:8`")


def _files(name: str) -> list[Path]:
    return footage_files(CAPTURES / name / "images/cam0", IMAGE_SUFFIXES)


@HERE
def test_a_cut_is_noted_and_the_longest_shot_taken(tmp_path):
    film = film_of("real_turn/video.mp4")
    other = [cv2.resize(image, film.size) for image in film_of("real_p2s/videos/cam01.mp4").images(np.arange(0, 16, 4))]
    writer = cv2.VideoWriter(str(tmp_path / "clip.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, film.size)
    for image in [*other, *film.images(np.arange(0, 12, 2))]:
        writer.write(image)
    writer.release()
    (tmp_path / "clip.npz").write_bytes(b"of something else")
    options = SourceOptions(detector=Detector(tmp_path / "work", progress=False))
    source = open_source(tmp_path / "clip.mp4", options)
    assert source.footage[0].numbers.tolist() == list(range(4, 10))
    assert any(
        "the scene changes at frame 4 (0.40 s): only the longest part is taken, `frames=4:10`" in note
        for note in source.notes
    )
    assert any("clip.npz lies beside the video and is not read" in note for note in source.notes)
