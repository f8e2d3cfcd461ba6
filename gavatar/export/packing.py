"""What a bundle holds of a run: its manifest and the members that playing needs."""

from __future__ import annotations

from gavatar_runtime.avatar.expression import MEMBER as EXPRESSION
from gavatar_runtime.avatar.pose_blendshapes import MEMBER as POSE_BLENDSHAPES
from gavatar_runtime.bundle import (
    BODY,
    DECODER,
    ENCODER,
    FORMAT_VERSION,
    SURFACE,
    Manifest,
    pack_arrays,
    pack_body,
    pack_surfaces,
)
from gavatar_runtime.values.point_evidence import MEMBER as EVIDENCE

from ..avatar.blendshapes import expression_of, pose_blendshapes_of
from ..registry import ENCODERS, RASTERIZERS, split_node
from ..training.run import Run
from .onnx_graphs import OPSET, decoder_model, encoder_model, with_metadata


def manifest_of(run: Run) -> Manifest:
    """What the bundle of a run says of itself before anything is measured. run: whose avatar stands on the points of
    the bundle."""
    config, data = run.config, run.built.body.data
    dynamic = run.avatar.encoder is not None
    (static,) = ENCODERS.having(static=True)
    components = {"encoder": config.encoder["name"] if dynamic else static, "decoder": config.decoder["name"]}
    if dynamic:
        components["encoder_inputs"] = list(run.avatar.encoder_traits.inputs)
    rasterizer = RASTERIZERS.traits(*split_node(config.rasterizer))
    return Manifest(
        name=run.capture.name,
        gaussians=len(run.avatar.surface),
        dynamic=dynamic,
        body={
            "model": data.name,
            "joints": data.num_joints,
            "betas": data.num_betas,
            "expression": data.num_expression,
            "license": run.built.body.license,
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
            "points": config.points["name"],
            "seed": config.seed,
            "not_filmed": list(run.capture.resting),
            "pixel_m": run.pixel and run.pixel / rasterizer.resolution,  # played at the full one
        },
        rasterizer=rasterizer.played_with,
    )


def metadata_of(manifest: Manifest) -> dict[str, str]:
    """What each network of the bundle says of itself."""
    return {
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


def members_of(run: Run, manifest: Manifest) -> dict[str, bytes]:
    """The members without which the avatar cannot play, and those of its body's blendshapes."""
    avatar, data, betas, metadata = run.avatar, run.built.body.data, run.built.betas, metadata_of(manifest)
    members = {DECODER: with_metadata(decoder_model(avatar), metadata)}
    encoder_map, sees_normals = None, False
    if manifest.dynamic:
        members[ENCODER] = with_metadata(encoder_model(avatar), metadata)
        encoder_map = run.built.atlas(avatar.encoder.map_size)
        sees_normals = "normal_map" in avatar.encoder_traits.inputs
    members[SURFACE] = pack_surfaces(avatar.surface, encoder_map, sees_normals)
    joints = data.shaped(betas)[1]
    members[BODY] = pack_body(data.joint_names, data.parents, joints, betas, data.rest_pose, data.hands)
    expression = expression_of(data, avatar.surface)
    if expression is not None:
        members[EXPRESSION] = pack_arrays(expression.to_arrays())
    if avatar.config.pose_blendshapes:
        members[POSE_BLENDSHAPES] = pack_arrays(pose_blendshapes_of(data, avatar.surface).to_arrays())
    if run.evidence is not None:
        members[EVIDENCE] = pack_arrays(run.evidence.on(avatar.surface).to_arrays())
    return members
