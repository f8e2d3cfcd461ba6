"""The avatar: learnable features + encoder + decoder on a body's surface, posed into Gaussians.

G(beta, theta, D, P) = Splatting(LBS(D, J(beta), theta, w), P),   D = T(beta) + dT      (paper, equation 4)
"""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from gavatar_runtime.avatar.pose_blendshapes import canonical_rotations
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.gaussians import Gaussians
from gavatar_runtime.values.surface import Surface

from ..attributes import Attributes
from ..body.skeleton import Skeleton
from ..registry import DecoderTraits, EncoderTraits
from .blendshapes import expression_of, pose_blendshapes_of, shape_of
from .torch_skinning import can_skin_sparse, skin, skin_rotations, skin_sparse, skinning_weights
from .uv_sampling import Sampler


@dataclasses.dataclass
class AvatarConfig:
    """features: channels of the learnable tensor. feature_size: its side. smoothing: three linear 5x5 convolutions on
    it (upstream; folded away at export). init_std: of the tensor's initial values. pose_blendshapes: add those of the
    live pose to the surface points, as the body's own skin has them; the authors' code leaves them out."""

    features: int = 64
    feature_size: int = 128
    smoothing: bool = False
    init_std: float = 0.1
    pose_blendshapes: bool = False


@dataclasses.dataclass(frozen=True)
class Pose:
    """B poses that an avatar takes: all that changes from frame to frame. A further quantity of that kind is a field
    here, used by `Avatar.pose` and filled by `training.motion_table.MotionTable`; nothing between them names it.

    rotations: (B, J, 3, 3) local joint rotations. trans: (B, 3) metres. expression: (B, E) coefficients, None for the
    face as the body has it.
    """

    rotations: Tensor
    trans: Tensor
    expression: Tensor | None = None

    def __len__(self) -> int:
        return len(self.trans)

    def __getitem__(self, rows: slice | list[int]) -> Pose:
        """The poses of these rows."""
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return dataclasses.replace(self, **{n: value[rows] for n, value in values.items() if value is not None})


