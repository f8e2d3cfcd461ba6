"""From a configuration to live objects: body, avatar, rasterizer."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from gavatar_runtime.components import Registry
from gavatar_runtime.decoding.pose_inputs import input_shapes, pose_inputs
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions.fitting import EXPRESSIONS, HAND_DATA, fit_motion
from gavatar_runtime.notes import Note
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Atlas, Surface

from .avatar.atlas import check_resolution, sample_atlas
from .avatar.trainable import Avatar, AvatarConfig
from .body.skeleton import Skeleton
from .capture.capture import Capture
from .config import LevelConfig, TrainConfig
from .protocols import Body, PointPolicy, Rasterizer
from .registry import BODIES, DECODERS, ENCODERS, POINTS, RASTERIZERS, PointTraits, resolve, split_node


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
    """An untrained avatar and what it stands on: the points that `policy` places on its body, and maps over that.

    levels: at which it is trained; with a policy whose points are no texels, those of each are a prefix of the finest.
    """

    body: Body
    betas: np.ndarray | None
    avatar: Avatar
    policy: PointPolicy
    policy_traits: PointTraits = dataclasses.field(default_factory=PointTraits)
    levels: Sequence[LevelConfig] = ()
    canonical: dict[int, Atlas] = dataclasses.field(default_factory=dict)
    surfaces: dict[int, Surface] = dataclasses.field(default_factory=dict)

    def atlas(self, resolution: int) -> Atlas:
        """The body's atlas at `resolution` x `resolution` texels, a grid for maps; cached."""
        if resolution not in self.canonical:
            self.canonical[resolution] = sample_atlas(self.body.data, self.betas, resolution)
        return self.canonical[resolution]

    def count(self, level: LevelConfig) -> int:
        """The number of points of a level: what it says, or that of the texels of the atlas it names."""
        if level.gaussians is not None:
            return level.gaussians
        if level.uv is None:
            raise ValueError("a level names neither a number of points nor an atlas")
        return len(self.atlas(level.uv))

    def surface(self, count: int) -> Surface:
        """`count` points of the body, where its Gaussians are; cached."""
        if count not in self.surfaces:
            finest = count if self.policy_traits.texels else max([count, *map(self.count, self.levels)])
            if finest == count:
                self.surfaces[count] = self.policy.sample(self.body.data, self.betas, count)
            else:
                self.surfaces[count] = self.surface(finest).prefix(count)
        return self.surfaces[count]

    @property
    def head(self) -> int | None:
        """The joint of the head, None of a body without one."""
        names = list(self.body.data.joint_names)
        return names.index("head") if "head" in names else None

    def reshape(self, betas: np.ndarray) -> None:
        """The same avatar on the body of other shape coefficients; what was sampled of the former is forgotten."""
        device = self.avatar.features.device
        self.betas = betas
        self.canonical.clear()
        self.surfaces.clear()
        self.avatar.skeleton = Skeleton(self.body.data, betas).to(device)

    def encoder_tensors(self, poses: np.ndarray) -> list[torch.Tensor]:
        """What the avatar's encoder looks at of (B, J, 3) axis-angle poses, on the avatar's device."""
        surface, names = self.atlas(self.avatar.encoder.map_size), tuple(self.avatar.encoder_traits.inputs)
        arrays = pose_inputs(surface, np.asarray(poses, np.float32), names)
        return [torch.from_numpy(array).to(self.avatar.features.device) for array in arrays]


def build_avatar(
    body_node: dict, encoder_node: dict, decoder_node: dict, avatar: AvatarConfig, capture: Capture, seed: int,
    points_node: dict | None = None, levels: Sequence[LevelConfig] = (),
) -> AvatarBuild:  # fmt: skip
    """An avatar of the capture's body, shaped by its betas, with freshly initialised parameters (a function of `seed`
    alone). points_node: of the policy that places its points, None for the usual one. levels: see `AvatarBuild`."""
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
        made = Avatar(avatar, skeleton, encoder, decoder, encoder_traits, decoder_traits)
    name, options = split_node({"name": POINTS.default} if points_node is None else points_node)
    return AvatarBuild(body, betas, made, POINTS.build(name, options), POINTS.traits(name, options), levels)


def build_configured(config: TrainConfig, capture: Capture) -> AvatarBuild:
    """The untrained avatar of a configuration."""
    levels = [*config.stage1.levels, *config.stage2.levels]
    return build_avatar(
        config.body, config.encoder, config.decoder, config.avatar, capture, config.seed, config.points, levels
    )


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
