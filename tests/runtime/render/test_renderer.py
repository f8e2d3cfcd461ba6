"""A renderer does by itself what has to be done for an avatar to be drawn as it was trained."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gavatar_runtime import native_library
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import write_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.pixels import to_bytes
from gavatar_runtime.render.rasterizers import Rasterizer
from gavatar_runtime.render.rasterizers.numpy import NumpyRasterizer
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.render.widening import as_trained
from gavatar_runtime.values.camera import Camera, look_at
from gavatar_runtime.values.gaussians import Rendering

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import make_bundle, manifest, members

needs_kernel = pytest.mark.skipif(not native_library.available()[0], reason=native_library.available()[1])


def camera(size: int = 48) -> Camera:
    """The whole person from three metres in front."""
    return Camera(size, size, 1.2 * size, 1.2 * size, size / 2, size / 2, look_at((0, 1, 3), (0, 1, 0)))


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("renderer") / "tester.gavatar")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A bundle whose manifest says how it was trained: antialiased, and on coarse pixels."""
    path = tmp_path_factory.mktemp("renderer") / "trained.gavatar"
    how = {"rasterizer": {"antialiased": True, "backface": 0.3}, "training": {"pixel_m": 0.05}}
    write_bundle(path, dataclasses.replace(manifest(), **how), members())
    return path


def rest(avatar) -> np.ndarray:
    return np.zeros((len(avatar.joint_names), 3), np.float32)


class Kept(Rasterizer):
    """Draws nothing and keeps what it was given."""

    def __init__(self, normals: bool):
        self._normals, self.given, self.stage_seconds = normals, [], {"blend": 0.5}

    @property
    def wants_normals(self) -> bool:
        return self._normals

    def render(self, gaussians, camera, background):
        self.given.append((gaussians, camera, background))
        color = np.full((camera.height, camera.width, 3), background, np.float32)
        return Rendering(color, color[..., 0], color[..., 0])


@pytest.mark.parametrize("wanted", [False, True])
def test_normals_come_where_the_rasterizer_wants_them_and_only_there(bundle, wanted):
    avatar, rasterizer = Avatar(bundle), Kept(wanted)
    Renderer(avatar, rasterizer).draw(rest(avatar), camera())
    assert (rasterizer.given[0][0].normals is not None) == wanted


def test_two_renderers_of_one_avatar_do_not_disturb_each_other(bundle):
    avatar, plain, culling = Avatar(bundle), Kept(False), Kept(True)
    renderers = [Renderer(avatar, rasterizer) for rasterizer in (plain, culling)]
    for renderer in renderers:
        renderer.draw(rest(avatar), camera())
    assert plain.given[0][0].normals is None
    assert culling.given[0][0].normals is not None


def test_gaussians_are_widened_for_pixels_finer_than_those_of_training(trained):
    avatar = Avatar(trained)
    fine, coarse = camera(256), camera(8)
    as_decoded = avatar.gaussians(rest(avatar)).scales.copy()
    drawn = Renderer(avatar, Kept(False)).gaussians(rest(avatar), camera=fine)
    np.testing.assert_array_equal(drawn.scales, as_trained(avatar.gaussians(rest(avatar)), fine, 0.05).scales)
    assert (drawn.scales > as_decoded).all()
    drawn = Renderer(avatar, Kept(False)).gaussians(rest(avatar), camera=coarse)
    np.testing.assert_array_equal(drawn.scales, as_decoded)


@pytest.mark.parametrize("name", ["numpy", pytest.param("native", marks=needs_kernel)])
def test_a_rasterizer_by_name_has_the_switches_that_the_avatar_was_trained_with(trained, bundle, name):
    assert Renderer(Avatar(trained), name).rasterizer.config.antialiased
    assert not Renderer(Avatar(bundle), name).rasterizer.config.antialiased
    assert not Renderer(Avatar(trained), name, options={"antialiased": False}).rasterizer.config.antialiased


@needs_kernel
def test_threads_and_switches_go_to_the_kernel(trained):
    renderer = Renderer(Avatar(trained), "native", threads=1)
    assert (renderer.rasterizer.config.threads, renderer.rasterizer.config.backface) == (1, 0.3)
    assert renderer.rasterizer.wants_normals


def test_drawing_is_posing_and_rasterizing_one_after_the_other(bundle):
    avatar = Avatar(bundle)
    renderer, pose, trans = Renderer(avatar, "numpy"), rest(avatar), np.float32([0.2, 0, -0.1])
    whole = renderer.draw(pose, camera(), trans=trans, background=(0, 0.5, 1))
    halves = renderer.rasterize(renderer.gaussians(pose, trans, camera=camera()), camera(), (0, 0.5, 1))
    for name in ("color", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(halves, name))
    plain = NumpyRasterizer().render(avatar.gaussians(pose, trans), camera(), (0, 0.5, 1))
    np.testing.assert_array_equal(whole.color, plain.color)
    np.testing.assert_allclose(whole.color[0, 0], (0, 0.5, 1), atol=1e-7)  # float32 products with one
    assert whole.alpha.max() > 0.5


@pytest.mark.parametrize("name", ["numpy", pytest.param("native", marks=needs_kernel)])
def test_bytes_are_the_rounded_colors(bundle, name):
    """Of a background that is no half of a byte: there the kernel rounds up and NumPy to the even one."""
    renderer = Renderer(Avatar(bundle), name)
    gaussians = renderer.gaussians(rest(renderer.avatar), camera=camera())
    image = renderer.rasterize_uint8(gaussians, camera(), (0.2, 0.35, 0.4)).copy()
    color = renderer.rasterize(gaussians, camera(), (0.2, 0.35, 0.4)).color
    np.testing.assert_array_equal(image, to_bytes(color))
    assert image.dtype == np.uint8


def test_a_rasterizer_needs_only_to_render_and_gets_bytes_from_that(bundle):
    renderer = Renderer(Avatar(bundle), Kept(False))
    gaussians = renderer.gaussians(rest(renderer.avatar), camera=camera(4))
    image = renderer.rasterize_uint8(gaussians, camera(4), (0.0, 0.5, 1.0))
    assert image[0, 0].tolist() == [0, 128, 255]  # half of 255 rounds to even


def test_the_seconds_of_a_frame_are_those_of_both_halves(bundle):
    renderer = Renderer(Avatar(bundle), "numpy")
    renderer.draw(rest(renderer.avatar), camera(8))
    assert list(renderer.stage_seconds) == ["encode", "decode", "skin", "project", "sort", "blend"]
    assert all(seconds >= 0 for seconds in renderer.stage_seconds.values())


def test_a_person_behind_the_camera_is_background(bundle):
    renderer = Renderer(Avatar(bundle), "numpy")
    away = dataclasses.replace(camera(8), T_camera_world=look_at((0, 1, 3), (0, 1, 6)))
    assert (renderer.draw(rest(renderer.avatar), away).color == 1).all()


def test_what_does_not_fit_is_said(bundle):
    with pytest.raises(UserError, match=r"unknown rasterizer 'numpi'.*did you mean 'numpy'"):
        Renderer(Avatar(bundle), "numpi")
    with pytest.raises(UserError, match="rasterizer 'numpy' has no option 'fast'"):
        Renderer(Avatar(bundle), "numpy", options={"fast": True})
    with pytest.raises(ValueError, match="is built already"):
        Renderer(Avatar(bundle), NumpyRasterizer(), threads=2)
