"""Every registered loss keeps the contract of gavatar.losses; the composition; each loss' own promises."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

from gavatar.image_quality import SSIM_C1, SSIM_C2, psnr, ssim
from gavatar.losses import LossComposer, LossConfig, LossInputs, MotionState
from gavatar.lpips import BACKBONES, Lpips
from gavatar.perceptual import cheaper_pair, perceptual_distance
from gavatar.registry import LOSSES, load_plugins
from gavatar.rotations import matrix_from_axis_angle, rotation_vector_from_matrix
from gavatar_runtime.errors import UserError

load_plugins()
NAMES = LOSSES.names()
# An option that a loss cannot do without, by name
WEIGHTS_OF = {"lpips": ("backbone", "linear")}
PAPER_WEIGHTS = {
    "l1": 0.8, "ssim": 0.2, "perceptual": 0.2, "lpips": 0.2, "feature": 1, "pose_feature": 1, "offset": 10, "scale": 1
}  # fmt: skip


@pytest.fixture(scope="session")
def lpips_files(tmp_path_factory):
    """net -> (backbone, linear): files of the right layout with random numbers; the real ones cannot be shipped."""
    folder, files = tmp_path_factory.mktemp("lpips"), {}
    generator = torch.Generator().manual_seed(1)
    for net, description in BACKBONES.items():
        backbone, linear, channels, number = {}, {}, 3, 0
        for i, (pooled, convolutions) in enumerate(description.slices):
            number += pooled
            for width, kernel, _, _ in convolutions:
                weight = torch.randn(width, channels, kernel, kernel, generator=generator)
                backbone[f"features.{number}.weight"] = weight / (kernel * math.sqrt(channels))
                backbone[f"features.{number}.bias"] = torch.randn(width, generator=generator) * 0.1
                channels, number = width, number + 2
            linear[f"lin{i}.model.1.weight"] = torch.rand(1, channels, 1, 1, generator=generator)
        files[net] = (folder / description.checkpoint, folder / f"{net}.pth")
        torch.save(backbone, files[net][0])
        torch.save(linear, files[net][1])
    return files


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.fixture
def build(lpips_files):
    def build(name: str, **options):
        if name in WEIGHTS_OF:
            net = options.get("net", "alex")
            options = {**dict(zip(WEIGHTS_OF[name], map(str, lpips_files[net]), strict=True)), **options}
        return LOSSES.build(name, options)

    return build


def motion(axis_angle, trans=None, fps=30.0, times=None, initial=None) -> MotionState:
    """A MotionState from (T, J, 3) axis-angle."""
    axis_angle = torch.as_tensor(axis_angle)
    rotations = matrix_from_axis_angle(axis_angle)
    trans = torch.zeros(len(axis_angle), 3, dtype=rotations.dtype) if trans is None else torch.as_tensor(trans)
    times = torch.arange(len(axis_angle), dtype=rotations.dtype) / fps if times is None else torch.as_tensor(times)
    return MotionState(
        rotations=rotations,
        rotations_initial=rotations.detach().clone() if initial is None else matrix_from_axis_angle(initial),
        trans=trans,
        trans_initial=trans.detach().clone(),
        frame_times=times.to(rotations.dtype),
    )


FIELDS = ("render", "alpha", "features", "pose_features", "offsets", "scales")


def perfect(batch=1, height=40, width=33, dtype=torch.float32) -> LossInputs:
    """Inputs at which every loss is at its minimum, as leaves that ask for gradient."""
    generator = torch.Generator().manual_seed(0)
    target = torch.rand(batch, 3, height, width, generator=generator, dtype=dtype)
    mask = torch.rand(batch, height, width, generator=generator, dtype=dtype)
    leaf = {
        "render": target.clone(), "alpha": mask.clone(), "features": torch.zeros(1, 4, 8, 8, dtype=dtype),
        "pose_features": torch.zeros(batch, 4, 8, 8, dtype=dtype), "offsets": torch.zeros(batch, 9, 3, dtype=dtype),
        "scales": torch.zeros(1, 9, dtype=dtype),
    }  # fmt: skip
    still = motion(torch.zeros(4, 5, 3, dtype=dtype))
    state = dataclasses.replace(still, rotations=still.rotations.requires_grad_(), trans=still.trans.requires_grad_())
    return LossInputs(
        target=target, mask=mask, motion=state, progress=0.5, **{k: v.requires_grad_() for k, v in leaf.items()}
    )


def leaves(inputs: LossInputs) -> list[torch.Tensor]:
    return [getattr(inputs, f) for f in FIELDS] + [inputs.motion.rotations, inputs.motion.trans]


def disturbed(inputs: LossInputs, amount: float = 0.2, seed: int = 3) -> LossInputs:
    """The same inputs away from the minimum; images stay in [0, 1], scales positive, rotations are rotations."""
    g = torch.Generator().manual_seed(seed)

    def noise(x):
        return amount * torch.randn(x.shape, generator=g, dtype=x.dtype)

    changed = {f: (getattr(inputs, f) + noise(getattr(inputs, f))).detach() for f in FIELDS}
    changed["render"], changed["alpha"] = changed["render"].clamp(0, 1), changed["alpha"].clamp(0, 1)
    changed["scales"] = changed["scales"].abs()
    m = inputs.motion
    turned = m.rotations.detach() @ matrix_from_axis_angle(noise(m.rotations[..., 0].detach()))
    moved = (m.trans + noise(m.trans)).detach()
    m = dataclasses.replace(m, rotations=turned.requires_grad_(), trans=moved.requires_grad_())
    return dataclasses.replace(inputs, motion=m, **{k: v.requires_grad_() for k, v in changed.items()})


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
    fields = ("render", "target", "alpha", "mask", "pose_features", "offsets")
    two = dataclasses.replace(one, **{f: torch.cat([getattr(one, f)] * 2) for f in fields})
    loss = build(name)
    # summation in another order
    assert loss(two).item() == pytest.approx(loss(one).item(), rel=1e-5)


# ---------------------------------------------------------------- composition


def test_the_total_is_the_weighted_sum_of_unweighted_values():
    inputs = disturbed(perfect())
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
    inputs = disturbed(perfect())
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


# ---------------------------------------------------------------- SSIM


def wang(x: np.ndarray, y: np.ndarray, size: int = 11) -> float:
    """Equation 13 of Wang et al. 2004, window by window, on (H, W) float64."""
    k = np.exp(-((np.arange(size) - size // 2) ** 2) / (2 * 1.5**2))
    w = np.outer(k, k) / k.sum() ** 2
    values = []
    for i in range(x.shape[0] - size + 1):
        for j in range(x.shape[1] - size + 1):
            a, b = x[i : i + size, j : j + size], y[i : i + size, j : j + size]
            ma, mb = (w * a).sum(), (w * b).sum()
            va, vb, cov = (w * (a - ma) ** 2).sum(), (w * (b - mb) ** 2).sum(), (w * (a - ma) * (b - mb)).sum()
            top = (2 * ma * mb + SSIM_C1) * (2 * cov + SSIM_C2)
            values.append(top / ((ma**2 + mb**2 + SSIM_C1) * (va + vb + SSIM_C2)))
    return float(np.mean(values))


@pytest.mark.parametrize("size", [(11, 11), (13, 20)])
def test_ssim_is_wangs_formula(size):
    rng = np.random.default_rng(0)
    x, y = rng.random(size), rng.random(size)
    for a, b in ((x, y), (x, 1 - x), (x, np.clip(x + 0.05 * y, 0, 1))):
        found = ssim(torch.from_numpy(a)[None, None], torch.from_numpy(b)[None, None]).item()
        assert found == pytest.approx(wang(a, b), abs=1e-12)  # both float64


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("contrast", [0.0, 1e-4, 1e-2])
def test_ssim_of_nearly_constant_images_survives_float32(level, contrast):
    g = torch.Generator().manual_seed(0)
    x = level + contrast * torch.randn(1, 1, 24, 24, generator=g, dtype=torch.float64)
    y = level + 1e-3 + contrast * torch.randn(1, 1, 24, 24, generator=g, dtype=torch.float64)
    # E[x^2] - E[x]^2 in float32 is off by 1e-7, which against C2 = 9e-4 would be 1e-4
    assert ssim(x.float(), y.float()).item() == pytest.approx(wang(x[0, 0].numpy(), y[0, 0].numpy()), abs=2e-6)


def test_ssim_of_a_person_on_white_survives_float32():
    x = torch.ones(1, 3, 48, 48, dtype=torch.float64)
    x[:, :, 12:40, 20:30] = 0.3
    y = x.clone()
    y[:, :, 13:41, 20:30] = 0.32
    assert ssim(x.float(), y.float()).item() == pytest.approx(ssim(x, y).item(), abs=2e-6)


def test_ssim_of_identical_images_is_one_and_of_half_precision_finite():
    x = torch.rand(2, 3, 20, 20)
    assert torch.equal(ssim(x, x), torch.ones(2))
    y = torch.rand(2, 3, 20, 20)
    # bfloat16 keeps 8 bits of the pixels: 0.004 each
    assert torch.allclose(ssim(x.bfloat16(), y.bfloat16()), ssim(x, y), atol=0.02)


def test_ssim_scores_each_image_by_itself_and_is_symmetric():
    x, y = torch.rand(3, 3, 16, 19), torch.rand(3, 3, 16, 19)
    each = torch.cat([ssim(a[None], b[None]) for a, b in zip(x, y, strict=True)])
    assert torch.allclose(ssim(x, y), each, atol=1e-6)
    assert torch.allclose(ssim(x, y), ssim(y, x), atol=1e-6)


def test_ssim_has_the_right_gradient_to_second_order():
    x = torch.rand(1, 1, 6, 4, dtype=torch.float64, requires_grad=True)
    y = torch.rand(1, 1, 6, 4, dtype=torch.float64)
    assert torch.autograd.gradcheck(ssim, (x, y))
    assert torch.autograd.gradgradcheck(lambda a: ssim(a, y), (x,))


# ---------------------------------------------------------------- perceptual distances


def test_perceptual_distance_grows_with_the_damage():
    x = torch.nn.functional.interpolate(torch.rand(1, 3, 8, 8), size=64, mode="bicubic").clamp(0, 1)
    noise = torch.randn(1, 3, 64, 64)
    distances = [perceptual_distance((x + a * noise).clamp(0, 1), x).item() for a in (0, 0.02, 0.05, 0.2)]
    assert distances == sorted(distances)
    assert distances[0] == 0
    assert 0.05 < distances[-1] < 2


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_perceptual_gradient_of_a_flat_image_is_finite(value):
    x = torch.full((1, 3, 32, 32), value, requires_grad=True)
    perceptual_distance(x, torch.rand(1, 3, 32, 32), 5).sum().backward()
    assert torch.isfinite(x.grad).all()
    assert x.grad.abs().max() < 10  # a vanishing feature vector does not blow it up


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_lpips_gradient_of_a_flat_image_is_finite(lpips_files, net):
    x = torch.full((1, 3, 32, 32), 0.5, requires_grad=True)
    Lpips(net, *map(str, lpips_files[net]))(x, torch.rand(1, 3, 32, 32)).sum().backward()
    assert torch.isfinite(x.grad).all()


def test_the_reference_gets_no_gradient(lpips_files):
    x, y = torch.rand(1, 3, 32, 32, requires_grad=True), torch.rand(1, 3, 32, 32, requires_grad=True)
    (perceptual_distance(x, y, 2) + Lpips("alex", *map(str, lpips_files["alex"]))(x, y)).sum().backward()
    assert y.grad is None


def test_a_crop_lies_on_the_person_and_repeats_with_the_seed():
    image = torch.arange(64.0 * 48).view(1, 1, 64, 48).expand(1, 3, 64, 48)
    mask = torch.zeros(1, 64, 48)
    mask[:, 30:60, 5:40] = 1
    corners = set()
    for seed in range(20):
        a, b = cheaper_pair(image, image, mask, crop=16, max_size=0, seed=seed)
        assert a.shape == (1, 3, 16, 16)
        assert torch.equal(a, b)
        assert torch.equal(a, cheaper_pair(image, image, mask, 16, 0, seed)[0])
        row, column = divmod(int(a[0, 0, 0, 0]), 48)
        assert 30 <= row <= 44
        assert 5 <= column <= 24
        corners.add((row, column))
    assert len(corners) > 10


@pytest.mark.parametrize("mask", [torch.zeros(1, 20, 30), torch.ones(1, 20, 30), torch.eye(20, 30)[None]])
def test_a_crop_larger_than_the_image_or_off_the_person_stays_inside(mask):
    image = torch.rand(1, 3, 20, 30)
    assert cheaper_pair(image, image, mask, crop=25, max_size=0, seed=1)[0].shape == (1, 3, 20, 25)
    assert cheaper_pair(image, image, mask, crop=64, max_size=0, seed=1)[0] is image


def test_max_size_averages_down_and_never_up():
    image = torch.rand(2, 3, 40, 20)
    small, _ = cheaper_pair(image, image, image[:, 0], 0, 10, 0)
    assert small.shape == (2, 3, 10, 5)
    assert torch.allclose(small, image.unflatten(3, (5, 4)).unflatten(2, (10, 4)).mean((3, 5)), atol=1e-6)
    assert cheaper_pair(image, image, image[:, 0], 0, 100, 0)[0] is image


def test_missing_lpips_weights_are_said_in_one_sentence(tmp_path, monkeypatch, lpips_files):
    monkeypatch.delenv("GAVATAR_LPIPS_BACKBONE", raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    with pytest.raises(UserError, match=r"alexnet-owt-7be5be79\.pth.*GAVATAR_LPIPS_BACKBONE"):
        Lpips()
    with pytest.raises(UserError, match="there is no file"):
        Lpips(backbone=str(tmp_path / "absent.pth"))
    with pytest.raises(UserError, match="did you mean 'vgg'"):
        Lpips("vgg16")
    backbone, linear = lpips_files["alex"]
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match="pip install --no-deps lpips"):
        Lpips(backbone=str(backbone))
    with pytest.raises(UserError, match="not the weights file"):
        Lpips("alex", str(lpips_files["vgg"][0]), str(linear))
    (tmp_path / "broken.pth").write_bytes(b"not a checkpoint")
    with pytest.raises(UserError, match="cannot be read"):
        Lpips("alex", str(tmp_path / "broken.pth"), str(linear))
    monkeypatch.setenv("GAVATAR_LPIPS_BACKBONE", str(backbone.parent))  # a folder will do
    assert Lpips("alex", linear=str(linear)).title == "LPIPS 0.1 (AlexNet)"


# ---------------------------------------------------------------- motion


def smoothness(state: MotionState, **options) -> float | None:
    inputs = LossInputs(render=None, target=None, alpha=None, mask=None, motion=state)
    value = LOSSES.build("motion_smoothness", options)(inputs)
    return None if value is None else value.item()


def swing(times: np.ndarray) -> np.ndarray:
    """(T, 2, 3) a joint that swings to and fro and one that turns steadily, at any time in seconds."""
    poses = np.zeros((len(times), 2, 3))
    poses[:, 0, 0] = 0.5 * np.sin(2 * np.pi * times)
    poses[:, 1, 1] = 2.0 * times
    return poses


def test_smoothness_is_the_squared_acceleration_at_every_frame_rate():
    # mean over one period of (0.5 (2 pi)^2 sin)^2 is half the squared amplitude; the second joint adds nothing
    expected = (0.5 * (2 * np.pi) ** 2 / 30**2) ** 2 / 2 / 2
    for fps in (24, 30, 60, 120):
        times = np.arange(4 * fps + 1) / fps
        # a second difference loses (2 pi / fps)^2 / 12 of the amplitude: at 24 fps 1.2 % of its square
        assert smoothness(motion(swing(times), fps=fps)) == pytest.approx(expected, rel=0.015)


def test_smoothness_bears_gaps_of_held_out_frames():
    times = np.arange(121) / 30
    kept = np.array([i for i in range(121) if i % 5 != 2])
    whole = smoothness(motion(swing(times), times=times))
    gappy = smoothness(motion(swing(times[kept]), times=times[kept]))
    assert gappy == pytest.approx(whole, rel=0.05)  # coarser differences at the gaps
    steady = np.stack([2.0 * times[kept], 0 * times[kept], 0 * times[kept]], -1)[:, None]
    walking = np.stack([1.5 * times[kept], 0 * times[kept], 0 * times[kept]], -1)
    # steady turning and walking are free however frames are spaced: rounding of float64
    assert smoothness(motion(steady, trans=walking, times=times[kept])) < 1e-20


def test_smoothness_leaves_out_what_lies_across_a_long_gap():
    times = np.concatenate([np.arange(10), np.arange(300, 310)]) / 30
    poses = np.zeros((20, 1, 3))
    poses[10:, 0, 2] = 1.0  # it moved while nobody looked
    assert smoothness(motion(poses, times=times)) == 0
    assert smoothness(motion(poses[:3], times=np.array([0.0, 5, 10]))) is None
    assert smoothness(motion(poses[:2])) is None
    assert smoothness(motion(poses[:1])) is None


def test_smoothness_sees_jitter_and_survives_flips_and_repeated_times():
    rng = np.random.default_rng(0)
    times = np.arange(60) / 30
    calm, jittered = swing(times), swing(times) + 0.03 * rng.normal(size=(60, 2, 3))
    assert smoothness(motion(jittered)) > 20 * smoothness(motion(calm))
    flipped = calm.copy()
    flipped[30:, 1, 1] += np.pi
    angle = torch.tensor(flipped, requires_grad=True)
    state = motion(angle, times=np.sort(np.concatenate([times[:59], times[10:11]])))
    value = LOSSES.build("motion_smoothness")(LossInputs(render=None, target=None, alpha=None, mask=None, motion=state))
    value.backward()
    assert value.item() > 0.1
    assert torch.isfinite(angle.grad).all()


@pytest.mark.parametrize("wrap", [2 * np.pi, -2 * np.pi])
def test_motion_losses_do_not_see_the_axis_angle_wrap(wrap):
    poses = np.zeros((5, 1, 3))
    poses[:, 0, 1] = np.linspace(3.0, 3.3, 5)  # across pi
    wrapped = poses.copy()
    wrapped[3:, 0, 1] -= wrap
    assert smoothness(motion(wrapped)) == pytest.approx(smoothness(motion(poses)), abs=1e-12)


def test_the_prior_is_the_squared_angle_when_small_and_flat_at_pi():
    zero = torch.zeros(3, 2, 3, dtype=torch.float64)
    for angle, expected in ((1e-3, 1e-6), (1.0, 2 - 2 * math.cos(1.0)), (math.pi, 4.0)):
        turned = (zero + torch.tensor([angle, 0.0, 0.0])).requires_grad_()
        value = LOSSES.build("motion_prior")(
            LossInputs(render=None, target=None, alpha=None, mask=None, motion=motion(turned, initial=zero))
        )
        # the chord is short of the arc by angle^2 / 12
        assert value.item() == pytest.approx(expected, rel=1e-6)
        value.backward()
        assert torch.isfinite(turned.grad).all()


def test_the_prior_counts_translation_in_square_metres():
    still = motion(torch.zeros(4, 2, 3))
    state = dataclasses.replace(still, trans=still.trans + torch.tensor([0.3, 0.0, 0.4]))
    inputs = LossInputs(render=None, target=None, alpha=None, mask=None, motion=state)
    assert LOSSES.build("motion_prior", {"translation": 2.0})(inputs).item() == pytest.approx(2 * 0.25)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 1.0, 3.0, math.pi - 1e-5])
def test_rotation_vectors_invert_rodrigues(angle, dtype):
    axes = torch.randn(50, 3, dtype=dtype, generator=torch.Generator().manual_seed(0))
    vectors = angle * axes / axes.norm(dim=1, keepdim=True)
    found = rotation_vector_from_matrix(matrix_from_axis_angle(vectors))
    # a few roundings of matrix entries of size one
    assert (found - vectors).abs().max() < 20 * torch.finfo(dtype).eps


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.0, -0.8]])
def test_rotation_vectors_at_pi_give_the_same_rotation(axis):
    matrix = matrix_from_axis_angle(math.pi * torch.tensor(axis, dtype=torch.float64)).requires_grad_()
    vector = rotation_vector_from_matrix(matrix)
    assert vector.norm().item() == pytest.approx(math.pi)
    assert torch.allclose(matrix_from_axis_angle(vector), matrix, atol=1e-14)  # float64 rounding
    vector.sum().backward()
    assert torch.isfinite(matrix.grad).all()


def test_rotation_vectors_have_the_right_gradient():
    def there_and_back(vector):
        return rotation_vector_from_matrix(matrix_from_axis_angle(vector))

    for angle in (0.0, 1e-4, 0.3, 2.0, 3.1):
        x = torch.tensor([[angle, 0.2 * angle, -0.1 * angle]], dtype=torch.float64, requires_grad=True)
        jacobian = torch.autograd.functional.jacobian(
            lambda v: rotation_vector_from_matrix(matrix_from_axis_angle(v)), x
        )
        # the inverse of Rodrigues' formula composed with it is the identity below pi
        if x.norm() < math.pi:
            assert torch.allclose(jacobian[0, :, 0], torch.eye(3, dtype=torch.float64), atol=1e-9)
        assert torch.isfinite(jacobian).all()


def test_psnr_of_a_known_error():
    x = torch.zeros(2, 3, 4, 4)
    y = torch.stack([torch.full((3, 4, 4), 0.1), torch.zeros(3, 4, 4)])
    assert psnr(x, y)[0].item() == pytest.approx(20, abs=1e-6)
    assert psnr(x, y)[1].item() == math.inf
