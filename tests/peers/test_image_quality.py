"""Metrics against other people's implementations: kornia, scikit-image, scipy, lpips, efficientnet-lite-pytorch."""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest
import torch
from fetched_wheels import fetched_wheel
from torch import nn

from gavatar.images.image_quality import psnr, ssim
from gavatar.images.metrics import pa_mpjpe
from gavatar.images.perceptual import INPUT_SCALE, INPUT_SHIFT, LiteFeatures, load_weights


@pytest.fixture
def pair() -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth picture, and the same with noise and a brighter half: (2, 3, 40, 52) in [0, 1]."""
    g = torch.Generator().manual_seed(0)
    x = nn.functional.interpolate(torch.rand(2, 3, 7, 9, generator=g), size=(40, 52), mode="bicubic").clamp(0, 1)
    y = x + 0.05 * torch.randn(x.shape, generator=g)
    y[..., 20:] *= 1.1
    return x, y.clamp(0, 1)


def test_ssim_and_psnr_agree_with_kornia(pair):
    kornia = pytest.importorskip("kornia")
    x, y = pair
    theirs = kornia.metrics.ssim(x, y, 11, padding="valid").flatten(1).mean(1)
    # float32 variances by subtraction on their side: 1e-7 against C2 = 9e-4
    assert torch.allclose(ssim(x, y), theirs, atol=1e-4)
    assert torch.allclose(psnr(x, y)[0].float(), kornia.metrics.psnr(x[:1], y[:1], 1.0), atol=1e-4)  # float32 log


def test_the_ssim_gradient_agrees_with_kornia(pair):
    kornia = pytest.importorskip("kornia")
    x, y = (t.double() for t in pair)
    ours, theirs = x.clone().requires_grad_(), x.clone().requires_grad_()
    (1 - ssim(ours, y).mean()).backward()
    # kornia's loss is (1 - SSIM) / 2
    (2 * kornia.losses.ssim_loss(theirs, y, 11, padding="valid")).backward()
    # kornia adds an epsilon of 1e-12 to the denominator
    assert torch.allclose(ours.grad, theirs.grad, atol=1e-9)


def test_ssim_and_psnr_agree_with_scikit_image(pair):
    metrics = pytest.importorskip("skimage.metrics")
    for x, y in zip(*(t.double().permute(0, 2, 3, 1).numpy() for t in pair), strict=True):
        theirs = metrics.structural_similarity(
            x, y, data_range=1.0, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
        a, b = (torch.from_numpy(i).permute(2, 0, 1)[None] for i in (x, y))
        # the same window of 11 and the same crop of 5 pixels, both in float64
        assert ssim(a, b).item() == pytest.approx(theirs, abs=1e-10)
        assert psnr(a, b).item() == pytest.approx(metrics.peak_signal_noise_ratio(x, y, data_range=1.0), abs=1e-9)


def test_pa_alignment_agrees_with_scipy():
    spatial = pytest.importorskip("scipy.spatial")
    rng = np.random.default_rng(0)
    for _ in range(20):
        truth = rng.normal(size=(22, 3))
        joints = 0.7 * truth @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + 0.1 * rng.normal(size=(22, 3)) + 4
        size = np.sqrt(np.square(truth - truth.mean(0)).sum())
        a, b, _ = spatial.procrustes(truth, joints)
        theirs = 1000 * size * np.linalg.norm(a - b, axis=1).mean()
        ours = pa_mpjpe(joints[None], truth[None])[0]
        x, y = joints - joints.mean(0), truth - truth.mean(0)
        if np.linalg.det(x.T @ y) > 0:
            assert ours == pytest.approx(theirs, rel=1e-9)
        else:
            assert ours > theirs  # scipy mirrors, which no pose of a person may


def test_features_are_those_of_efficientnet_lite_pytorch():
    package = pytest.importorskip("efficientnet_lite_pytorch")
    network = package.EfficientNet.from_name("efficientnet-lite0")
    network.load_state_dict(load_weights())
    network.eval()
    # its padding is made for 224 pixels: the same as ours for every multiple of 32
    x = torch.rand(1, 3, 96, 64, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        y = network._swish(network._bn0(network._conv_stem(x * INPUT_SCALE + INPUT_SHIFT)))
        theirs = []
        for block in network._blocks:
            y = block(y)
            theirs.append(y)
        ours = LiteFeatures(5)(x)
    for feature, last_block in zip(ours, (0, 2, 4, 10, 15), strict=True):
        # batch norms are folded: roundings of values up to 60 through 47 layers
        assert (feature - theirs[last_block]).abs().max() < 1e-3


def test_the_weights_recognise_a_photograph():
    """Input scaling is right: on matplotlib's sample photograph the classifier finds the military uniform (652)."""
    matplotlib = pytest.importorskip("matplotlib")
    cv2 = pytest.importorskip("cv2")
    package = pytest.importorskip("efficientnet_lite_pytorch")
    picture = cv2.imread(f"{matplotlib.get_data_path()}/sample_data/grace_hopper.jpg")
    if picture is None:
        pytest.skip("matplotlib came without its sample data")
    picture = cv2.resize(picture[:512, :512, ::-1], (224, 224), interpolation=cv2.INTER_AREA) / 255.0
    network = package.EfficientNet.from_name("efficientnet-lite0").eval()
    network.load_state_dict(load_weights())
    image = torch.from_numpy(picture.copy()).permute(2, 0, 1)[None].float()
    with torch.no_grad():
        assert network(image * INPUT_SCALE + INPUT_SHIFT).argmax().item() == 652


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_lpips_agrees_with_the_lpips_package(net, tmp_path, tmp_path_factory, monkeypatch, pair):
    """Its own forward pass and linear weights over a random backbone, which stands in for torchvision's."""
    from gavatar.images.lpips import BACKBONES, Lpips

    # installed it would bring torchvision, whose wheels on PyPI do not load beside a torch for CPUs
    monkeypatch.syspath_prepend(fetched_wheel(tmp_path_factory, "lpips==0.1.4", "lpips/"))
    torch.manual_seed(0)
    features = _torchvision_alexnet() if net == "alex" else _torchvision_vgg16()
    torch.save({f"features.{k}": v for k, v in features.state_dict().items()}, tmp_path / BACKBONES[net].checkpoint)

    models = types.ModuleType("torchvision.models")
    models.alexnet = models.vgg16 = lambda pretrained: types.SimpleNamespace(features=features)
    torchvision = types.ModuleType("torchvision")
    torchvision.models = models
    monkeypatch.setitem(sys.modules, "torchvision", torchvision)
    monkeypatch.setitem(sys.modules, "torchvision.models", models)
    import lpips

    monkeypatch.setattr(lpips.pretrained_networks, "tv", models)
    theirs = lpips.LPIPS(net=net, verbose=False)
    for x, y in (pair, (pair[1].flip(-1), pair[0])):
        with torch.no_grad():
            expected = theirs(x, y, normalize=True).flatten()
        found = Lpips(net, backbone=str(tmp_path))(x, y)
        # float32 sums over up to 512 channels: measured 9e-8 relative, a hundredfold for other orders of summing
        assert torch.allclose(found, expected, rtol=1e-5)


def _torchvision_alexnet() -> nn.Sequential:
    """The layers of torchvision's AlexNet, in its numbering."""
    relu, pool = nn.ReLU, lambda: nn.MaxPool2d(3, 2)
    return nn.Sequential(
        nn.Conv2d(3, 64, 11, 4, 2), relu(), pool(), nn.Conv2d(64, 192, 5, padding=2), relu(), pool(),
        nn.Conv2d(192, 384, 3, padding=1), relu(), nn.Conv2d(384, 256, 3, padding=1), relu(),
        nn.Conv2d(256, 256, 3, padding=1), relu(), pool(),
    )  # fmt: skip


def _torchvision_vgg16() -> nn.Sequential:
    """The layers of torchvision's VGG16, in its numbering."""
    layers, channels = [], 3
    for width in (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512, 0, 512, 512, 512, 0):
        if width == 0:
            layers.append(nn.MaxPool2d(2, 2))
        else:
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU()]
            channels = width
    return nn.Sequential(*layers)
