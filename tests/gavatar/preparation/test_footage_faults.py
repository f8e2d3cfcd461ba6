"""What footage gets wrong and training makes up for: masks cut too wide, drifting exposure, sides never filmed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from stopped_runs import stopped_after
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import check, compose_config
from gavatar.images.image_quality import ssim
from gavatar.storage import load_tensors, write_image
from gavatar.training.footage import Footage, edge_known
from gavatar.training.remedies.evidence import blending_weights, view_weights
from gavatar.training.remedies.exposure import Exposure
from gavatar.training.remedies.filling import fill_unseen, harmonic
from gavatar.training.remedies.matte import matted
from gavatar.training.run import open_run, train
from gavatar.training.trainer import Trainer
from gavatar_runtime.errors import UserError

STATIC = [*(o for o in SMALL if not o.startswith("encoder")), "encoder=none", "motion.guard=false"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


def config(capture, out, *overrides):
    return compose_config([f"capture={capture}", f"out={out}", *STATIC, *overrides])


@pytest.fixture
def trainer(capture, tmp_path):
    made = Trainer(check(config(capture, tmp_path / "run")), tmp_path / "run")
    made.avatar.sample_at(made.built.surface(64))
    return made


def disc(side: int, radius: float) -> np.ndarray:
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    return np.where(np.hypot(x, y) < radius, 255, 0).astype(np.uint8)


def test_only_the_inner_border_of_a_mask_is_not_believed():
    mask = disc(64, 20)
    unknown = edge_known(mask, 4) == 0
    assert not unknown[mask == 0].any()
    inner = disc(64, 15) > 0  # further than 4 pixels from anything outside
    assert not unknown[inner].any()
    assert unknown[(disc(64, 16.5) == 0) & (mask > 0)].all()


@pytest.mark.parametrize("fill", [0, 255])
def test_a_mask_without_a_border_is_believed_everywhere(fill):
    assert (edge_known(np.full((5, 7), fill, np.uint8), 3) == 255).all()


def test_a_person_cut_off_by_the_image_has_no_border_there():
    mask = np.zeros((20, 20), np.uint8)
    mask[5:, 5:15] = 255  # the feet are below the image
    known = edge_known(mask, 2) == 255
    assert known[-1, 8:12].all()
    assert not known[6, 5:15].any()


def test_a_mask_of_one_pixel_is_all_border():
    mask = np.zeros((5, 5), np.uint8)
    mask[2, 2] = 255
    assert (edge_known(mask, 1) == 0).sum() == 1


def test_no_loss_moves_a_pixel_that_is_not_believed():
    known = np.full((1, 32, 32), 255, np.uint8)
    known[0, 10:20, 10:14] = 0
    data = Footage([], [], torch.zeros(1, 3, 32, 32), torch.zeros(1, 32, 32), torch.from_numpy(known))
    torch.manual_seed(0)
    render, target = torch.rand(1, 3, 32, 32, requires_grad=True), torch.rand(1, 3, 32, 32)
    alpha, mask = torch.rand(1, 32, 32, requires_grad=True), torch.rand(1, 32, 32)
    to, image, to_mask, image_alpha = data.believed([0], target, mask, render, alpha)
    loss = (to - image).abs().mean() + (1 - ssim(image, to).mean()) + (to_mask - image_alpha).square().mean()
    loss.backward()
    for gradient in (render.grad[0].abs().amax(0), alpha.grad[0].abs()):
        assert (gradient[torch.from_numpy(known[0]) == 0] == 0).all()
        assert (gradient[torch.from_numpy(known[0]) == 255] > 0).float().mean() > 0.9
    # where all is known nothing is touched
    whole = Footage([], [], data.color, data.alpha)
    assert whole.believed([0], target, mask, render, alpha) == (target, render, mask, alpha)


def test_the_believed_part_follows_image_scale_and_crop(capture, tmp_path):
    made = Trainer(check(config(capture, tmp_path / "run", "mask_edge=8")), tmp_path / "run")
    data = made.footage_at(0.25)
    assert data.known.shape == data.alpha.shape
    band = data.known < 128
    assert band.any()
    assert (data.alpha[band] > 0).all()
    assert float(band.float().sum() / (data.alpha > 127).float().sum()) < 0.9  # there is a person left


def wide(side: int = 96, radius: float = 30, by: float = 3):
    """A red disc before a wall of two greys, its true alpha, and a mask cut too wide."""
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    true = np.clip(radius - np.hypot(x, y) + 0.5, 0, 1).astype(np.float32)
    wall = np.where(x < 0, 0.1, 0.3)[..., None] * np.ones(3)
    person = np.array([0.8, 0.3, 0.25]) + 0.1 * np.sin(x / 4)[..., None]
    image = (true[..., None] * person + (1 - true[..., None]) * wall).astype(np.float32)
    return image, true, (np.hypot(x, y) < radius + by).astype(np.float32)


def test_a_matte_finds_the_border_that_the_mask_missed():
    image, true, mask = wide()
    color, alpha = matted(image, mask, 6)
    assert np.abs(mask - true).mean() > 10 * np.abs(alpha - true).mean()
    assert np.abs(alpha - true).max() < 0.5  # the pixels that are a mixture, to half of one
    assert (alpha[mask == 0] == 0).all()
    assert (color <= alpha[..., None] + 1e-6).all()
    rim = (mask > 0) & (true == 0)
    assert color[rim].max() < 0.1  # no wall is left in it: as colour of the person it would be a dark rim


def test_a_matte_leaves_what_colours_do_not_tell():
    image, _, mask = wide()
    plain = np.full_like(image, 0.5)
    color, alpha = matted(plain, mask, 6)
    np.testing.assert_array_equal(alpha, mask)
    np.testing.assert_allclose(color, plain * mask[..., None])


@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_a_matte_of_a_mask_without_a_border_changes_nothing(fill):
    image, mask = np.random.default_rng(0).random((6, 5, 3), np.float32), np.full((6, 5), fill, np.float32)
    color, alpha = matted(image, mask, 3)
    np.testing.assert_array_equal(alpha, mask)
    np.testing.assert_array_equal(color, image * fill)


@pytest.mark.parametrize("value", ["-1", "nan", "inf"])
def test_an_impossible_edge_is_refused(capture, value):
    with pytest.raises(UserError, match="mask_edge"):
        check(config(capture, "unused", f"mask_edge={value}"))


def test_gains_have_mean_one_and_leave_the_background_alone():
    exposure = Exposure(4)
    render, alpha = torch.rand(2, 3, 5, 5), torch.zeros(2, 5, 5)
    background = torch.tensor([0.2, 0.4, 0.6])
    alpha[:, :2] = 1.0
    render[:, :, 2:] = background[:, None, None]
    torch.testing.assert_close(exposure([0, 2], render, alpha, background), render)  # starts at one
    with torch.no_grad():
        exposure.log_gain.normal_()
    torch.testing.assert_close(exposure.gains([0, 1, 2, 3]).log().mean(0), torch.zeros(3), atol=1e-6, rtol=0)
    changed = exposure([0, 2], render, alpha, background)
    torch.testing.assert_close(changed[:, :, 2:], render[:, :, 2:])
    torch.testing.assert_close(changed[:, :, :2], exposure.gains([0, 2])[:, :, None, None] * render[:, :, :2])


def test_planted_exposures_are_found(capture, tmp_path):
    gains = np.exp([0.3, -0.2, 0.1, -0.3, 0.15, -0.05])
    flickering = write_tiny_capture(tmp_path / "flicker")
    for frame, gain in enumerate(gains):
        path = flickering / "images" / "cam0" / f"{frame:06d}.jpg"
        image, mask = cv2.imread(str(path)), cv2.imread(str(flickering / "masks" / "cam0" / f"{frame:06d}.png"))
        person = np.minimum(image * gain, 255)
        write_image(path, (np.where(mask > 127, person, image) / 255)[..., ::-1])
    steps = [
        "stage1.steps=60",
        "stage1.batch=3",
        "stage1.levels=[{until:1.0,uv:64,image:0.125}]",
        "motion.enabled=false",
    ]
    made = train(config(flickering, tmp_path / "run", "exposure=true", *steps), tmp_path / "run")
    found = made.exposure.gains(list(range(6))).detach().numpy().mean(1)
    expected = gains / np.exp(np.log(gains).mean())
    # frames are of different sides of a person, lit differently, and bright pixels are clipped: the order and most of
    # the range must come out
    assert np.corrcoef(np.log(found), np.log(expected))[0, 1] > 0.9
    assert open_run(tmp_path / "run").avatar  # evaluation knows no gains


def test_exposures_are_resumed_too(capture, tmp_path):
    whole = train(config(capture, tmp_path / "whole", "exposure=true"), tmp_path / "whole")
    assert whole.exposure.log_gain.abs().max() > 0

    with stopped_after():
        train(config(capture, tmp_path / "parts", "exposure=true"), tmp_path / "parts")
    resumed = train(config(capture, tmp_path / "parts", "exposure=true"), tmp_path / "parts")
    assert torch.equal(whole.exposure.log_gain, resumed.exposure.log_gain)
    states = [load_tensors(tmp_path / name / "stage1.pt")["avatar"] for name in ("whole", "parts")]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])


def test_blending_weights_add_up_to_the_silhouette(trainer):
    weight = view_weights(trainer, 2, 0.25)
    data = trainer.footage_at(0.25)
    with torch.no_grad():
        (gaussians,) = trainer.avatar.pose(trainer.avatar.attributes(), *trainer.motion([data.views[2].frame]))
        drawn = trainer.rasterize(gaussians, data.cameras[2], torch.zeros(3))
    _, mask = data.batch([2], torch.zeros(3), torch.device("cpu"))
    # float32 sums over a few thousand pixels
    assert float(weight.sum()) == pytest.approx(float((drawn.alpha * mask[0]).sum()), rel=1e-4)
    assert (weight >= 0).all()
    # what one camera does not see has no weight
    assert (weight == 0).float().mean() > 0.2
    total = blending_weights(trainer, 0.25)
    assert (total >= weight).all()
    assert (total == 0).float().mean() < (weight == 0).float().mean()


def test_the_continuation_is_smooth_between_what_is_known():
    points = np.stack([np.linspace(0, 1, 41), np.zeros(41), np.zeros(41)], -1)
    values = np.stack([np.linspace(0, 1, 41), np.full(41, 0.3)], -1)
    known = (points[:, 0] < 0.25) | (points[:, 0] > 0.75)
    garbage = np.where(known[:, None], values, 9.0)
    filled = harmonic(points, garbage, known)
    np.testing.assert_allclose(filled[known], values[known])
    np.testing.assert_allclose(filled[:, 1], 0.3, atol=1e-3)  # a constant is continued as itself
    assert (np.diff(filled[:, 0]) > 0).all()
    # eight neighbours reach over the border of what is known by four points, a tenth of the line
    assert np.abs(filled[:, 0] - values[:, 0]).max() < 0.1


def test_a_part_without_any_known_neighbour_gets_the_mean():
    points = np.concatenate([np.random.default_rng(0).random((30, 3)), 100 + np.random.default_rng(1).random((20, 3))])
    known = np.arange(50) < 30
    values = np.arange(50.0)[:, None]
    np.testing.assert_allclose(harmonic(points, values, known)[30:], 14.5, atol=1e-3)


@pytest.mark.parametrize("known", [np.zeros(4, bool), np.ones(4, bool)])
def test_nothing_is_continued_where_all_or_nothing_is_known(known):
    values = np.arange(4.0)[:, None]
    assert harmonic(np.eye(4, 3), values, known) is values


def test_unseen_points_take_on_their_surroundings_and_seen_ones_stay_exactly(capture, tmp_path):
    front = check(config(capture, tmp_path / "run", "stage1.levels=[{until:1.0,uv:64,image:0.25}]"))
    made = Trainer(front, tmp_path / "run")
    made.views = made.views[:1]  # one side of the person
    made.frames = [made.views[0].frame]
    made.avatar.sample_at(made.built.surface(64))
    with torch.no_grad():
        made.avatar.features.normal_()  # noise, as it is left where no image tells otherwise
        made.avatar.decoder.heads["color"][2].weight.normal_(std=0.5)
        before = made.avatar.attributes()
    seen = blending_weights(made, 0.25) >= 1
    report = fill_unseen(made)
    with torch.no_grad():
        after = made.avatar.attributes()
    assert report["points"] == report["filled"] == int((~seen).sum()) > 500
    for name in ("colors", "offsets", "scales"):
        assert torch.equal(getattr(before, name)[0, seen], getattr(after, name)[0, seen])
    known = seen.numpy()
    target = torch.from_numpy(harmonic(made.avatar.surface.points, before.colors[0].numpy(), known))[~seen]
    error = [(out.colors[0, ~seen] - target).abs().mean() for out in (before, after)]
    assert error[1] < 0.3 * error[0]


def test_a_capture_seen_from_all_sides_is_not_changed(trainer, monkeypatch):
    import gavatar.training.remedies.filling as unseen

    monkeypatch.setattr(
        unseen, "blending_weights", lambda trainer, scale: torch.full((len(trainer.avatar.surface),), 9.0)
    )
    before = trainer.avatar.features.clone()
    assert fill_unseen(trainer)["points"] == 0
    assert torch.equal(before, trainer.avatar.features)
