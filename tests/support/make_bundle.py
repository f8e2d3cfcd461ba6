"""A small avatar bundle without training: points of the free body, coloured by their normals, with hand-made networks.

The static decoder returns constants. The dynamic pair is simple enough to be computed by hand: the encoder doubles the
positional map, and the decoder moves every point by DECODER_GAIN times the mean of the pose features over the map.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from places import BODY_FILE

from gavatar_runtime.bundle import Manifest, pack_body, pack_surfaces, write_bundle
from gavatar_runtime.geometry.ordering import progressive_rank
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.surface import Atlas

OPSET = 17
ENCODER_GAIN, DECODER_GAIN = 2.0, 0.01
MAP_RESOLUTION = 16
SCALE = 0.012  # metres


def free_body() -> BodyData:
    with np.load(BODY_FILE, allow_pickle=False) as file:
        a = dict(file)
    return BodyData(
        "free", a["v_template"], a["shapedirs"], a["J_regressor"], a["kintree_table"][0], a["weights"], a["f"],
        a["vt"], a["ft"], tuple(str(n) for n in a["joint_names"]),
    )  # fmt: skip


def surface_of(body: BodyData, count: int, resolution: int) -> Atlas:
    """`count` centres of triangles spread over the mesh; their texels are made up (0, 1, 2, ...)."""
    faces = body.faces[np.linspace(0, len(body.faces) - 1, count).astype(int)]
    _, joints = body.shaped(None)
    canonical = body.canonical_pose()
    posed, _ = body.posed(canonical)
    corners = posed[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    weights = body.lbs_weights[faces].mean(1)
    index = np.argsort(-weights, 1)[:, :4]
    weight = np.take_along_axis(weights, index, 1)
    return Atlas(
        resolution=resolution,
        texel=np.arange(count, dtype=np.int32),
        uv=np.zeros((count, 2), np.float32),
        face=np.zeros(count, np.int32),
        barycentric=np.zeros((count, 3), np.float32),
        points=corners.mean(1).astype(np.float32),
        normals=normals.astype(np.float32),
        joint_index=index.astype(np.int32),
        joint_weight=(weight / weight.sum(1, keepdims=True)).astype(np.float32),
        spacing=np.full(count, SCALE, np.float32),
        rank=progressive_rank(corners.mean(1)),
        joints=np.asarray(joints, np.float64),
        parents=np.asarray(body.parents, np.int32),
        A_canonical=body.skinning(canonical).astype(np.float64),
    )


def model(nodes, inputs, outputs, constants) -> bytes:
    """A checked ONNX model as bytes; inputs and outputs are name -> shape, constants name -> array."""
    info = [
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in group.items()]
        for group in (inputs, outputs)
    ]
    initializers = [numpy_helper.from_array(np.asarray(v), n) for n, v in constants.items()]
    graph = helper.make_graph(nodes, "test", info[0], info[1], initializers)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8)
    onnx.checker.check_model(made)
    return made.SerializeToString()


def decoder(colors: np.ndarray, *, dynamic: bool, scale: float = SCALE, offset: float = 0.0) -> bytes:
    N, M = len(colors), MAP_RESOLUTION
    f32 = np.float32
    constants = {"c": colors.astype(f32), "s": np.full(N, scale, f32), "o": np.full((N, 3), offset, f32)}
    nodes = [helper.make_node("Identity", ["c"], ["colors"]), helper.make_node("Identity", ["s"], ["scales"])]
    if dynamic:
        constants["gain"] = f32(DECODER_GAIN)
        nodes += [
            helper.make_node("ReduceMean", ["pose_features"], ["mean"], axes=[2, 3], keepdims=0),
            helper.make_node("Mul", ["mean", "gain"], ["shift"]),
            helper.make_node("Add", ["o", "shift"], ["offsets"]),
        ]
    else:
        nodes.append(helper.make_node("Identity", ["o"], ["offsets"]))
    outputs = {"offsets": (N, 3), "colors": (N, 3), "scales": (N,)}
    return model(nodes, {"pose_features": (1, 3, M, M)} if dynamic else {}, outputs, constants)


def encoder() -> bytes:
    shape = (1, 3, MAP_RESOLUTION, MAP_RESOLUTION)
    node = helper.make_node("Mul", ["positional_map", "gain"], ["pose_features"])
    return model([node], {"positional_map": shape}, {"pose_features": shape}, {"gain": np.float32(ENCODER_GAIN)})


def members(count: int = 300, *, dynamic: bool = False, scale: float = SCALE, offset: float = 0.0) -> dict[str, bytes]:
    body = free_body()
    surface = surface_of(body, count, max(32, int(np.ceil(np.sqrt(count)))))
    encoder_map = surface_of(body, 200, MAP_RESOLUTION) if dynamic else None
    made = {
        "surface.npz": pack_surfaces(surface, encoder_map),
        "body.npz": pack_body(body.joint_names, body.parents, surface.joints),
        "decoder.onnx": decoder(0.5 + 0.5 * surface.normals, dynamic=dynamic, scale=scale, offset=offset),
    }
    if dynamic:
        made["encoder.onnx"] = encoder()
    return made


def manifest(count: int = 300, *, dynamic: bool = False) -> Manifest:
    return Manifest(
        name="tester",
        gaussians=count,
        dynamic=dynamic,
        body={"model": "free", "joints": 52},
        components={"encoder": "double" if dynamic else "none", "decoder": "constant"},
        opset=OPSET,
        license="CC0-1.0",
    )


def make_bundle(path: Path, count: int = 300, *, dynamic: bool = False, **options) -> Path:
    write_bundle(path, manifest(count, dynamic=dynamic), members(count, dynamic=dynamic, **options))
    return path


def still(frames=1, joints=52, fps=30.0, name="still"):
    """Frames of the T-pose."""
    return Motion(np.zeros((frames, joints, 3), np.float32), np.zeros((frames, 3), np.float32), fps, name=name)
