"""From a trained run to a bundle that plays without torch: ONNX graphs, surface, body, manifest, verified."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import helper

from gavatar_runtime.avatar.expression import MEMBER as EXPRESSION
from gavatar_runtime.avatar.playing import Avatar as PlayedAvatar
from gavatar_runtime.avatar.pose_blendshapes import MEMBER as POSE_BLENDSHAPES
from gavatar_runtime.bundle import (
    FORMAT_VERSION,
    Manifest,
    pack_arrays,
    pack_body,
    pack_surfaces,
    read_bundle,
    write_bundle,
)
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.render.rasterizers import SWITCHES
from gavatar_runtime.tiers import DEFAULT, members_read

from ..attributes import encoder_inputs
from ..body.blendshapes import expression_of, pose_blendshapes_of
from ..registry import TIERS
from ..training.posing import posed
from ..training.run import Run
from .onnx_graphs import OPSET, decoder_model, encoder_model
from .seen import difference, seen
from .tier_source import TierSource

POSITION_TOLERANCE = 1e-4  # metres: a tenth of a millimetre, far below a pixel at any sensible distance
SAME_TIME, SAME_PSNR = 1.1, 0.5  # times, and dB, within which two tiers are alike
COLOR_TOLERANCE = 1 / 255  # one 8-bit step


@dataclasses.dataclass
class ExportCheck:
    """The played avatar against the trained one over some poses. position_m, scale_m: largest distances, metres.
    color: largest difference in [0, 1]. poses: how many were compared."""

    position_m: float
    scale_m: float
    color: float
    poses: int


def verify(path: Path, run: Run, poses: int = 8) -> ExportCheck:
    """Compare a bundle, as the player reads it, with the PyTorch model on refined poses of the capture; with
    expressions of the capture, or made up ones, where the body has any."""
    played = PlayedAvatar(read_bundle(path))
    motion = run.motion.motion()
    if played.expression is not None and motion.expression is None:
        made_up = np.sin(np.arange(len(motion))[:, None] + np.arange(played.expression.count))
        motion = dataclasses.replace(motion, expression=made_up.astype(np.float32))
    frames = sorted({view.frame for view in run.capture.views(run.config.train_split)})
    frames = [frames[i] for i in evenly_spaced(len(frames), poses)]
    errors = []
    for frame in frames:
        expected = posed(run, motion, frame)
        got = played.gaussians(*motion.at(frame))
        errors.append(
            [
                float(np.linalg.norm(got.means - expected.means.numpy(), axis=-1).max()),
                float(np.abs(got.scales - expected.scales.numpy()).max()),
                float(np.abs(got.colors - expected.colors.numpy()).max()),
            ]
        )
    position, scale, color = np.max(errors, 0)
    return ExportCheck(float(position), float(scale), float(color), len(frames))


def export(
    run: Run,
    path: str | Path,
    poses: int = 8,
    *,
    uv: int | None = None,
    tiers: Sequence[str] = (),
    drop_unseen: bool = False,
    progress: bool = False,
) -> Manifest:
    """Write the bundle of a run to `path` and return its manifest.

    uv: side of the atlas whose texels are its Gaussians, None for the one it was trained at (scales in units of the
    point spacing keep the surface closed). tiers: cheaper ways to decode it that are stored too, each with its measured
    error and cost. drop_unseen: leave out Gaussians that no training view sees nor any of their neighbours
    (`unseen.seen`); the manifest's `training` says under `unseen` how many, and what that changed.

    The bundle is first written beside its place, played back and compared with the PyTorch model; it is put in place
    only if positions agree within 0.1 mm and colours within 1/255, else UserError and nothing is left.
    """
    path = Path(path)
    _check_isotropic(run)
    path.parent.mkdir(parents=True, exist_ok=True)
    avatar, data = run.avatar, run.built.body.data
    tiers = _with_needs(tiers, run)
    if uv is not None and uv != run.uv:
        run = dataclasses.replace(run, uv=uv)
        avatar.sample_at(run.built.surface(uv))
    surface, left_out = run.built.surface(run.uv), None
    if drop_unseen:
        kept = seen(run, progress=progress)
        left_out = {"dropped": int((~kept).sum()), **difference(run, kept)}
        surface = surface.take(np.flatnonzero(kept))
        avatar.sample_at(surface)
    manifest = _manifest(run)
    if left_out is not None:
        manifest.training["unseen"] = left_out
    members = {"decoder.onnx": _with_metadata(decoder_model(avatar), manifest)}
    encoder_map = None
    if manifest.dynamic:
        members["encoder.onnx"] = _with_metadata(encoder_model(avatar), manifest)
        encoder_map = run.built.surface(avatar.encoder.map_size)
    sees_normals = manifest.dynamic and "normal_map" in manifest.components["encoder_inputs"]
    members["surface.npz"] = pack_surfaces(surface, encoder_map, sees_normals)
    joints = data.shaped(run.built.betas)[1]
    members["body.npz"] = pack_body(data.joint_names, data.parents, joints, run.built.betas, data.rest_pose, data.hands)
    expression = expression_of(data, surface)
    if expression is not None:
        members[EXPRESSION] = pack_arrays(expression.to_arrays())
    if avatar.config.pose_blendshapes:
        members[POSE_BLENDSHAPES] = pack_arrays(pose_blendshapes_of(data, surface).to_arrays())
    source = TierSource(run, avatar.surface, lambda model: _with_metadata(model, manifest), progress)
    for name in tiers:
        members |= TIERS.build(name).build(source)
    manifest = dataclasses.replace(manifest, tiers=[{"name": name} for name in tiers])
    with tempfile.TemporaryDirectory(prefix=".gavatar-export-", dir=path.parent) as scratch:
        draft = Path(scratch) / "draft.gavatar"
        write_bundle(draft, manifest, members)
        check = verify(draft, run, poses)
        if tiers:
            from ..measure.ladder import describe_tiers

            manifest = dataclasses.replace(manifest, tiers=describe_tiers(draft, run, progress=progress))
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


def export_front(run: Run, path: str | Path, poses: int = 8, *, progress: bool = False, **options) -> Manifest:
    """As `export` with its options `uv` and `drop_unseen`, with those tiers that no other stored tier beats in both
    speed and error, as measured here. A static avatar has none."""
    if run.avatar.encoder is None:
        return export(run, path, poses, progress=progress, **options)
    path = Path(path)
    _check_isotropic(run)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".gavatar-export-", dir=path.parent) as scratch:
        draft = Path(scratch) / "all.gavatar"
        manifest = export(run, draft, poses, tiers=TIERS.names(), progress=progress, **options)
        bundle = read_bundle(draft)
        members = {name: bundle.read(name) for name in bundle.manifest.members}
    kept = on_front(manifest.tiers)
    wanted = members_read(bundle, [tier["name"] for tier in kept])
    return write_bundle(
        path, dataclasses.replace(manifest, tiers=kept), {k: v for k, v in members.items() if k in wanted}
    )


def _check_isotropic(run: Run) -> None:
    if run.config.decoder.get("anisotropic"):
        raise UserError(
            f"{run.directory}: its Gaussians are anisotropic (decoder.anisotropic=true), which the player does not "
            "draw; train it without that option to export it"
        )


def on_front(tiers: Sequence[dict]) -> list[dict]:
    """The descriptions of tiers that pay; `full` always stays.

    A tier does not pay where another is no slower and no farther from the full model, both on the capture's poses and
    on mixed ones: within SAME_TIME and SAME_PSNR, for times vary, and such differences are none to choose by. Of two
    that are alike in all the closer one stays.
    """
    qualities = ("psnr_capture", "psnr_mixed")

    def beats(one: dict, other: dict) -> bool:
        near = all(one[q] >= other[q] - SAME_PSNR for q in qualities)
        return near and one["frame_ms"] <= SAME_TIME * other["frame_ms"]

    kept: list[dict] = []
    for tier in sorted(tiers, key=lambda t: (t["name"] == DEFAULT, sum(t[q] for q in qualities)), reverse=True):
        if not any(beats(other, tier) for other in kept):
            kept = [other for other in kept if other["name"] == DEFAULT or not beats(tier, other)] + [tier]
    return [tier for tier in tiers if any(tier is other for other in kept)]


def _with_needs(names: Sequence[str], run: Run) -> list[str]:
    """The tiers asked for and those they read, each once, `full` first; UserError for an unknown one, or of a static
    avatar, whose look is already one for all poses."""
    wanted = []
    for name in dict.fromkeys(names):
        for needed in (*TIERS[name].factory.needs, name):
            if needed not in wanted and needed != DEFAULT:
                wanted.append(needed)
    if wanted and run.avatar.encoder is None:
        raise UserError(
            f"{run.directory}: a static avatar needs no tiers (asked: {', '.join(wanted)}): it is decoded once; leave "
            "--tiers out"
        )
    return [DEFAULT, *wanted] if wanted else []


def _manifest(run: Run) -> Manifest:
    config, data = run.config, run.built.body.data
    dynamic = run.avatar.encoder is not None
    components = {"encoder": config.encoder["name"] if dynamic else "none", "decoder": config.decoder["name"]}
    if dynamic:
        components["encoder_inputs"] = list(encoder_inputs(run.avatar.encoder))
    return Manifest(
        name=run.capture.name,
        gaussians=len(run.avatar.surface),
        dynamic=dynamic,
        body={
            "model": data.name,
            "joints": data.num_joints,
            "betas": data.num_betas,
            "expression": data.num_expression,
            "license": getattr(run.built.body, "license", "unknown"),
        },
        components=components,
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
            "pixel_m": run.pixel and run.pixel / run.config.rasterizer.get("resolution", 1.0),  # played at the full one
        },
        rasterizer={name: config.rasterizer[name] for name in SWITCHES if config.rasterizer.get(name)},
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
