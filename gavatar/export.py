"""From a trained run to a bundle that plays without torch: ONNX graphs, surface, body, manifest, verified."""

from __future__ import annotations

import copy
import dataclasses
import io
import tempfile
import warnings
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from gavatar_runtime.avatar import Avatar as PlayedAvatar
from gavatar_runtime.body import check_motion_fits
from gavatar_runtime.bundle import FORMAT_VERSION, Manifest, pack_body, pack_surfaces, read_bundle, write_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.motion import Motion

from .avatar import Avatar, sample_uv
from .evaluation import pose_features
from .motion import MotionTable
from .training.run import Run

OPSET = 18
POSITION_TOLERANCE = 1e-4  # metres: a tenth of a millimetre, far below a pixel at any sensible distance
COLOR_TOLERANCE = 1 / 255  # one 8-bit step


def fold_batchnorm(module: nn.Module) -> nn.Module:
    """A copy of `module` in eval mode in which every BatchNorm that follows a linear or (transposed) convolution layer
    within an nn.Sequential is folded into it: the same function as evaluated, one operation less."""
    module = copy.deepcopy(module).eval()
    for parent in list(module.modules()):
        if isinstance(parent, nn.Sequential):
            _fold_sequential(parent)
    return module


def _fold_sequential(layers: nn.Sequential) -> None:
    for i in range(len(layers) - 1):
        layer, norm = layers[i], layers[i + 1]
        if isinstance(layer, nn.Linear) and isinstance(norm, nn.BatchNorm1d):
            layers[i] = fuse_linear_bn_eval(layer, norm)
        elif isinstance(layer, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
            layers[i] = fuse_conv_bn_eval(layer, norm)
        elif isinstance(layer, nn.ConvTranspose2d) and isinstance(norm, nn.BatchNorm2d):
            layers[i] = fuse_conv_bn_eval(layer, norm, transpose=True)
        else:
            continue
        layers[i + 1] = nn.Identity()


class DecoderGraph(nn.Module):
    """The decoder as deployed: pose features in, attributes of the valid points out. The learnable features are
    smoothed once, here, and added to the pose features before sampling when their maps are of one size."""

    def __init__(self, avatar: Avatar, map_size: int):
        super().__init__()
        self.decoder = fold_batchnorm(avatar.decoder)
        features = avatar.smooth(avatar.features).detach()
        self.add_first = features.shape[-1] == map_size
        if not self.add_first:
            features = sample_uv(features, avatar.uv)
        self.register_buffer("features", features)
        self.register_buffer("uv", avatar.uv)
        self.register_buffer("spacing", avatar.spacing)

    def forward(self, pose_features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        if self.add_first:
            sampled = sample_uv(self.features + pose_features, self.uv)
        else:
            sampled = self.features + sample_uv(pose_features, self.uv)
        out = self.decoder(sampled[0], self.uv, self.spacing)
        return out.offsets, out.colors, out.scales


def _to_onnx(module: nn.Module, example: Tensor, inputs: list[str], outputs: list[str]) -> onnx.ModelProto:
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # torch.export's exporter gives the same graph 25 times slower and with one more dependency
        warnings.simplefilter("ignore")
        torch.onnx.export(
            module, (example,), buffer, input_names=inputs, output_names=outputs, opset_version=OPSET, dynamo=False
        )
    return onnx.load_from_string(buffer.getvalue())


def encoder_model(avatar: Avatar) -> onnx.ModelProto:
    """positional_map (1, 3, M, M) metres -> pose_features (1, C, M, M)."""
    size = avatar.encoder.map_size
    example = torch.zeros(1, 3, size, size)
    return _to_onnx(fold_batchnorm(avatar.encoder), example, ["positional_map"], ["pose_features"])


def decoder_model(avatar: Avatar) -> onnx.ModelProto:
    """pose_features -> offsets (N, 3), colors (N, 3), scales (N,); without input for a static avatar, whose decoder
    does not depend on the pose and is evaluated here once and for all."""
    outputs = ["offsets", "colors", "scales"]
    if avatar.encoder is None:
        with torch.no_grad():
            attributes = avatar.attributes()
        values = {name: getattr(attributes, name)[0].numpy() for name in outputs}
        return _constant_model(values)
    size = avatar.encoder.map_size
    graph = DecoderGraph(avatar, size).eval()
    return _to_onnx(graph, torch.zeros(1, avatar.config.features, size, size), ["pose_features"], outputs)


def _constant_model(values: dict[str, np.ndarray]) -> onnx.ModelProto:
    nodes, initializers, outputs = [], [], []
    for name, value in values.items():
        value = np.ascontiguousarray(value, np.float32)
        initializers.append(numpy_helper.from_array(value, f"{name}_value"))
        nodes.append(helper.make_node("Identity", [f"{name}_value"], [name]))
        outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, value.shape))
    graph = helper.make_graph(nodes, "static_avatar", [], outputs, initializers)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=9)


