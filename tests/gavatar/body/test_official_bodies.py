"""SMPL, SMPL-H and SMPL-X files in the layouts in which they are downloaded: found, read, refused with reasons."""

from __future__ import annotations

import os
import pickle

import numpy as np
import pytest
from official_bodies import (
    JOINTS,
    obj_text,
    parents,
    random_arrays,
    uv_arrays,
    write_mano,
    write_npz,
    write_smpl_pickle,
)

from gavatar.body.official_files import FAMILIES
from gavatar.registry import BODIES, load_plugins
from gavatar_runtime.errors import UserError

load_plugins()
OFFICIAL = ("smpl", "smplh", "smplx")


@pytest.fixture(autouse=True)
def no_models_of_the_machine(monkeypatch):
    monkeypatch.delenv("GAVATAR_BODY_MODELS", raising=False)


def put(folder, family: str, name: str, arrays: dict | None = None, uv: str = "obj"):
    """A model file of the given name, with its atlas beside it."""
    arrays = arrays or random_arrays(family)
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    atlas = uv_arrays(arrays)
    if uv == "inside":
        arrays = arrays | atlas
    elif uv:
        stem = "smplx_uv" if family == "smplx" else "smpl_uv"
        (folder / f"{stem}.obj").write_text(obj_text(arrays, atlas, shuffled=True))
    if path.suffix == ".npz":
        return write_npz(path, arrays)
    if family == "smplx":
        path.write_bytes(pickle.dumps(arrays, 2))
        return path
    return write_smpl_pickle(path, arrays)


def build(family: str, **options):
    return BODIES.build(family, options)


def assert_is(data, arrays: dict, family: str):
    np.testing.assert_allclose(data.v_template, arrays["v_template"], atol=1e-12)
    np.testing.assert_array_equal(data.J_regressor, arrays["J_regressor"])
    np.testing.assert_array_equal(data.lbs_weights, arrays["weights"])
    np.testing.assert_allclose(data.posedirs, arrays["posedirs"], rtol=1e-6)
    shape = 10 if family == "smplx" else arrays["shapedirs"].shape[2]
    np.testing.assert_allclose(data.shapedirs, arrays["shapedirs"][:, :, :shape], rtol=1e-6)
    assert data.parents.tolist() == parents(JOINTS[family])
    assert data.joint_names == JOINTS[family]


NAMES = {
    "smpl": ("SMPL_NEUTRAL.pkl", "SMPL_NEUTRAL.npz", "smpl/models/basicModel_neutral_lbs_10_207_0_v1.0.0.pkl",
             "SMPL_python_v.1.1.0/smpl/models/basicmodel_neutral_lbs_10_207_0_v1.1.0.pkl"),
    "smplh": ("SMPLH_NEUTRAL.pkl", "mano_v1_2/models/SMPLH_neutral.pkl", "smplh/neutral/model.npz"),
    "smplx": ("SMPLX_NEUTRAL.npz", "models/smplx/SMPLX_NEUTRAL.pkl",
              "SMPLX_NEUTRAL_2020.npz", "smplx/neutral/model.npz"),
}  # fmt: skip


@pytest.mark.parametrize(("family", "name"), [(f, n) for f in OFFICIAL for n in NAMES[f]])
def test_every_release_is_found_below_a_folder_and_read(family, name, tmp_path, monkeypatch):
    put(tmp_path, family, name)
    assert_is(build(family, path=str(tmp_path)).data, random_arrays(family), family)
    if "/" not in name:
        assert_is(build(family, path=str(tmp_path / name)).data, random_arrays(family), family)
    monkeypatch.setenv("GAVATAR_BODY_MODELS", os.pathsep.join([str(tmp_path / "absent"), str(tmp_path)]))
    assert_is(build(family).data, random_arrays(family), family)


@pytest.mark.parametrize("family", OFFICIAL)
def test_genders_have_files_of_their_own(family, tmp_path):
    for seed, gender in enumerate(("female", "male")):
        short = f"basicmodel_{gender[0]}_lbs_10_207_0_v1.1.0.pkl"
        name = short if family == "smpl" else f"{family.upper()}_{gender.upper()}.npz"
        arrays = random_arrays(family, seed=seed) | {"f": random_arrays(family)["f"]}
        put(tmp_path, family, name, arrays)
        assert_is(build(family, path=str(tmp_path), gender=gender).data, arrays, family)
    with pytest.raises(UserError, match=rf"no neutral {FAMILIES[family].title} model.*download.*https.*body\.path"):
        build(family, path=str(tmp_path))
    with pytest.raises(UserError, match=r"body\.gender=mail.*did you mean 'male'"):
        build(family, path=str(tmp_path), gender="mail")


