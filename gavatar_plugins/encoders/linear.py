"""Pose features linear in what a pose does to each texel: the light that falls on it, and the joints about it.

A U-Net from nothing needs thousands of steps; learnable maps weighted by fixed functions of the pose fit in hundreds.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor, nn

from gavatar.avatar.atlas import check_resolution
from gavatar.registry import ENCODERS, EncoderTraits
from gavatar_runtime.decoding.pose_inputs import input_shapes
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.body import SMPL_BODY_JOINTS
from gavatar_runtime.values.surface import Atlas

GAIN = 5.0  # of the parameters, so that a rate which suits a network's weights suits the maps
# what a surface that scatters evenly returns of light of degree 2 beside degree 1 (Ramamoorthi & Hanrahan 2001, eq. 9)
SECOND_DEGREE = 3 / 8


@dataclasses.dataclass
class LinearConfig:
    """order: of the spherical harmonics of the normal, 0 (no light), 1 or 2. bases: maps for the joints about a texel,
    0 for none. reach: how far along the skeleton such a joint may be. beyond: how far outside the range that training
    saw a weight may go, as a share of that range. map_size: side of the maps."""

    order: int = 1
    bases: int = 4
    reach: int = 2
    beyond: float = 0.25
    map_size: int = 64


def _inputs(config: LinearConfig) -> tuple[str, ...]:
    return (("normal_map",) if config.order else ()) + (("joint_rotations",) if config.bases else ())


@ENCODERS.register(
    "linear",
    config=LinearConfig,
    summary="maps weighted by each texel's light and by nearby joints",
    traits=lambda config: EncoderTraits(inputs=input_shapes(*_inputs(config)), prepares=True),
)
class LinearEncoder(nn.Module):
    """features(u, v) = sum_k clamp(w_k(u, v) - mean_k(u, v)) F_k(u, v), the maps F = GAIN * `maps` learned from zero.

    The weights w are fixed functions of the pose: the spherical harmonics of the texel's normal in the WORLD, for the
    light stays with the room when the person turns; and for each body joint the first principal components of the
    rotations of the joints within `reach` of it, blended to the texel by its skinning weights.

    Mean and bounds are those of the training views that see the texel: a texel is not led far from what was seen of it.
    One that was seen in a single pose, or never, keeps its one look, and where nobody turns light changes nothing.
    """

    mean: Tensor
    low: Tensor
    high: Tensor
    carried: Tensor
    rotation_mean: Tensor
    components: Tensor

    def __init__(self, config: LinearConfig, *, channels: int, map_size: int | None = None):
        super().__init__()
        _check(config)
        self.config, self.map_size = config, config.map_size
        self.inputs = _inputs(config)
        M, J, K = config.map_size, SMPL_BODY_JOINTS, config.bases
        count = (config.order + 1) ** 2 - 1 + K
        self.maps = nn.Parameter(torch.zeros(count, channels, M, M))
        for name in ("mean", "low", "high"):
            self.register_buffer(name, torch.zeros(count, M, M))
        if K:
            self.register_buffer("carried", torch.zeros(J, M, M))
            self.register_buffer("rotation_mean", torch.zeros(9 * J))
            self.register_buffer("components", torch.zeros(9 * J, J * K))

    @torch.no_grad()
    def prepare(self, surface: Atlas, seen: Tensor, *inputs: Tensor) -> None:
        """Take components, means and bounds from the training views. surface: of the maps. seen: (V, M, M) bool, the
        texels that each view shows. inputs: those of `self.inputs` in every view."""
        given = dict(zip(self.inputs, inputs, strict=True))
        if self.config.bases:
            rotations = given["joint_rotations"].flatten(1)
            self.rotation_mean.copy_(rotations.mean(0))
            self.components.copy_(_local_components(rotations - self.rotation_mean, surface.parents, self.config))
            self.carried.copy_(_carried(surface))
        for k, weight in enumerate(self.weights(inputs).unbind(1)):
            self.mean[k] = (weight * seen).sum(0) / seen.sum(0).clamp(min=1)
            centred = (weight - self.mean[k]) * seen
            low, high = centred.amin(0), centred.amax(0)
            self.low[k] = low - self.config.beyond * (high - low)
            self.high[k] = high + self.config.beyond * (high - low)

    def forward(self, *inputs: Tensor) -> Tensor:
        """Inputs as `self.inputs` names them: normal_map (B, 3, M, M), joint_rotations (B, 22, 3, 3)
        -> (B, C, M, M) pose features."""
        weights = torch.minimum(torch.maximum(self.weights(inputs) - self.mean, self.low), self.high)
        # one product a map: all at once would hold K times as many floats
        maps = GAIN * self.maps
        total = weights[:, :1] * maps[0]
        for k in range(1, len(maps)):
            total = total + weights[:, k : k + 1] * maps[k]
        return total

    def weights(self, inputs: tuple[Tensor, ...]) -> Tensor:
        """(B, K, M, M) how much each map counts in each pose, neither centred nor clamped."""
        given = dict(zip(self.inputs, inputs, strict=True))
        weights = []
        if self.config.order:
            shares = [1.0] * 3 + [SECOND_DEGREE] * 5 * (self.config.order - 1)
            values = harmonics(given["normal_map"], self.config.order)
            weights.append(values * values.new_tensor(shares)[:, None, None])
        if self.config.bases:
            coefficients = (given["joint_rotations"].flatten(1) - self.rotation_mean) @ self.components
            J, M, _ = self.carried.shape
            of_joint = coefficients.view(-1, J, self.config.bases).transpose(1, 2)
            weights.append((of_joint @ self.carried.flatten(1)).unflatten(-1, (M, M)))
        return torch.cat(weights, 1)


def harmonics(normals: Tensor, order: int) -> Tensor:
    """(B, 3, ...) unit normals -> (B, 3 or 8, ...) real spherical harmonics of degrees 1 to `order` (1 or 2), each with
    mean square 1 over the sphere. Diffuse light is 99 % within degree 2 (Ramamoorthi & Hanrahan 2001)."""
    x, y, z = normals.unbind(1)
    values = [v * 3**0.5 for v in (x, y, z)]
    if order == 2:
        values += [v * 15**0.5 for v in (x * y, y * z, z * x, (x * x - y * y) / 2)]
        values.append((2 * z * z - x * x - y * y) * (5**0.5 / 2))
    return torch.stack(values, 1)


def _local_components(spread: Tensor, parents: np.ndarray, config: LinearConfig) -> Tensor:
    """(9 J, J K): for each joint the principal directions of the rotations within its reach, farther joints halved a
    step, scaled so that the first weight has a variance of 1 over training and weaker ones less."""
    steps = joint_distances(parents, SMPL_BODY_JOINTS)
    out = spread.new_zeros(SMPL_BODY_JOINTS, config.bases, 9 * SMPL_BODY_JOINTS)
    for joint in range(SMPL_BODY_JOINTS):
        near = torch.from_numpy(np.where(steps[joint] <= config.reach, 0.5 ** steps[joint], 0.0)).to(spread)
        weight = near.repeat_interleave(9)
        _, sizes, directions = torch.linalg.svd(spread * weight, full_matrices=False)
        deviation = sizes[: config.bases] / len(spread) ** 0.5
        if len(deviation) and deviation[0] > 1e-4:  # else these joints never move
            scale = 2 / (deviation + deviation[0])
            out[joint, : len(deviation)] = directions[: config.bases] * weight * scale[:, None]
    return out.permute(2, 0, 1).reshape(9 * SMPL_BODY_JOINTS, -1)


def joint_distances(parents: np.ndarray, count: int) -> np.ndarray:
    """(count, count) int: steps along the skeleton between the first `count` joints."""
    chains = []
    for joint in range(count):
        chain = [joint]
        while parents[chain[-1]] >= 0:
            chain.append(int(parents[chain[-1]]))
        chains.append(chain)

    def steps(a: list[int], b: list[int]) -> int:
        common = next(joint for joint in a if joint in b)
        return a.index(common) + b.index(common)

    return np.array([[steps(a, b) for b in chains] for a in chains])


def _carried(surface: Atlas) -> Tensor:
    """(22, M, M) skinning weights over the atlas; fingers and face count to the body joint they hang from."""
    body = np.arange(surface.num_joints)
    for joint in range(SMPL_BODY_JOINTS, surface.num_joints):
        body[joint] = body[surface.parents[joint]]
    out = np.zeros((SMPL_BODY_JOINTS, surface.resolution**2), np.float32)
    for k in range(surface.joint_index.shape[1]):
        np.add.at(out, (body[surface.joint_index[:, k]], surface.texel), surface.joint_weight[:, k])
    return torch.from_numpy(out.reshape(SMPL_BODY_JOINTS, surface.resolution, surface.resolution))


def _check(config: LinearConfig) -> None:
    if config.order not in (0, 1, 2):
        raise UserError(f"encoder.order must be 0 (no light), 1 or 2, not {config.order}")
    if config.bases < 0:
        raise UserError(f"encoder.bases must not be negative, not {config.bases}")
    if not (config.order or config.bases):
        raise UserError("encoder.order and encoder.bases are both 0, so nothing is left to learn: use encoder=none")
    check_resolution(config.map_size, "encoder.map_size")
    if config.reach < 0 or config.beyond < 0:
        raise UserError("encoder.reach and encoder.beyond must not be negative")
