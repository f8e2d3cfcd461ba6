"""From a configuration to live objects: body, avatar, rasterizer."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np
import torch

from gavatar_runtime.components import Registry
from gavatar_runtime.decoding.pose_inputs import input_shapes, pose_inputs
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions.fitting import EXPRESSIONS, HAND_DATA, fit_motion
from gavatar_runtime.notes import Note
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Atlas

from .avatar.atlas import check_resolution, sample_atlas
from .avatar.trainable import Avatar, AvatarConfig
from .body.skeleton import Skeleton
from .capture.capture import Capture
from .protocols import Body, Rasterizer
from .registry import BODIES, DECODERS, ENCODERS, RASTERIZERS, resolve, split_node


def choose_device(name: str) -> torch.device:
    """`auto` is CUDA when there is one, else the CPU."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise UserError(f"device '{name}' is not one torch knows: use auto, cpu or cuda") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise UserError("device=cuda was asked for, but torch sees no CUDA device: use device=cpu")
    return device


def build_rasterizer(node: dict[str, Any], avatar: Avatar | None = None) -> Rasterizer:
    """The rasterizer of a composed node. avatar: what it is to draw, which then gives normals if it wants some."""
    rasterizer: Rasterizer = RASTERIZERS.build(*split_node(node))
    if avatar is not None:
        avatar.with_normals = rasterizer.wants_normals
    return rasterizer


def resolve_body(node: dict[str, Any], capture: Capture) -> dict[str, Any]:
    """The node of a body, one that chooses by the capture replaced by the one it chooses."""
    return resolve(BODIES, node, capture)


def build_body(node: dict[str, Any], capture: Capture) -> Body:
    """The body of a composed node for a capture."""
    return BODIES.build(*split_node(resolve_body(node, capture)))


def capture_on_body(capture: Capture, data: BodyData) -> Capture:
    """The capture with its motion placed on a body (`Capture.placed`) and one rotation a joint of it, matched by the
    joints' names: fingers stay fingers, whether the poses come with a jaw or without. Moving joints that the body lacks
    are named in a warning."""
    capture = capture.placed(data)
    fitted: dict[str, Any] = {}
    for key in ("motion", "truth"):
        motion = getattr(capture, key)
        if motion is not None:
            fitted[key], ignored = fit_motion(
                motion, data.joint_names, data.rest_pose, hands=data.hands, num_expression=data.num_expression
            )
            others = [name for name in ignored if name in (HAND_DATA, EXPRESSIONS)]
            joints = [name for name in ignored if name not in others]
            if joints and key == "motion":
                warnings.warn(f"body '{data.name}' lacks joints that move in {capture.path}: {', '.join(joints)}", Note)
            if others and key == "motion":
                warnings.warn(
                    f"body '{data.name}' has no {' and no '.join(others)}: those of {capture.path} are ignored",
                    Note,
                )
    return dataclasses.replace(capture, **fitted)


@dataclasses.dataclass
class AvatarBuild:
    """An untrained avatar and what it stands on. atlas(R) samples the body's atlas at R x R texels, cached."""

    body: Body
    betas: np.ndarray | None
    avatar: Avatar
    canonical: dict[int, Atlas] = dataclasses.field(default_factory=dict)

    def atlas(self, resolution: int) -> Atlas:
        if resolution not in self.canonical:
            self.canonical[resolution] = sample_atlas(self.body.data, self.betas, resolution)
        return self.canonical[resolution]

    def reshape(self, betas: np.ndarray) -> None:
        """The same avatar on the body of other shape coefficients; what was sampled of the former is forgotten."""
        device = self.avatar.features.device
        self.betas = betas
        self.canonical.clear()
        self.avatar.skeleton = Skeleton(self.body.data, betas).to(device)

    def encoder_tensors(self, poses: np.ndarray) -> list[torch.Tensor]:
        """What the avatar's encoder looks at of (B, J, 3) axis-angle poses, on the avatar's device."""
        surface, names = self.atlas(self.avatar.encoder.map_size), tuple(self.avatar.encoder_traits.inputs)
        arrays = pose_inputs(surface, np.asarray(poses, np.float32), names)
        return [torch.from_numpy(array).to(self.avatar.features.device) for array in arrays]


def build_avatar(
    body_node: dict, encoder_node: dict, decoder_node: dict, avatar: AvatarConfig, capture: Capture, seed: int
) -> AvatarBuild:
    """An avatar of the capture's body, shaped by its betas, with freshly initialised parameters (a function of `seed`
    alone)."""
    body = build_body(body_node, capture)
    if avatar.pose_blendshapes and body.data.posedirs is None:
        raise UserError(
            f"avatar.pose_blendshapes=true: body '{body.data.name}' has no pose blendshapes; leave the option out"
        )
    betas = capture.placed(body.data).motion.betas
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        decoder, decoder_traits = _network(DECODERS, decoder_node, in_channels=avatar.features)
        encoder, encoder_traits = _network(ENCODERS, encoder_node, channels=avatar.features, map_size=None)
        if encoder is not None:
            check_resolution(encoder.map_size, "encoder.map_size")
            if encoder_traits.inputs != input_shapes(*encoder_traits.inputs):
                raise UserError(f"encoder '{encoder_node['name']}': its inputs have other shapes than it declares")
        skeleton = Skeleton(body.data, betas)
        return AvatarBuild(body, betas, Avatar(avatar, skeleton, encoder, decoder, encoder_traits, decoder_traits))


# what an encoder or decoder may have, and the trait that says so: nothing else would look for it
_DECLARED = {"on_step": "counts_steps", "mixed_precision": "mixed_precision", "prepare": "prepares", "inputs": "inputs"}


def _network(registry: Registry, node: dict[str, Any], **context: Any) -> tuple[Any, Any]:
    """A component of a composed node and its traits; UserError where these are silent on what it has."""
    name, options = split_node(node)
    network, traits = registry.build(name, options, **context), registry.traits(name, options)
    said, usual = dataclasses.asdict(traits), dataclasses.asdict(registry.usual_traits)
    for member, trait in _DECLARED.items():
        if trait in said and said[trait] == usual[trait] and hasattr(network, member):
            raise UserError(
                f"{registry.group} '{name}' has `{member}`, which its traits do not say: register it with "
                f"traits={type(traits).__name__}({trait}=...)"
            )
    return network, traits