def test_nothing_to_look_in_says_where_to_put_the_file():
    with pytest.raises(UserError, match=r"nowhere: neither body\.path nor \$GAVATAR_BODY_MODELS.*SMPLX_NEUTRAL\.npz"):
        build("smplx")
    with pytest.raises(UserError, match=r"body\.path=/no/such does not exist"):
        build("smplx", path="/no/such")


@pytest.mark.parametrize("family", OFFICIAL)
def test_the_atlas_comes_from_the_model_an_obj_or_an_npz_and_is_the_same(family, tmp_path):
    arrays = random_arrays(family)
    uv = uv_arrays(arrays)
    expected = uv["vt"][uv["ft"]]
    order = np.lexsort(np.sort(arrays["f"].astype(int), 1).T)

    def triangles(folder, **options):
        data = build(family, path=str(folder), **options).data
        corners = np.argsort(data.faces, 1)
        places = np.take_along_axis(data.uv[data.uv_faces], corners[..., None], 1)
        return places[np.lexsort(np.sort(data.faces, 1).T)]

    corners = np.argsort(arrays["f"].astype(int), 1)
    expected = np.take_along_axis(expected, corners[..., None], 1)[order]
    name = f"{family.upper()}_NEUTRAL.npz"
    for kind in ("obj", "inside"):
        folder = tmp_path / kind
        folder.mkdir()
        put(folder, family, name, uv=kind)
        np.testing.assert_allclose(triangles(folder), expected, atol=1e-9)  # nine digits in the .obj
    folder = tmp_path / "npz"
    folder.mkdir()
    put(folder, family, name, uv="")
    with pytest.raises(UserError, match=r"no UV atlas.*download smplx?_uv\.obj.*https.*body\.uv=FILE"):
        build(family, path=str(folder))
    np.savez(tmp_path / "atlas.npz", **uv)
    np.testing.assert_array_equal(triangles(folder, uv=str(tmp_path / "atlas.npz")), expected)


def test_an_atlas_of_another_mesh_is_refused(tmp_path):
    arrays = random_arrays("smplx")
    path = put(tmp_path, "smplx", "SMPLX_NEUTRAL.npz", arrays)
    obj = tmp_path / "smplx_uv.obj"
    text = obj.read_text()
    cases = {
        "other triangles": (obj_text(arrays | {"f": arrays["f"] % 50}, uv_arrays(arrays)), "not the model's"),
        "other vertices": (text.replace("v ", "v 0 0 0\nv ", 1), r"61 vertices and the model 60"),
        "a square": (text + "f 1/1 2/2 3/3 4/4\n", r"line \d+: a face of 4 corners"),
        "no uv": ("v 0 0 0\n" * 60 + "f 1 2 3\n", "no faces with UV"),
        "rubbish": (text + "vt one two\n", r"line \d+: 'vt one two' is not understood"),
        "nothing": ("", "no faces with UV"),
        "a uv number too large": (text.replace("f ", "f 1/9999 2/2 3/3\nf ", 1), "UV faces|not the model's"),
    }
    for name, (content, message) in cases.items():
        obj.write_text(content)
        with pytest.raises(UserError, match=message) as error:
            build("smplx", path=str(path), num_betas=len(name))  # another option, so that nothing comes from the cache
        assert "smplx_uv.obj" in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": None}, "'weights' is missing"),
        ({"v_template": np.full((60, 3), np.nan)}, "'v_template' holds NaN"),
        ({"weights": np.ones((60, 54))}, r"'weights' has shape \(60, 54\), expected \(60, 55\)"),
        ({"weights": np.full((60, 55), 0.5 / 55)}, r"'weights': the skinning weights of 60 of 60 vertices do not sum"),
        ({"weights": np.zeros((60, 55))}, r"'weights': .* are all zero"),
        ({"posedirs": np.ones((60, 3, 207))}, r"'posedirs' has shape"),
        ({"kintree_table": random_arrays("smplh")["kintree_table"]}, "has 52 joints and SMPL-X has 55.*SMPL-H"),
        ({"kintree_table": np.array([[7] * 55, range(55)])}, "every parent before its children"),
        ({"f": np.full((4, 3), 60)}, r"'f' must be \(F, 3\) vertex numbers below 60"),
        ({"shapedirs": np.array(["a"] * 60)}, "'shapedirs' is not an array of numbers"),
        ({"hands_meanl": np.zeros(44)}, "hand means must hold 45"),
    ],
)
def test_a_model_with_a_fault_names_file_and_array(change, message, tmp_path):
    arrays = {k: v for k, v in (random_arrays("smplx") | change).items() if v is not None}
    path = write_npz(tmp_path / "SMPLX_NEUTRAL.npz", arrays | uv_arrays(random_arrays("smplx")))
    with pytest.raises(UserError, match=message) as error:
        build("smplx", path=str(path))
    assert "SMPLX_NEUTRAL.npz" in str(error.value)


