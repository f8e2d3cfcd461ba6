"""What a program sees of the player: `import gavatar_runtime as gr`."""

from __future__ import annotations

import gc
import subprocess
import sys
import urllib.error
import urllib.request
import warnings

import numpy as np
import pytest
from video_frames import frames_of

import gavatar_runtime as gr
from gavatar_runtime.avatar import playing
from gavatar_runtime.motions.builtin import relaxed_pose
from gavatar_runtime.notes import Note
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.values.skeletons import SMPLH

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import make_bundle, still


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("face") / "anna.gavatar", dynamic=True)


@pytest.fixture(scope="module")
def avatar(bundle):
    return gr.load(bundle)


@pytest.fixture
def pose() -> np.ndarray:
    return np.random.default_rng(0).normal(0, 0.3, (52, 3)).astype(np.float32)


def test_an_avatar_is_shown_in_a_page_that_ends_with_it(avatar):
    shown = avatar.view(["wave"])
    address = shown.address
    with urllib.request.urlopen(address, timeout=20) as page:
        assert b"<canvas" in page.read()
    assert shown.scene.motion_names[0] == "wave"
    assert f'src="{address}"' in shown._repr_html_()
    del shown
    gc.collect()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address, timeout=20)


def test_an_avatar_becomes_a_web_page(static, tmp_path):
    gr.load(static).convert(tmp_path / "anna.html", motions=["wave"], gaussians=50)
    assert "<canvas" in (tmp_path / "anna.html").read_text()
    with pytest.raises(gr.UserError, match="gavatar-play"):
        gr.load(static).convert(tmp_path / "anna.mp4")


def same(a: gr.Gaussians, b: gr.Gaussians) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("means", "scales", "colors"))


# importing


def loaded_after(statement: str) -> set[str]:
    """Top packages, those of the standard library left out, that a new interpreter has loaded."""
    code = f"import sys; before = set(sys.modules); {statement}; print(*sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()} - set(sys.stdlib_module_names)
    return {name for name in loaded if "cython" not in name}  # which older NumPys enter there


def test_importing_loads_nothing_but_the_package_itself():
    assert loaded_after("import gavatar_runtime") == {"gavatar_runtime"}


def test_no_name_of_the_face_loads_more_than_numpy():
    names = "; ".join(f"gavatar_runtime.{name}" for name in gr.__all__)
    assert loaded_after(f"import gavatar_runtime; {names}") == {"gavatar_runtime", "numpy"}


def test_every_name_of_the_face_is_there_and_listed():
    assert set(gr.__all__) <= set(dir(gr))
    for name in gr.__all__:
        assert getattr(gr, name) is not None
    with pytest.raises(AttributeError, match="'gavatar_runtime' has no attribute 'Avatars'"):
        gr.Avatars  # noqa: B018


# opening


def test_an_avatar_says_what_it_is(avatar, bundle):
    assert repr(avatar) == (
        "<Avatar 'tester': 300 Gaussians, tier full (stored: full), body free of 52 joints, moves with the pose>"
    )
    assert "no tier" in repr(gr.Avatar(bundle, tier=None))
    assert len(avatar) == 300
    assert avatar.tiers == ("full",)
    assert avatar.joint_names == SMPLH


def test_fewer_gaussians_can_be_asked_for_by_their_number(tmp_path):
    path = make_bundle(tmp_path / "many.gavatar", 5000)
    whole = gr.load(path)
    assert len(gr.load(path, gaussians=5000)) == len(gr.load(path, gaussians=10**9)) == len(whole) == 5000
    fewer = gr.load(path, gaussians=4500)
    assert len(fewer) == 4500
    assert "4500 of 5000 Gaussians" in repr(fewer)
    with pytest.warns(Note, match="`uv=64` is the former way to say `gaussians=2580`"):
        assert len(gr.load(path, uv=64)) == 2580
    assert len(gr.load(path, gaussians=1)) == 1
    with pytest.raises(ValueError, match="`gaussians=0`: give a whole number from 1 up"):
        gr.load(path, gaussians=0)
    with pytest.raises(ValueError, match="give one of them"):
        gr.load(path, gaussians=4500, uv=64)


