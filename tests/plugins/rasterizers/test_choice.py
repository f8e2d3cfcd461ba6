"""`auto` takes the best that is there, and says which."""

from __future__ import annotations

import logging

import pytest
import torch
from rasterizer_bench import TARGETS, Target
from splat_scenes import as_torch, random_scene, simple_camera

from gavatar.registry import RASTERIZERS
from gavatar_plugins.rasterizers import auto
from gavatar_runtime.errors import UserError


def messages(caplog, dtype=torch.float32, device="cpu", calls: int = 3) -> list[str]:
    """What `auto` logs over some calls."""
    rasterizer, scene = RASTERIZERS.build("auto"), as_torch(random_scene(0, 10), dtype)
    scene = type(scene)(*(v if v is None else v.to(device) for v in vars(scene).values()))
    with caplog.at_level(logging.INFO, auto.log.name):
        for _ in range(calls):
            rasterizer(scene, simple_camera(8, 8))
    return [record.message for record in caplog.records if record.name == auto.log.name]


@pytest.fixture
def without(monkeypatch):
    """without("native"): that rasterizer cannot be built."""

    def hide(*names):
        build = RASTERIZERS.build

        def refuse(name, *arguments):
            if name in names:
                raise UserError(f"no {name} here")
            return build(name, *arguments)

        monkeypatch.setattr(RASTERIZERS, "build", refuse)

    return hide


def test_the_kernel_draws_float32_on_the_cpu(caplog):
    Target("native", "cpu").build()
    assert messages(caplog) == ["rasterizer auto: native"]


def test_torch_draws_other_dtypes(caplog):
    assert messages(caplog, torch.float64) == ["rasterizer auto: torch"]


def test_torch_draws_where_there_is_no_kernel_and_the_reason_is_told(caplog, without):
    without("native", "gsplat")
    assert messages(caplog) == ["rasterizer auto: not native, because no native here", "rasterizer auto: torch"]


@pytest.mark.parametrize("there", [True, False])
def test_gsplat_draws_on_cuda_where_it_is_there(caplog, without, there):
    if not torch.cuda.is_available():
        pytest.skip("torch sees no CUDA device")
    if there:
        Target("gsplat", "cuda").build()
        assert messages(caplog, device="cuda") == ["rasterizer auto: gsplat"]
    else:
        without("gsplat")
        assert messages(caplog, device="cuda")[-1] == "rasterizer auto: torch"


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("target", TARGETS, ids=str)
def test_half_precision_is_refused_in_a_sentence(target, dtype):
    rasterizer = target.build()
    with pytest.raises(UserError, match=str(dtype)):
        rasterizer(target.tensors(random_scene(0, 20), dtype), simple_camera(16, 12))


def test_what_the_list_calls_missing_cannot_be_built_for_that_reason():
    for component in RASTERIZERS:
        if component.missing():
            with pytest.raises(UserError) as refusal:
                RASTERIZERS.build(component.name)
            assert component.missing() in str(refusal.value)
    gsplat = RASTERIZERS["gsplat"]
    assert torch.cuda.is_available() or gsplat.missing()