class Evil:
    def __reduce__(self):
        return os.system, ("touch pwned",)


@pytest.mark.parametrize("family", OFFICIAL)
def test_a_model_file_with_code_in_it_is_refused(family, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"{family.upper()}_NEUTRAL.pkl"
    path.write_bytes(pickle.dumps(random_arrays(family) | {"bs_type": Evil()}, 2))
    with pytest.raises(UserError, match=r"_NEUTRAL\.pkl asks for '(posix|nt)\.system'"):
        build(family, path=str(path))
    assert not (tmp_path / "pwned").exists()
    path.write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(UserError, match="holds no model"):
        build(family, path=str(path))


def test_shape_and_expression_are_split_as_the_files_have_them(tmp_path):
    for coefficients, shape, expression in ((20, 10, 10), (400, 300, 100)):
        arrays = random_arrays("smplx", coefficients=coefficients)
        path = put(tmp_path, "smplx", f"SMPLX_NEUTRAL_{coefficients}.npz", arrays)
        data = build("smplx", path=str(path), num_expression=-1).data
        assert (data.num_betas, data.num_expression) == (shape, expression)
        np.testing.assert_allclose(data.exprdirs, arrays["shapedirs"][:, :, shape:], rtol=1e-6)
        few = build("smplx", path=str(path), num_expression=3, num_betas=5).data
        assert (few.num_betas, few.num_expression) == (5, 3)
        assert build("smplx", path=str(path), num_expression=0).data.num_expression == 0
    with pytest.raises(UserError, match=r"body\.num_betas=-1"):
        build("smplx", path=str(path), num_betas=-1)


def test_smplh_takes_its_hands_from_mano_where_its_file_has_none(tmp_path):
    arrays = random_arrays("smplh")
    bare = {k: v for k, v in arrays.items() if not k.startswith("hands_")}
    put(tmp_path, "smplh", "SMPLH_NEUTRAL.pkl", bare)
    flat = build("smplh", path=str(tmp_path)).data
    assert flat.hands.components.shape == (2, 0, 45)
    assert not flat.rest_pose.any()
    with pytest.raises(UserError, match=r"MANO_LEFT\.pkl and MANO_RIGHT\.pkl.*https"):
        build("smplh", path=str(tmp_path), hands="mean")
    write_mano(tmp_path, arrays)
    mean = build("smplh", path=str(tmp_path), hands="mean").data
    np.testing.assert_array_equal(mean.hands.mean[0].ravel(), arrays["hands_meanl"])
    np.testing.assert_array_equal(mean.hands.components[1], arrays["hands_componentsr"])
    np.testing.assert_array_equal(mean.rest_pose[-15:].ravel(), arrays["hands_meanr"])
    with pytest.raises(UserError, match=r"body\.hands=meen"):
        build("smplh", path=str(tmp_path), hands="meen")


def test_parts_of_a_pose_come_together_in_the_order_of_the_joints(tmp_path):
    arrays = random_arrays("smplx")
    path = put(tmp_path, "smplx", "SMPLX_NEUTRAL.npz", arrays)
    data = build("smplx", path=str(path), hands="mean").data
    rng = np.random.default_rng(0)
    part = {
        "global_orient": rng.normal(size=(4, 3)), "body_pose": rng.normal(size=(4, 63)), "jaw": rng.normal(size=3),
        "left_eye": rng.normal(size=3), "right_eye": rng.normal(size=(4, 3)), "left_hand": rng.normal(size=(4, 6)),
    }  # fmt: skip
    pose = data.full_pose(**part, pca=True)
    assert pose.shape == (4, 55, 3)
    np.testing.assert_array_equal(pose[:, data.joint_names.index("jaw")], np.tile(part["jaw"], (4, 1)))
    np.testing.assert_array_equal(pose[:, 24], part["right_eye"])
    left = arrays["hands_meanl"] + part["left_hand"] @ arrays["hands_componentsl"][:6]
    np.testing.assert_allclose(pose[:, 25:40].reshape(4, 45), left, atol=1e-12)
    np.testing.assert_allclose(pose[:, 40:].reshape(4, 45), np.tile(arrays["hands_meanr"], (4, 1)), atol=1e-12)
    assert data.full_pose().shape == (55, 3)
    with pytest.raises(ValueError, match="45 hand components, not 46"):
        data.full_pose(left_hand=np.zeros(46), pca=True)
    put(tmp_path, "smpl", "SMPL_NEUTRAL.npz")
    smpl = build("smpl", path=str(tmp_path)).data
    for wrong in ("jaw", "left_hand"):
        with pytest.raises(ValueError, match="body 'smpl' has no"):
            smpl.full_pose(**{wrong: np.zeros(3)})