@dataclasses.dataclass
class ExportCheck:
    """The played avatar against the trained one over some poses. position_m, scale_m: largest distances, metres.
    color: largest difference in [0, 1]. poses: how many were compared."""

    position_m: float
    scale_m: float
    color: float
    poses: int


def verify(path: Path, run: Run, poses: int = 8) -> ExportCheck:
    """Compare a bundle, as the player reads it, with the PyTorch model on refined poses of the capture."""
    played = PlayedAvatar(read_bundle(path))
    motion = run.motion.motion()
    frames = sorted({view.frame for view in run.capture.views("train")})
    frames = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, poses).astype(int))]
    errors = []
    for frame in frames:
        expected = torch_gaussians(run, motion, frame)
        got = played.gaussians(motion.poses[frame], motion.trans[frame])
        errors.append(
            [
                float(np.linalg.norm(got.means - expected.means.numpy(), axis=-1).max()),
                float(np.abs(got.scales - expected.scales.numpy()).max()),
                float(np.abs(got.colors - expected.colors.numpy()).max()),
            ]
        )
    position, scale, color = np.max(errors, 0)
    return ExportCheck(float(position), float(scale), float(color), len(frames))


@torch.no_grad()
def torch_gaussians(run: Run, motion: Motion, frame: int):
    """The trained avatar's Gaussians in the pose of one frame of `motion`, torch tensors."""
    poses = check_motion_fits(motion.poses[frame][None], run.built.body.data.num_joints)
    attributes = run.avatar.attributes(pose_features(run.avatar, run.built, poses))
    table = MotionTable(Motion(poses, motion.trans[frame][None], motion.fps), poses.shape[1])
    return run.avatar.pose(attributes, *table())[0]


def export(run: Run, path: str | Path, poses: int = 8) -> Manifest:
    """Write the bundle of a run to `path` and return its manifest.

    The bundle is first written beside its place, played back and compared with the PyTorch model; it is put in place
    only if positions agree within 0.1 mm and colours within 1/255, else UserError and nothing is left.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    avatar, data = run.avatar, run.built.body.data
    manifest = _manifest(run)
    members = {"decoder.onnx": _with_metadata(decoder_model(avatar), manifest)}
    encoder_map = None
    if manifest.dynamic:
        members["encoder.onnx"] = _with_metadata(encoder_model(avatar), manifest)
        encoder_map = run.built.surface(avatar.encoder.map_size)
    members["surface.npz"] = pack_surfaces(run.built.surface(run.uv), encoder_map)
    joints = data.shaped(run.built.betas)[1]
    members["body.npz"] = pack_body(data.joint_names, data.parents, joints, run.built.betas)
    with tempfile.TemporaryDirectory(prefix=".gavatar-export-", dir=path.parent) as scratch:
        draft = Path(scratch) / "draft.gavatar"
        write_bundle(draft, manifest, members)
        check = verify(draft, run, poses)
    # written so that a NaN fails too
    if not (check.position_m <= POSITION_TOLERANCE and check.color <= COLOR_TOLERANCE):
        raise UserError(
            f"{path} was not written: the exported avatar differs from the trained one by "
            f"{1000 * check.position_m:.3f} mm (limit {1000 * POSITION_TOLERANCE}) and {255 * check.color:.2f}/255 in "
            "colour (limit 1/255)"
        )
    tolerances = {"position_tolerance_m": POSITION_TOLERANCE, "color_tolerance": COLOR_TOLERANCE}
    manifest = dataclasses.replace(manifest, export_check=dataclasses.asdict(check) | tolerances)
    return write_bundle(path, manifest, members)


def _manifest(run: Run) -> Manifest:
    config, data = run.config, run.built.body.data
    dynamic = run.avatar.encoder is not None
    return Manifest(
        name=run.capture.name,
        gaussians=len(run.built.surface(run.uv)),
        dynamic=dynamic,
        body={
            "model": data.name,
            "joints": data.num_joints,
            "betas": data.num_betas,
            "license": getattr(run.built.body, "license", "unknown"),
        },
        components={"encoder": config.encoder["name"] if dynamic else "none", "decoder": config.decoder["name"]},
        opset=OPSET,
        license=run.capture.license,
        training={
            "capture": run.capture.name,
            "stage": run.stage,
            "stage1_steps": config.stage1.steps,
            "stage2_steps": config.stage2.steps if run.stage == 2 else 0,
            "train_views": len(run.capture.views(config.train_split)),
            "uv_resolution": run.uv,
            "seed": config.seed,
        },
    )


def _with_metadata(model: onnx.ModelProto, manifest: Manifest) -> bytes:
    """The model's bytes, with what a stranger needs to know in its metadata_props."""
    properties = {
        "gavatar_format": str(FORMAT_VERSION),
        "name": manifest.name,
        "created_by": manifest.created_by,
        "license": manifest.license,
        "body": manifest.body["model"],
        "gaussians": str(manifest.gaussians),
        "opset": str(manifest.opset),
        "encoder": manifest.components["encoder"],
        "decoder": manifest.components["decoder"],
    }
    helper.set_model_props(model, properties)
    onnx.checker.check_model(model)
    return model.SerializeToString()