def test_what_cannot_be_opened_is_pythons_own_error_too(bundle, tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        gr.load(tmp_path / "absent.gavatar")
    with pytest.raises(ValueError, match=r"unknown tier 'fulll'.*did you mean 'full'"):
        gr.load(bundle, tier="fulll")
    with pytest.raises(ValueError, match="holds no tier 'baked'"):
        gr.load(bundle, tier="baked")
    with pytest.raises(ValueError, match="threads=0"):
        gr.load(bundle, threads=0)
    (tmp_path / "not.gavatar").write_text("anything")
    with pytest.raises(gr.UserError, match="not a gavatar bundle"):
        gr.load(tmp_path / "not.gavatar")


# Gaussians


def test_every_form_of_a_pose_gives_the_same_gaussians(avatar, pose):
    expected = avatar.gaussians(pose)
    parts = {"global_orient": pose[0], "body_pose": pose[1:22].reshape(1, 63)}
    parts |= {"left_hand_pose": pose[22:37].reshape(45), "right_hand_pose": pose[37:].tolist()}
    assert same(avatar.gaussians(pose.reshape(156)), expected)
    assert same(avatar.gaussians(pose.astype(np.float64).tolist()), expected)
    assert same(avatar.gaussians(**parts), expected)
    assert same(playing.Avatar(avatar.bundle).gaussians(pose), expected)


def test_72_numbers_are_smpls(avatar, pose):
    body = np.zeros((52, 3), np.float32)
    body[:22] = pose[:22]
    smpl = np.zeros((24, 3), np.float32)
    smpl[:22] = pose[:22]
    assert same(avatar.gaussians(smpl.reshape(72)), avatar.gaussians(body))
    assert same(avatar.gaussians(global_orient=pose[0], body_pose=smpl[1:].reshape(69)), avatar.gaussians(body))


def test_a_translation_is_added_under_either_name(avatar, pose):
    there = avatar.gaussians(pose, [1, 2, 3])
    assert same(avatar.gaussians(pose, transl=np.array([[1.0, 2, 3]])), there)
    np.testing.assert_allclose(
        there.means, np.float32([1, 2, 3]) + avatar.gaussians(pose).means, atol=2e-6
    )  # float32 at 3 m
    with pytest.raises(ValueError, match="`trans` and `transl` are the same"):
        avatar.gaussians(pose, [1, 2, 3], transl=[1, 2, 3])


def test_without_a_pose_the_person_stands_at_ease(avatar):
    assert same(avatar.gaussians(), avatar.gaussians(relaxed_pose()))


def test_what_moves_that_the_body_lacks_is_said(avatar):
    smpl = np.zeros(72)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        avatar.gaussians(smpl)
    smpl[-3:] = 0.2
    for given in ({"pose": smpl}, {"body_pose": smpl[3:]}):
        with pytest.warns(UserWarning, match="the body has no right_hand: what the pose does there is left out"):
            avatar.gaussians(**given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pose": np.zeros(63)}, "pose has shape"),
        ({"pose": np.full((52, 3), np.nan)}, "joint 'pelvis' is NaN or infinite"),
        ({"pose": np.full(72, np.inf)}, "joint 'pelvis' is NaN or infinite"),
        ({"pose": np.zeros(156), "trans": [0, 0]}, r"trans has shape \(2,\)"),
        ({"pose": np.zeros(156), "trans": [0, np.nan, 0]}, "the translation is NaN"),
        ({"pose": np.zeros(156), "trans": "here"}, "trans is no array of numbers"),
        ({"pose": np.zeros(156), "body_pose": np.zeros(63)}, "`pose` is whole, and `body_pose` beside it"),
        ({"pose": np.zeros(156), "expression": np.ones(10)}, "this avatar has no expressions"),
        ({"body_pos": np.zeros(63)}, "no part 'body_pos'.*did you mean 'body_pose'"),
    ],
)
def test_a_frame_that_cannot_be_is_a_value_error(avatar, given, message):
    for method in (avatar.gaussians, avatar.render):
        with pytest.raises(ValueError, match=message):
            method(**given)


def test_the_arrays_are_the_callers(bundle, pose):
    for avatar in (gr.load(bundle), gr.load(make_bundle(bundle.parent / "still.gavatar"))):
        first = avatar.gaussians(pose, normals=True)
        kept = first.copied()
        for angle in range(5):
            avatar.gaussians(np.full((52, 3), 0.1 * angle), normals=True)
        assert same(first, kept)
        np.testing.assert_array_equal(first.normals, kept.normals)
        for array in (first.means, first.scales, first.colors):
            array[...] = 7
        assert same(avatar.gaussians(pose), kept)


def test_without_copying_come_the_same_numbers_in_buffers_that_are_filled_again(avatar, pose):
    expected = avatar.gaussians(pose)
    given = [avatar.gaussians(pose, copy=False) for _ in range(4)]
    assert same(given[0], expected)
    assert given[0].means is given[3].means
    assert given[0].means is not given[1].means


# images


