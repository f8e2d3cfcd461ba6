"""Masks before a room that is known: it is learnt, explains what is seen, makes outlines better, and is taken out."""

import cv2
import numpy as np
import onnx
import pytest

from gavatar.images.unmixing import without_background
from gavatar.preparation.draw import iou
from gavatar.preparation.plate.background import learn_background, read_background
from gavatar.preparation.plate.fused import Colours, Fuser
from gavatar.preparation.plate.mending import MaskMaker
from gavatar.preparation.plate.user_network import MattingNetwork
from gavatar_runtime.errors import UserError

SIDE = 192


def room(seed=0):
    """A wall with coarse stains."""
    rng = np.random.default_rng(seed)
    stains = cv2.resize(
        rng.uniform(90, 210, (12, 12, 3)).astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_CUBIC
    )
    return np.clip(stains, 60, 230)


def footage(count=12, noise=2.0, empty=None, seed=1):
    """Somebody red, an ellipse with soft edges, who walks before the room and throws a shadow: images, true alpha,
    coarse masks whose outline is up to 3 pixels off."""
    rng, empty = np.random.default_rng(seed), room() if empty is None else empty
    images, alphas, coarse = [], [], []
    for t in range(count):
        centre = (50 + 8 * t, 100)
        alpha = np.zeros((4 * SIDE, 4 * SIDE), np.float32)
        cv2.ellipse(alpha, tuple(4 * c for c in centre), (88, 280), 0, 0, 360, 1, -1)
        alpha = cv2.resize(alpha, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
        shade = 1 - 0.3 * np.roll(cv2.GaussianBlur(alpha, (0, 0), 3), 9, 1)[..., None]
        picture = alpha[..., None] * np.float32([40, 30, 190]) + (1 - alpha[..., None]) * shade * empty
        images.append(np.uint8(np.clip(picture + noise * rng.normal(size=picture.shape), 0, 255)))
        alphas.append(alpha)
        off = np.zeros((SIDE, SIDE), np.uint8)
        cv2.ellipse(off, (centre[0] + 1, centre[1] - 1), (24, 69), 0, 0, 360, 255, -1)
        coarse.append(off)
    return images, alphas, coarse


def fuser(images, coarse, background):
    colours = Colours()
    for image, mask in zip(images, coarse, strict=True):
        colours.add(image, mask)
    return Fuser(background, colours)


def test_the_room_is_learnt_from_what_the_person_uncovers():
    images, _, coarse = footage()
    found = learn_background(images, coarse)
    assert found.explains
    off = np.abs(found.picture.astype(float) - room())[found.known > 0]
    assert np.median(off) < 2 * 2.0  # grey levels: the noise of a pixel; the median of its frames has less
    assert found.known.mean() > 0.9


def test_outlines_and_alpha_are_better_before_a_known_room():
    images, alphas, coarse = footage()
    made = fuser(images, coarse, learn_background(images, coarse))
    for image, alpha, mask in zip(images, alphas, coarse, strict=True):
        found = made(image, mask)
        assert iou(found > 127, alpha > 0.5) > 0.96
        assert iou(mask > 127, alpha > 0.5) < 0.92
        assert np.abs(found / 255.0 - alpha).mean() < 0.5 * np.abs(mask / 255.0 - alpha).mean()


def test_a_person_who_wears_the_rooms_colour_is_not_pierced():
    wall = np.full((SIDE, SIDE, 3), (40, 30, 190), np.float32)  # the colour of their clothes
    images, _, coarse = footage(empty=wall)
    made = fuser(images, coarse, learn_background(images, coarse))
    assert iou(made(images[5], coarse[5]) > 127, coarse[5] > 127) > 0.8  # a rim of 2 % may go, no more


def test_a_room_that_changes_is_not_taken_for_one():
    images, _, coarse = footage(count=12)
    flicker = [np.uint8(np.clip(i + 60.0 * (t % 2), 0, 255)) for t, i in enumerate(images)]
    found = learn_background(flicker, coarse)
    assert found is None or not found.explains
    assert learn_background(images[:4], coarse[:4]) is None


def test_the_wall_is_taken_out_of_the_rim():
    (image, *_), (alpha, *_), _ = footage(noise=0)
    pictures = [np.ascontiguousarray(p[..., ::-1], np.float32) / 255 for p in (image, room())]
    pure = without_background(pictures[0], alpha, pictures[1])
    truth = alpha[..., None] * np.float32([190, 30, 40]) / 255
    rim = (alpha > 0.05) & (alpha < 0.95)
    mixed = np.abs(pictures[0] * alpha[..., None] - truth)[rim].mean()
    assert np.abs(pure - truth)[rim].mean() < 0.35 * mixed  # measured 0.2: the shadow's light is a guess


def files_of(masks, folder):
    files = [folder / f"{t:06d}.png" for t in range(len(masks))]
    for file, mask in zip(files, masks, strict=True):
        cv2.imwrite(str(file), mask)
    return files


def test_masks_are_rewritten_only_before_a_camera_that_stands_still(tmp_path):
    images, alphas, coarse = footage()
    files = files_of(coarse, tmp_path)
    maker = MaskMaker(None, None, progress=False)
    assert maker("cam0", lambda: images, files, 0.02).notes == []
    assert (cv2.imread(str(files[3]), 0) == coarse[3]).all()
    made = maker("cam0", lambda: images, files, 0.0005)
    assert "background learnt from the footage" in made.notes[0]
    assert made.background.shape == images[0].shape
    assert iou(cv2.imread(str(files[3]), 0) > 127, alphas[3] > 0.5) > 0.96


def test_a_clean_plate_is_read_and_one_of_another_room_refused(tmp_path):
    images, _, coarse = footage()
    paths = {name: tmp_path / f"{name}.png" for name in ("same", "other", "small")}
    cv2.imwrite(str(paths["same"]), room())
    cv2.imwrite(str(paths["other"]), room(seed=5))
    cv2.imwrite(str(paths["small"]), room()[:50])
    size = (SIDE, SIDE)
    assert read_background(paths["same"], size, images, coarse).known.all()
    for name, said in (("other", "is not the background of this footage"), ("small", "is 192x50 pixels")):
        with pytest.raises(UserError, match=said):
            read_background(paths[name], size, images, coarse)
    with pytest.raises(UserError, match="leave `background` out"):
        MaskMaker(paths["same"], None, progress=False)("cam0", lambda: images, files_of(coarse, tmp_path), 0.05)


def redness(path, sides=("height", "width"), channels=3):
    """A matting network in MODNet's form: how much red there is beyond green."""
    tensors = [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, count, *sides])
               for name, count in (("input", channels), ("output", 1))]  # fmt: skip
    weight = np.float32([1, -1] + [0] * (channels - 2)).reshape(1, channels, 1, 1)
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Conv", ["input", "w"], ["output"])], "redness", tensors[:1], tensors[1:],
        [onnx.numpy_helper.from_array(weight, "w")],
    )  # fmt: skip
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=8), str(path))
    return path


@pytest.mark.parametrize("sides", [("height", "width"), (256, 256)])
def test_a_network_of_the_users_makes_the_masks(tmp_path, sides):
    images, alphas, coarse = footage(empty=np.full((SIDE, SIDE, 3), 128, np.float32))
    network = MattingNetwork(redness(tmp_path / "mine.onnx", sides))
    assert iou(network(images[4], coarse[4]) > 127, alphas[4] > 0.5) > 0.97
    files = files_of(coarse, tmp_path)
    made = MaskMaker(None, tmp_path / "mine.onnx", progress=False)("cam0", lambda: images, files, None)
    assert made.notes == ["cam0: masks by mine.onnx"]


def test_a_network_of_another_form_is_one_sentence(tmp_path):
    with pytest.raises(UserError, match="a matting network takes one input"):
        MattingNetwork(redness(tmp_path / "other.onnx", channels=4))
    (tmp_path / "none.onnx").write_bytes(b"nothing")
    with pytest.raises(UserError, match="cannot be read as an ONNX network"):
        MattingNetwork(tmp_path / "none.onnx")
