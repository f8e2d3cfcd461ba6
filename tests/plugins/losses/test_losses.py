"""Every registered loss keeps the contract of gavatar.losses; the composition."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from loss_inputs import FIELDS, disturbed, leaves, perfect, write_lpips_weights

from gavatar.losses import LossComposer, LossConfig, LossInputs
from gavatar.registry import LOSSES, load_plugins
from gavatar_runtime.errors import UserError

load_plugins()
NAMES = LOSSES.names()
# An option that a loss cannot do without, by name
WEIGHTS_OF = {"lpips": ("backbone", "linear")}
PAPER_WEIGHTS = {
    "l1": 0.8, "ssim": 0.2, "perceptual": 0.2, "lpips": 0.2, "feature": 1, "pose_feature": 1, "offset": 10, "scale": 1
}  # fmt: skip


@pytest.fixture(scope="module")
def lpips_files(tmp_path_factory):
    return write_lpips_weights(tmp_path_factory.mktemp("lpips"))


@pytest.fixture
def build(lpips_files):
    def build(name: str, **options):
        if name in WEIGHTS_OF:
            net = options.get("net", "alex")
            options = {**dict(zip(WEIGHTS_OF[name], map(str, lpips_files[net]), strict=True)), **options}
        return LOSSES.build(name, options)

    return build


# ---------------------------------------------------------------- the contract


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("batch", "height", "width"), [(1, 40, 33), (2, 16, 16), (1, 1, 1), (1, 2, 11)])
def test_a_perfect_match_is_the_minimum_with_finite_gradient(build, name, dtype, batch, height, width):
    inputs = perfect(batch, height, width, dtype)
    value = build(name)(inputs)
    assert value.shape == ()
    assert value.dtype == dtype
    # a few roundings of numbers near one
    assert 0 <= value.item() <= 10 * torch.finfo(dtype).eps
    value.backward()
    gradients = [x.grad for x in leaves(inputs) if x.grad is not None]
    assert gradients, "a loss must depend on something that is trained"
    assert all(torch.isfinite(g).all() for g in gradients)


@pytest.mark.parametrize("name", NAMES)
def test_a_mismatch_costs_and_its_gradient_is_finite(build, name):
    inputs = disturbed(perfect(2))
    value = build(name)(inputs)
    assert math.isfinite(value.item())
    assert value.item() > 1e-4
    value.backward()
    assert any(x.grad is not None and x.grad.abs().sum() > 0 for x in leaves(inputs))
    assert all(torch.isfinite(x.grad).all() for x in leaves(inputs) if x.grad is not None)


@pytest.mark.parametrize("name", NAMES)
def test_the_gradient_is_the_slope(build, name):
    inputs = disturbed(perfect(1, 33, 35, torch.float64))
    loss = build(name)
    directions = [
        torch.randn(x.shape, dtype=x.dtype, generator=torch.Generator().manual_seed(5)) for x in leaves(inputs)
    ]

    def at(step: float) -> LossInputs:
        moved = [(x + step * d).detach() for x, d in zip(leaves(inputs), directions, strict=True)]
        state = dataclasses.replace(inputs.motion, rotations=moved[-2], trans=moved[-1])
        fields = dict(zip(FIELDS, moved, strict=False))
        fields["features"].requires_grad_()
        return dataclasses.replace(inputs, motion=state, **fields)

    gradients = torch.autograd.grad(loss(inputs), leaves(inputs), allow_unused=True)
    slope = sum((g * d).sum() for g, d in zip(gradients, directions, strict=True) if g is not None).item()
    # a step so short that hardly any |x|, ReLU or maximum switches in it; float64 leaves 1e-16 / 1e-7
    measured = ((loss(at(1e-7)) - loss(at(-1e-7))) / 2e-7).item()
    assert slope == pytest.approx(measured, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_the_default_weight_is_the_papers(name):
    config = LOSSES.options(name)
    assert isinstance(config, LossConfig)
    assert config.weight > 0, "a loss that is named must count"
    if name in PAPER_WEIGHTS:
        assert config.weight == PAPER_WEIGHTS[name]


@pytest.mark.parametrize("name", NAMES)
def test_values_are_means_and_do_not_grow_with_the_batch(build, name):
    one = disturbed(perfect(1))
    fields = ("render", "target", "alpha", "mask", "pose_features", "pose_detail", "offsets")
    two = dataclasses.replace(one, **{f: torch.cat([getattr(one, f)] * 2) for f in fields})
    loss = build(name)
    # summation in another order
    assert loss(two).item() == pytest.approx(loss(one).item(), rel=1e-5)


# ---------------------------------------------------------------- composition


def test_the_total_is_the_weighted_sum_of_unweighted_values():
    inputs = disturbed(perfect(batch=2))
    total, values = LossComposer({"l1": 0.5, "offset": {"weight": 3}, "mask": {"weight": 2.0, "norm": "l2"}})(inputs)
    assert set(values) == {"l1", "offset", "mask"}
    assert values["l1"] == pytest.approx((inputs.render - inputs.target).abs().mean().item())
    assert total.item() == pytest.approx(0.5 * values["l1"] + 3 * values["offset"] + 2 * values["mask"])
    total.backward()
    assert inputs.render.grad is not None


def test_options_from_hydra_are_a_mapping_too():
    omegaconf = pytest.importorskip("omegaconf")
    composer = LossComposer(omegaconf.OmegaConf.create({"l1": 1, "scale": {"norm": "l1"}}))
    assert composer.losses["scale"].config.norm == "l1"
    assert composer.losses["scale"].config.weight == 1.0


def test_a_loss_of_weight_zero_is_never_built():
    # lpips raises when built without its weights
    assert list(LossComposer({"l1": 1.0, "lpips": {"weight": 0.0, "backbone": "/nowhere"}}).losses) == ["l1"]


def test_losses_abstain_where_their_inputs_are_absent():
    inputs = LossInputs(
        render=torch.rand(1, 3, 4, 4, requires_grad=True), target=torch.rand(1, 3, 4, 4),
        alpha=torch.rand(1, 4, 4), mask=torch.rand(1, 4, 4), features=torch.zeros(1, 2, 2, 2),
    )  # fmt: skip
    names = ("feature", "pose_feature", "offset", "scale", "motion_prior", "motion_smoothness")
    total, values = LossComposer(dict.fromkeys(("l1", *names), 1.0))(inputs)
    assert set(values) == {"l1"}, "frozen features count as absent"
    assert total.item() == pytest.approx(values["l1"])
    total, values = LossComposer(dict.fromkeys(names, 1.0))(inputs)
    assert values == {}
    assert total.item() == 0


def test_a_loss_starts_and_decays_with_progress():
    inputs = disturbed(perfect(batch=2))
    composer = LossComposer({"l1": {"weight": 1.0, "start": 0.15}, "offset": {"weight": 10, "decay": 0.5}})
    assert set(composer(dataclasses.replace(inputs, progress=0.1))[1]) == {"offset"}
    total, values = composer(dataclasses.replace(inputs, progress=0.3))
    assert total.item() == pytest.approx(values["l1"] + 10 * 0.5**3 * values["offset"])


@pytest.mark.parametrize(
    ("losses", "message"),
    [
        ({"sim": 1.0}, r"unknown loss 'sim'.*did you mean 'ssim'"),
        ({"ssim": {"wieght": 1.0}}, r"no option 'wieght'.*did you mean 'weight'"),
        ({"l1": -1.0}, r"losses\.l1\.weight: must be a number at least 0"),
        ({"l1": math.nan}, r"losses\.l1\.weight"),
        ({"l1": "much"}, r"losses\.l1\.weight.*'much'"),
        ({"l1": True}, r"losses\.l1\.weight"),
        ({"l1": {"start": 2}}, r"losses\.l1\.start: must be a number between 0 and 1"),
        ({"l1": {"decay_every": 0}}, r"losses\.l1\.decay_every"),
        ({"mask": {"norm": "l3"}}, r"losses\.mask\.norm: must be one of l1, l2"),
        ({"perceptual": {"depth": 9}}, r"losses\.perceptual\.depth"),
        ({"perceptual": {"crop": -4}}, r"losses\.perceptual\.crop"),
        ({"l1": 0}, r"no loss has a weight above zero"),
        ({}, r"no loss has a weight above zero"),
    ],
)
def test_a_wrong_composition_is_a_users_mistake(losses, message):
    with pytest.raises(UserError, match=message):
        LossComposer(losses)
