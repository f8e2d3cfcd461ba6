"""gavatar-prepare with the user's own body model: SMPL, SMPL-H, SMPL-X in the official files' layouts."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
from commands import run_prepare
from known_people import QUICK, cameras_around, joint_error, plausible_motion, seen_by
from official_bodies import dressed_free_body, write_npz

from gavatar.assemble import build_body, capture_on_body
from gavatar.body.official_files import FAMILIES, read_body
from gavatar.capture.capture import read_capture
from gavatar.capture.check import check_capture
from gavatar.preparation.fit import BodyFitter, FitOptions
from gavatar.preparation.landmarks import INDEX, landmark_rows
from gavatar.registry import load_plugins
from gavatar_plugins.bodies.free import load_free_body

pytestmark = pytest.mark.usefixtures("one_thread")
FILES = {"smpl": "SMPL_FEMALE.npz", "smplh": "SMPLH_FEMALE.npz", "smplx": "SMPLX_FEMALE.npz"}


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """A folder with a model of each family; SMPL-X's with 300 + 100 coefficients as downloaded, of which those beyond
    the tenth are large, so that a fit that used them would show."""
    folder, rng = tmp_path_factory.mktemp("models"), np.random.default_rng(2)
    for family, name in FILES.items():
        arrays = dressed_free_body(family)
        if family == "smplx":
            shape, expression = np.split(arrays["shapedirs"], [10], 2)
            more = rng.normal(0, 0.05, (len(shape), 3, 290)).astype(np.float32)
            expression = np.pad(expression, [(0, 0), (0, 0), (0, 90)])
            arrays["shapedirs"] = np.concatenate([shape, more, expression], 2)
        write_npz(folder / name, arrays)
    return folder


def model(models, family):
    return read_body(FAMILIES[family], models / FILES[family])


def test_an_smplx_body_of_300_coefficients_is_fitted_by_its_first_ten(models):
    body = model(models, "smplx")
    assert (body.num_betas, body.num_joints) == (300, 55)
    free = load_free_body()
    truth, (camera,) = plausible_motion(free), cameras_around(1)  # the same body in its own 52 joints
    fit = BodyFitter(body, [camera], [seen_by(camera, truth)], None, 10.0, QUICK).run(progress=False)
    assert fit.betas.shape == (10,)
    assert (fit.poses[:, 22:] == 0).all()
    # of the free body test_body_fit's tolerance is 0.08 m; pose blendshapes (8 mm) move the skin, not the joints
    assert joint_error(body, fit, truth) < 0.08


def test_fewer_coefficients_are_fitted_when_asked_for(models):
    truth, (camera,) = plausible_motion(load_free_body(), frames=2, turn=0.2), cameras_around(1)
    options = dataclasses.replace(QUICK, steps=(5, 5, 5), num_betas=3)
    fit = BodyFitter(model(models, "smplh"), [camera], [seen_by(camera, truth)], None, 10.0, options).run(False)
    assert fit.betas.shape == (3,)


@pytest.mark.parametrize("family", FILES)
def test_landmarks_sit_where_they_do_on_the_same_mesh(models, family):
    points, expected = (landmark_rows(d)[0] @ d.v_template for d in (model(models, family), load_free_body()))
    hand = [k for name, k in INDEX.items() if any(part in name for part in ("pinky", "index", "thumb"))]
    hand = [k for k in hand if "foot" not in list(INDEX)[k]]
    rest = np.setdiff1d(np.arange(33), hand)
    np.testing.assert_allclose(points[rest], expected[rest], atol=1e-6)  # float32 templates
    # SMPL has one joint for all knuckles: half a palm away at most, the thumb's tip a thumb's length
    limit = 0.12 if family == "smpl" else 1e-6
    assert np.linalg.norm(points[hand] - expected[hand], axis=-1).max() < limit


@pytest.mark.parametrize("family", ["smplh", "smplx"])
def test_hands_in_a_landmarks_file_close_the_fingers_of_official_bodies(models, family, footage, tmp_path):
    body = model(models, family)
    with np.load(footage / "landmarks.npz") as file:
        arrays = dict(file)
    # a fist before the picture's plane: every finger folded back on itself, 30 pixels from wrist to knuckle
    fist = np.zeros((3, 21, 3))
    for f in range(5):
        x = 8.0 * (f - 2)
        fist[:, 4 * f + 1 : 4 * f + 5, :2] = [[x, -15], [x, -22], [x, -15], [x, -8]] if f == 0 else [
            [x, -30], [x, -38], [x, -30], [x, -22]]  # fmt: skip
    for side in ("left", "right"):
        wrist = arrays["image"][:, INDEX[f"{side}_wrist"], :2]
        hand = fist / 4 * ([1, 1, 1] if side == "left" else [-1, 1, 1])  # pixels of this small picture
        hand[..., :2] += wrist[:, None]
        hand[..., 2] = 1
        arrays[f"{side}_hand"] = hand
    size = np.array([640, 853]) / [96, 128]  # the points of a picture large enough for fingers to count
    arrays["image"][..., :2] *= size
    for side in ("left", "right"):
        arrays[f"{side}_hand"][..., :2] *= size
    arrays["width"], arrays["height"] = 640, 853
    for kind in ("frames", "masks"):
        for path in sorted((footage / kind).iterdir()):
            picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(path), cv2.resize(picture, (640, 853)))
    np.savez(footage / "landmarks.npz", **arrays)
    out = tmp_path / "capture"
    options = ("--body", family, "--gender", "female", "--body-path", models, "--quiet", "--no-preview")
    assert run_prepare(footage, "-o", out, *options) == 0
    poses = read_capture(out).motion.poses
    names = list(body.joint_names)
    middle = np.linalg.norm(poses[:, [names.index(f"{side}_middle2") for side in ("left", "right")]], axis=-1)
    assert (middle > 0.8).all()  # radians; relaxed it is 0.5, and folded back on itself 2


@pytest.mark.parametrize("family", FILES)
def test_the_command_fits_official_bodies(models, family, footage, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(FitOptions.__init__, "__defaults__", ((5, 5, 5), *FitOptions.__init__.__defaults__[1:]))
    out = tmp_path / "capture"
    assert (
        run_prepare(footage, "-o", out, "--body", family, "--gender", "female", "--body-path", models, "--quiet") == 0
    )
    assert "IoU" in capsys.readouterr().out
    info = json.loads((out / "capture.json").read_text())
    assert (info["body_model"], info["gender"]) == ("smplh-official" if family == "smplh" else family, "female")
    capture = read_capture(out)
    assert capture.motion.betas.shape == (10,)
    # training chooses the same body by itself
    monkeypatch.setenv("GAVATAR_BODY_MODELS", str(models))
    load_plugins()
    body = build_body({"name": "auto"}, capture)
    assert body.data.name == family
    placed = capture_on_body(capture, body.data)
    np.testing.assert_array_equal(placed.motion.poses[:, :22], capture.motion.poses[:, :22])
    assert check_capture(out).faults == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--body", "smplx"], "no neutral SMPL-X model was found"),
        (["--gender", "female"], "--body-path and --gender are for the official bodies"),
        (["--body", "auto", "--gender", "female"], "body 'auto' is chosen by a capture"),
        (["--body", "smpll"], "smpll"),
        (["--num-betas", 0], "--num-betas 0 is out of range"),
    ],
)
def test_a_body_that_cannot_be_had_is_one_sentence(options, message, footage, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("GAVATAR_BODY_MODELS", raising=False)
    assert run_prepare(footage, "-o", tmp_path / "out", "--quiet", *options) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