def test_a_render_is_an_image_of_the_whole_person(avatar):
    image = avatar.render(size=64)
    assert (image.shape, image.dtype) == ((64, 64, 3), np.uint8)
    drawn = (image != 255).any(-1)
    assert not drawn[[0, -1]].any()
    assert not drawn[:, [0, -1]].any()
    rows = np.flatnonzero(drawn.any(1))
    assert np.ptp(rows) > 0.75 * 64  # the frame leaves a margin of 6 % of the sides, and Gaussians are blurred


def test_a_person_is_found_wherever_they_stand_and_face(avatar):
    near = avatar.render(size=48)
    turned = relaxed_pose()
    turned[0] = (0, np.pi / 2, 0)
    far = avatar.render(turned, trans=[20, 1, -3], size=48)
    # the front is the person's own; what remains is float32 at twenty metres, on edges
    assert np.mean(np.abs(near.astype(int) - far)) < 1


def test_a_render_is_the_callers_and_what_the_renderer_draws(avatar, pose):
    camera = frame_motion(avatar, still(), 40, 30)
    image = avatar.render(pose, camera, background=(0, 0.5, 1))
    renderer = Renderer(gr.load(avatar.bundle))
    gaussians = renderer.gaussians(pose, camera=camera)
    np.testing.assert_array_equal(image, renderer.rasterize_uint8(gaussians, camera, (0, 0.5, 1)))
    kept = image.copy()
    avatar.render(camera=camera)
    np.testing.assert_array_equal(image, kept)
    assert image.shape == (30, 40, 3)


def test_size_view_and_background_can_be_chosen(avatar):
    assert avatar.render().shape == (512, 512, 3)
    assert avatar.render(width=30, height=20).shape == (20, 30, 3)
    assert avatar.render(camera=frame_motion(avatar, still(), 64, 64), size=32).shape == (32, 32, 3)
    assert avatar.render(size=32, background="#0000ff")[0, 0].tolist() == [0, 0, 255]
    front, side, back = (avatar.render(camera=view, size=32).astype(int) for view in ("front", 90, "back"))
    assert np.abs(front - side).sum() > 0
    np.testing.assert_array_equal(side, avatar.render(camera="left", size=32))
    assert np.abs(front - back).sum() > 0
    for wrong in ({"camera": "behind"}, {"size": 0}, {"background": "mauve"}, {"size": 10**6}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))}"):
            avatar.render(**wrong)


def test_another_rasterizer_can_be_set(bundle):
    avatar = gr.load(bundle)
    native = avatar.render(size=24)
    avatar.renderer = gr.Renderer(avatar, "numpy")
    plain = avatar.render(size=24)
    assert np.abs(native.astype(int) - plain).max() <= 1  # the same rule, rounded to bytes


# files


def test_a_motion_plays_into_a_video(avatar, tmp_path):
    report = avatar.play("wave", tmp_path / "wave.mp4", fps=10, seconds=0.5, size=32)
    assert report.frames == len(frames_of(tmp_path / "wave.mp4")) == 5
    report = avatar.play(gr.Motion(np.zeros((2, 52, 3)), np.zeros((2, 3)), 30.0), tmp_path / "frames", size=16)
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == ["000000.png", "000001.png"]
    with pytest.raises(FileNotFoundError, match=r"absent\.npz does not exist"):
        avatar.play(tmp_path / "absent.npz", tmp_path / "wave.mp4")


def test_what_was_played_before_changes_no_bit_of_a_pose(bundle, pose, tmp_path):
    avatar = gr.load(bundle)
    pose[22:] = 0  # the fingers rest, as in the motion
    first = avatar.gaussians(pose)
    motion = gr.Motion(np.stack([pose, 2 * pose]), np.zeros((2, 3), np.float32), 30.0)
    avatar.play(motion, tmp_path / "out.png", size=16)
    assert same(avatar.gaussians(pose), first)


def test_a_pose_is_saved_as_gaussians_or_as_an_image(avatar, pose, tmp_path):
    avatar.save(tmp_path / "me.ply", pose)
    avatar.save(tmp_path / "same.ply", global_orient=pose[0], body_pose=pose[1:22], left_hand_pose=pose[22:37],
                right_hand_pose=pose[37:])  # fmt: skip
    assert (tmp_path / "me.ply").read_bytes() == (tmp_path / "same.ply").read_bytes()
    assert (tmp_path / "me.ply").read_bytes().startswith(b"ply\nformat binary_little_endian 1.0\n")
    avatar.save(tmp_path / "me.png", pose)
    assert (tmp_path / "me.png").stat().st_size > 0
    with pytest.raises(ValueError, match=r"cannot write .*me\.plx.*did you mean"):
        avatar.save(tmp_path / "me.plx", pose)