class Avatar(nn.Module):
    """One person's avatar. Its parameters: `features`, `smooth`, `encoder`, `decoder`; all else is derived.

    encoder: None for a static avatar. encoder_traits, decoder_traits: what these can. The sampled surface
    is not part of the state: `sample_at` may replace it by a denser or sparser sampling of the same body at any time
    (coarse-to-fine training, level of detail).
    """

    # set by `sample_at`
    points: Tensor
    weights: Tensor
    joint_index: Tensor
    joint_weight: Tensor
    uv: Tensor
    spacing: Tensor
    _pose_directions: Tensor
    _pose_canonical: Tensor
    _corner: Tensor
    _corner_weight: Tensor
    _canonical_turn: Tensor

    def __init__(
        self,
        config: AvatarConfig,
        skeleton: Skeleton,
        encoder: nn.Module | None,
        decoder: nn.Module,
        encoder_traits: EncoderTraits | None = None,
        decoder_traits: DecoderTraits | None = None,
    ):
        super().__init__()
        self.config, self.skeleton = config, skeleton
        self.encoder: Any = encoder  # modules that are an `Encoder` and a `Decoder` too: no type is both at once
        self.decoder: Any = decoder
        self.encoder_traits = encoder_traits or EncoderTraits(static=encoder is None)
        self.decoder_traits = decoder_traits or DecoderTraits()
        self.with_normals = False  # whether `pose` gives normals, for rasterizers that want them
        size = config.feature_size
        features = config.init_std * torch.randn(1, config.features, size, size)
        # a texel's channels side by side, as they are sampled
        self.features = nn.Parameter(features.contiguous(memory_format=torch.channels_last))
        self.smooth = nn.Sequential()
        if config.smoothing:
            convs = (nn.Conv2d(config.features, config.features, 5, padding=2, bias=False) for _ in range(3))
            self.smooth = nn.Sequential(*convs)
        self._surface: Surface | None = None
        self.mixed_precision = False  # decode in bfloat16 while training
        self._expressions: tuple[Surface, Tensor, Tensor, Tensor] | None = None  # of the surface: what they do to it
        self._shapes: tuple[Surface, Tensor, Tensor] | None = None  # of the surface: what betas do to it

    @property
    def placed(self) -> bool:
        """Whether it stands on a surface."""
        return self._surface is not None

    @property
    def surface(self) -> Surface:
        """What its points were sampled from. Raises UserError before `sample_at`."""
        if self._surface is None:
            raise UserError("the avatar has no points yet: call sample_at first")
        return self._surface

    def sample_at(self, surface: Surface) -> None:
        """Place the Gaussians on the points of `surface`."""
        device, dtype = self.features.device, self.features.dtype
        self._surface = surface
        for name, values in {
            "points": torch.as_tensor(surface.points, dtype=dtype),
            "weights": skinning_weights(surface, len(self.skeleton.parents), dtype),
            "joint_index": torch.as_tensor(surface.joint_index, dtype=torch.int32).contiguous(),
            "joint_weight": torch.as_tensor(surface.joint_weight, dtype=dtype).contiguous(),
            "uv": torch.as_tensor(surface.uv, dtype=dtype),
            "spacing": torch.as_tensor(surface.spacing, dtype=dtype),
        }.items():
            self.register_buffer(name, values.to(device), persistent=False)
        self._sample = Sampler(surface.uv)
        if self.config.pose_blendshapes:
            self._register_pose_blendshapes(surface)

    def sampled(self, surface: Surface) -> Avatar:
        """The same avatar on the points of another surface. It shares every parameter; this one stays as it is."""
        twin = copy.copy(self)
        for name in ("_parameters", "_buffers", "_modules", "_non_persistent_buffers_set"):
            setattr(twin, name, copy.copy(getattr(self, name)))
        twin.sample_at(surface)
        return twin

    def attributes(self, pose_features: Tensor | None = None) -> Attributes:
        """Decode every point. pose_features: (B, C, M, M) or None -> Attributes with leading B (1 when None)."""
        if not self.placed:
            raise UserError("the avatar has no points yet: call sample_at first")
        maps = self.smooth(self.features)
        if pose_features is not None and pose_features.shape[-2:] == maps.shape[-2:]:
            features = self._sample(maps + pose_features, self.uv)  # sampling is linear
        elif pose_features is not None:
            features = self._sample(maps, self.uv) + self._sample(pose_features, self.uv)
        else:
            features = self._sample(maps, self.uv)
        B, N, C = features.shape
        # what is evaluated and exported is float32
        with torch.autocast(features.device.type, torch.bfloat16, enabled=self.mixed_precision and self.training):
            out = self.decoder(features.reshape(B * N, C), self.uv.repeat(B, 1), self.spacing.repeat(B))
        rotations = None if out.rotations is None else out.rotations.view(B, N, 4)
        scales = out.scales.view(B, N, *out.scales.shape[1:])
        return Attributes(out.offsets.view(B, N, 3), out.colors.view(B, N, 3), scales, rotations)

    def encode(self, *inputs: Tensor) -> Tensor | None:
        """The encoder's inputs (`encoder_traits.inputs`) -> pose features, or None for a static avatar."""
        return None if self.encoder is None else self.encoder(*inputs)

    def pose(self, attributes: Attributes, pose: Pose, betas_change: Tensor | None = None) -> list[Gaussians]:
        """B sets of Gaussians in the world, opacity 1, isotropic unless the attributes have rotations. Attributes with
        a leading 1 serve every pose. betas_change: (n,) added to the first n betas that the surface was sampled at, or
        None. Raises UserError for an expression that the body has not."""
        rotations, trans = pose.rotations, pose.trans
        points, shift = self.points + attributes.offsets, None
        if self.config.pose_blendshapes:
            points = points + self._pose_offsets(rotations)
        if pose.expression is not None:
            moved, shift = self._expressed(pose.expression)
            points = points + moved
        if betas_change is not None:
            moved, joints = self._shaped(betas_change)
            points, shift = points + moved, joints if shift is None else shift + joints
        transforms = self.skeleton.canonical_to_posed(rotations, shift)
        nothing = [None] * len(rotations)
        normals = self._turned_normals(transforms) if self.with_normals else nothing
        if can_skin_sparse(points):
            means = skin_sparse(points, self.joint_index, self.joint_weight, transforms)
        else:
            means = skin(points, self.weights, transforms)
        quaternions: Tensor | list[None] = nothing
        if attributes.rotations is not None:
            quaternions = skin_rotations(attributes.rotations, self.weights, transforms, self.skeleton.parents)
        # unbound at once: the gradient of each row taken by itself would be a tensor as large as all of them
        scales, colors = attributes.scales.unbind(), attributes.colors.unbind()
        return [
            Gaussians(
                mean,
                scales[min(b, len(scales) - 1)],
                colors[min(b, len(colors) - 1)],
                quaternions=quaternions[b],
                normals=normals[b],
            )
            for b, mean in enumerate((means + trans[:, None]).unbind())
        ]

    def _register_pose_blendshapes(self, surface: Surface) -> None:
        known = pose_blendshapes_of(self.skeleton.data, surface)
        device, dtype = self.features.device, self.features.dtype
        for name, values in {
            "_pose_directions": known.directions.reshape(-1, known.directions.shape[2] * 3),
            "_pose_canonical": known.canonical.reshape(-1),
            "_corner": known.corner.astype(np.int64),
            "_corner_weight": known.corner_weight,
            "_canonical_turn": canonical_rotations(surface),
        }.items():
            kind = torch.int64 if name == "_corner" else dtype
            self.register_buffer(name, torch.as_tensor(values, dtype=kind).to(device), persistent=False)

    def _pose_offsets(self, rotations: Tensor) -> Tensor:
        """(B, N, 3) what the pose blendshapes of local rotations (B, J, 3, 3) add to the canonical points."""
        feature = rotations[:, 1:].flatten(1) - self._pose_canonical
        vertices = (feature @ self._pose_directions).unflatten(1, (-1, 3))
        parts = (vertices[:, self._corner[:, k]] * self._corner_weight[:, k, None] for k in range(3))
        return torch.einsum("nab,...nb->...na", self._canonical_turn, sum(parts))

    @torch.no_grad()
    def _turned_normals(self, transforms: Tensor) -> Tensor:
        """(B, N, 3) normals of the body's surface in the world, of length 1 or less, without gradient."""
        turns = transforms.detach().clone()
        turns[..., 3] = 0
        normals = torch.as_tensor(self.surface.normals, dtype=turns.dtype, device=turns.device)[None]
        if can_skin_sparse(normals):
            return skin_sparse(normals, self.joint_index, self.joint_weight, turns)
        return skin(normals, self.weights, turns)

    def _expressed(self, coefficients: Tensor) -> tuple[Tensor, Tensor]:
        """What an expression (B, E) adds to the canonical points, (B, N, 3), and to the rest joints, (B, J, 3)."""
        used, count = coefficients.shape[1], self.skeleton.data.num_expression
        if used > count:
            raise UserError(f"the body has {count} expression coefficients, not {used}")
        moved = coefficients.new_zeros(len(coefficients), len(self.surface), 3)
        if used == 0:
            return moved, coefficients.new_zeros(len(coefficients), len(self.skeleton.parents), 3)
        if self._expressions is None or self._expressions[0] is not self.surface:
            known = expression_of(self.skeleton.data, self.surface)
            if known is None:
                raise UserError("the body has no expressions")
            arrays = (known.rows, known.directions, known.joints)
            rows, directions, joints = (torch.as_tensor(a) for a in arrays)
        else:
            _, rows, directions, joints = self._expressions
        # where the avatar is at present: it may have been moved
        rows, directions, joints = (tensor.to(coefficients.device) for tensor in (rows, directions, joints))
        self._expressions = (self.surface, rows, directions, joints)
        moved[:, rows] = torch.einsum("be,nce->bnc", coefficients, directions[..., :used].to(coefficients.dtype))
        return moved, torch.einsum("be,jce->bjc", coefficients, joints[..., :used].to(coefficients.dtype))

    def _shaped(self, change: Tensor) -> tuple[Tensor, Tensor]:
        """What a change of the first betas, (n,), adds to the canonical points, (N, 3), and the rest joints, (J, 3).
        The points' spacing stays that of the sampled surface."""
        count = len(change)
        if self._shapes is None or self._shapes[0] is not self.surface or self._shapes[1].shape[-1] != count:
            points, joints = (torch.as_tensor(d) for d in shape_of(self.skeleton.data, self.surface, count))
        else:
            _, points, joints = self._shapes
        points, joints = points.to(change), joints.to(change)
        self._shapes = (self.surface, points, joints)
        return points @ change, joints @ change
