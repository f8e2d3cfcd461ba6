"""Training the decoder in bfloat16: where it is native, with float32 at its ends, the same but for rounding."""

from __future__ import annotations

import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import check, compose_config
from gavatar.registry import DECODERS, load_plugins
from gavatar.training import precision
from gavatar.training.run import train
from gavatar_runtime.errors import UserError

CPU = torch.device("cpu")


def decoder(name: str = "mlp"):
    load_plugins()
    torch.manual_seed(0)
    made = DECODERS.build(name, {}, in_channels=16)
    for head in made.heads.values():
        torch.nn.init.normal_(head[-1].weight, std=0.05)
    return made


def decode(made, features, mixed: bool):
    uv, spacing = torch.rand(len(features), 2), torch.full((len(features),), 0.01)
    with torch.autocast("cpu", torch.bfloat16, enabled=mixed):
        return made(features, uv, spacing)


def test_decoding_in_bfloat16_is_decoding_but_for_rounding():
    made = decoder()
    features = torch.randn(500, 16)
    results = {}
    for mixed in (False, True):
        made.zero_grad()
        f = features.clone().requires_grad_()
        out = decode(made, f, mixed)
        assert out.offsets.dtype == out.colors.dtype == out.scales.dtype == torch.float32
        # a loss whose gradients agree in sign over the points, as a picture's do over neighbours
        (out.colors.square().mean() + out.offsets.square().mean() + out.scales.sum()).backward()
        gradient = torch.cat([f.grad.flatten(), *(p.grad.flatten() for p in made.parameters())])
        assert gradient.dtype == torch.float32
        results[mixed] = out, gradient
    (exact, g), (rounded, h) = results[False], results[True]
    # each of nine layers rounds its input, weights and output to 2^-9, some 27 independent errors of 2e-3 together
    for name in ("colors", "offsets", "scales"):
        a, b = getattr(exact, name), getattr(rounded, name)
        assert (a - b).norm() < 27**0.5 * 2**-9 * 2 * a.norm(), name
    assert torch.nn.functional.cosine_similarity(g, h, dim=0) > 0.99


def test_auto_takes_bfloat16_only_where_it_is_native_and_the_decoder_is_able(monkeypatch):
    load_plugins()
    able, unable = {"name": "mlp", "anisotropic": True}, {"name": "upstream"}
    for native in (True, False):
        monkeypatch.setattr(precision, "multiplies_bfloat16", lambda device, native=native: native)
        assert precision.mixed("auto", able, CPU) is native
        assert precision.mixed("bfloat16", able, CPU)
        assert not precision.mixed("float32", able, CPU)
        assert not precision.mixed("auto", unable, CPU)
    with pytest.raises(UserError, match="decoder 'upstream' trains in float32 only"):
        precision.mixed("bfloat16", unable, CPU)


def test_what_native_means_on_a_cpu(monkeypatch):
    if not hasattr(torch.cpu, "get_capabilities"):
        assert not precision.multiplies_bfloat16(CPU)
        return
    for flags, expected in (({"avx512_bf16": True}, True), ({"amx_bf16": True}, True), ({"avx512_f": True}, False)):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda flags=flags: flags)
        assert precision.multiplies_bfloat16(CPU) is expected


def test_an_unknown_precision_is_found_before_any_work():
    with pytest.raises(UserError, match="auto, float32 or bfloat16, not 'half'"):
        check(compose_config(["capture=x", "precision=half"]))


def test_training_in_bfloat16_learns_the_same_and_is_evaluated_in_float32(tmp_path):
    capture = write_tiny_capture(tmp_path / "tiny")
    same = [
        "background=white",
        "stage1.batch=6",
        "stage1.levels=[{until:1.0,gaussians:2850,image:0.25}]",
        "stage2.steps=0",
    ]
    last = {}
    for kind in ("float32", "bfloat16"):
        out = tmp_path / kind
        overrides = [f"capture={capture}", f"out={out}", *SMALL, *same, "stage1.steps=60", "stage1.lr_decoder=0.01"]
        trainer = train(compose_config([*overrides, f"precision={kind}"]), out)
        losses = [entry["losses"]["l1"] for entry in trainer.record.history]
        assert losses[-1] < 0.7 * losses[0]
        last[kind] = losses[-1]
        trainer.scene.avatar.eval()
        layer = []
        trainer.scene.avatar.decoder.layers[1].register_forward_hook(lambda *a, seen=layer: seen.append(a[2].dtype))
        trainer.scene.avatar.attributes()
        assert layer == [torch.float32]
    # two trainings whose gradients differ by rounding; the loss fell to a third or less of where it began
    assert last["bfloat16"] < 1.15 * last["float32"]
