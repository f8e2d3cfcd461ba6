"""Pose features linear in what a pose does to each texel: the light that falls on it, and the joints about it.

A U-Net from nothing needs thousands of steps; learnable maps weighted by fixed functions of the pose fit in hundreds.
"""

from __future__ import annotations

import dataclasses
from typing import Any

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


# of the Frobenius norm of a rotation's change: what poses shake by from frame to frame tells nothing of cloth
SHAKING = 0.1
BANK = 48  # distinct poses of each joint that are kept, to tell how far a pose is from those that were seen
SPREAD_FLOOR = 0.02  # added to the variance of every harmonic: normals are not known better than to 5 degrees


@dataclasses.dataclass
class LinearConfig:
    """order: of the spherical harmonics of the normal, 0 (no light), 1 or 2. bases: maps for the joints about a texel,
    0 for none. reach: how far along the skeleton such a joint may be. beyond: the width, as a share of the range that
    training saw, over which what a pose does fades outside that range. thin: how much a weight must have varied,
    variance times distinct poses, to count half. map_size: side of the maps."""

    order: int = 1
    bases: int = 4
    reach: int = 2
    beyond: float = 0.1
    thin: float = 1.0
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
    """features(u, v) = sum_k fade_k(u, v) trust_k(u, v) (w_k(u, v) - mean_k(u, v)) F_k(u, v), the maps F = GAIN *
    `maps` learned from zero.

    The weights w are fixed functions of the pose: the spherical harmonics of the texel's normal in the WORLD, for the
    light stays with the room when the person turns; and for each body joint the first principal components of the
    rotations of the joints within `reach` of it, blended to the texel by its skinning weights.

    All else is taken from the training views that see a texel, a pose that recurs counted once. mean: so that what
    depends on the pose is zero in the mean. trust: n s / (n s + thin) of n distinct poses and a weight's variance s, as
    a ridge shrinks a coefficient: one that was seen in a single pose, or never, keeps its one look, and where nobody
    turns light changes nothing. fade: 1 in what was seen, and outside it less and less, down to the one look: by the
    distance of each joint from its nearest seen pose, and of each texel's normal from those that were seen of it.
    """

    mean: Tensor
    trust: Tensor
    carried: Tensor
    rotation_mean: Tensor
    components: Tensor
    bank: Tensor
    joint_width: Tensor
    light_precision: Tensor
    light_reach: Tensor
    low: Tensor | None
    high: Tensor | None

    def __init__(self, config: LinearConfig, *, channels: int, map_size: int | None = None):
        super().__init__()
        _check(config)
        self.config, self.map_size = config, config.map_size
        self.inputs = _inputs(config)
        M, J, K, L = config.map_size, SMPL_BODY_JOINTS, config.bases, (config.order + 1) ** 2 - 1
        self.light_count = L
        self.maps = nn.Parameter(torch.zeros(L + K, channels, M, M))
        shapes: dict[str, tuple[int, ...]] = {"mean": (L + K, M, M), "trust": (L + K, M, M)}
        if K:
            shapes |= {"carried": (J, M, M), "rotation_mean": (9 * J,), "components": (9 * J, J * K)}
            shapes |= {"bank": (BANK, J, K), "joint_width": (2, J)}
        if L:
            shapes |= {"light_precision": (L, L, M, M), "light_reach": (M, M)}
        for name, shape in shapes.items():
            self.register_buffer(name, torch.zeros(shape))
        for name in ("low", "high"):  # of an encoder that was trained when weights were clamped to their range
            self.register_buffer(name, None)

    @torch.no_grad()
    def prepare(self, surface: Atlas, seen: Tensor, *inputs: Tensor) -> None:
        """Take all but the maps from the training views. surface: of the maps. seen: (V, M, M) how much each view
        counts at each texel, 0 where it does not show it; a view's part among those of like poses, so that the sum over
        views is a number of distinct poses. inputs: those of `self.inputs` in every view."""
        given, seen = dict(zip(self.inputs, inputs, strict=True)), seen.to(self.mean)
        count, L = seen.sum(0), self.light_count
        if self.config.bases:
            rotations, share = given["joint_rotations"].flatten(1), seen.amax((1, 2))
            share = share / share.sum().clamp(min=1e-9)
            self.rotation_mean.copy_(share @ rotations)
            spread = rotations - self.rotation_mean
            self.components.copy_(_local_components(spread, share, surface.parents, self.config))
            self.carried.copy_(_carried(surface))
            self.bank.copy_(_distinct(self._coefficients(rotations), BANK))
            self._measure_joints(rotations)
        weights = self.weights(inputs)
        for k, weight in enumerate(weights.unbind(1)):
            self.mean[k] = (weight * seen).sum(0) / count.clamp(min=1e-6)
            evidence = ((weight - self.mean[k]).square() * seen).sum(0)  # variance times distinct poses
            self.trust[k] = evidence / (evidence + self.config.thin) if self.config.thin > 0 else (evidence > 0) * 1.0
        if L:
            self._measure_light(weights[:, :L] - self.mean[:L], seen, count)

    def _measure_joints(self, rotations: Tensor) -> None:
        """From which distance on a joint's pose is outside what was seen, and the width over which it fades."""
        nearest = self._distances(self._coefficients(rotations)).amax(0)
        apart = (self.bank[:, None] - self.bank).square().sum(-1).sqrt().amax((0, 1))
        self.joint_width.copy_(torch.stack([nearest, self.config.beyond * apart]))

    def _measure_light(self, centred: Tensor, seen: Tensor, count: Tensor) -> None:
        """The inverse covariance of each texel's harmonics, and the farthest that they were seen from their mean."""
        L = self.light_count
        covariance = torch.einsum("vaij,vbij,vij->ijab", centred, centred, seen)
        covariance /= count.clamp(min=1e-6)[..., None, None]
        covariance += SPREAD_FLOOR * torch.eye(L, dtype=covariance.dtype, device=covariance.device)
        self.light_precision.copy_(torch.linalg.inv(covariance).permute(2, 3, 0, 1))
        self.light_reach.copy_((self._light_distances(centred) * (seen > 0)).amax(0))

    def forward(self, *inputs: Tensor) -> Tensor:
        """Inputs as `self.inputs` names them: normal_map (B, 3, M, M), joint_rotations (B, 22, 3, 3)
        -> (B, C, M, M) pose features."""
        weights = self.held_weights(inputs)
        # one product a map: all at once would hold K times as many floats
        maps = GAIN * self.maps
        total = weights[:, :1] * maps[0]
        for k in range(1, len(maps)):
            total = total + weights[:, k : k + 1] * maps[k]
        return total

    def held_weights(self, inputs: tuple[Tensor, ...]) -> Tensor:
        """(B, K, M, M) how much each map counts in each pose: centred, shrunk, faded outside what was seen."""
        centred = self.weights(inputs) - self.mean
        if self.low is not None and self.high is not None:
            return torch.minimum(torch.maximum(centred, self.low), self.high)
        given, L, parts = dict(zip(self.inputs, inputs, strict=True)), self.light_count, []
        if L:
            light = centred[:, :L]
            width = 2 * self.config.beyond * self.light_reach
            parts.append(light * _fade(self._light_distances(light) - self.light_reach, width)[:, None])
        if self.config.bases:
            coefficients = self._coefficients(given["joint_rotations"].flatten(1))
            near, width = self.joint_width.unbind()
            faded = _fade(self._distances(coefficients) - near, width)
            weights = self._carry(coefficients * faded[..., None])
            share = (faded @ self.carried.flatten(1)).view(-1, 1, *self.mean.shape[1:])
            parts.append(weights - share * self.mean[L:])
        return torch.cat(parts, 1) * self.trust

    def weights(self, inputs: tuple[Tensor, ...]) -> Tensor:
        """(B, K, M, M) the fixed functions of the pose."""
        given = dict(zip(self.inputs, inputs, strict=True))
        weights = []
        if self.config.order:
            shares = [1.0] * 3 + [SECOND_DEGREE] * 5 * (self.config.order - 1)
            values = harmonics(given["normal_map"], self.config.order)
            weights.append(values * values.new_tensor(shares)[:, None, None])
        if self.config.bases:
            weights.append(self._carry(self._coefficients(given["joint_rotations"].flatten(1))))
        return torch.cat(weights, 1)

    def _coefficients(self, rotations: Tensor) -> Tensor:
        """(B, 9 J) -> (B, J, K) principal components of the rotations about each joint."""
        return ((rotations - self.rotation_mean) @ self.components).unflatten(1, (-1, self.config.bases))

    def _carry(self, coefficients: Tensor) -> Tensor:
        """(B, J, K) of joints -> (B, K, M, M) of texels."""
        return (coefficients.transpose(1, 2) @ self.carried.flatten(1)).unflatten(-1, self.carried.shape[1:])

    def _distances(self, coefficients: Tensor) -> Tensor:
        """(B, J) of each joint from the nearest pose that is kept."""
        return (coefficients[:, None] - self.bank).square().sum(-1).amin(1).sqrt()

    def _light_distances(self, centred: Tensor) -> Tensor:
        """(B, M, M) of centred harmonics (B, L, M, M) from their mean, in standard deviations (Mahalanobis)."""
        turned = (self.light_precision * centred[:, None]).sum(2)
        return (turned * centred).sum(1).clamp(min=0).sqrt()

    def _load_from_state_dict(self, state: dict[str, Tensor], prefix: str, *arguments: Any) -> None:
        """Also of encoders that were trained when weights were clamped: they go on as they were."""
        if f"{prefix}low" in state:
            self.low, self.high = torch.zeros_like(self.mean), torch.zeros_like(self.mean)
            for name, buffer in self.named_buffers():
                state.setdefault(prefix + name, buffer)
        super()._load_from_state_dict(state, prefix, *arguments)


def _fade(outside: Tensor, width: Tensor) -> Tensor:
    """1 down to 0 by the distance outside what was seen: a Gaussian of this width; where nothing varied, at once."""
    return torch.exp(-0.5 * (outside.clamp(min=0) / width.clamp(min=1e-3)).square())


def _distinct(poses: Tensor, count: int) -> Tensor:
    """(V, J, K) -> (count, J, K): for each joint the poses that lie farthest apart, one after another; with fewer
    poses than that, some of them repeat."""
    joints = torch.arange(poses.shape[1], device=poses.device)
    chosen = [torch.zeros_like(joints)]
    near = poses.new_full(poses.shape[:2], torch.inf)
    for _ in range(count - 1):
        near = torch.minimum(near, (poses - poses[chosen[-1], joints]).square().sum(-1))
        chosen.append(near.argmax(0))
    return torch.stack([poses[c, joints] for c in chosen])


def harmonics(normals: Tensor, order: int) -> Tensor:
    """(B, 3, ...) unit normals -> (B, 3 or 8, ...) real spherical harmonics of degrees 1 to `order` (1 or 2), each with
    mean square 1 over the sphere. Diffuse light is 99 % within degree 2 (Ramamoorthi & Hanrahan 2001)."""
    x, y, z = normals.unbind(1)
    values = [v * 3**0.5 for v in (x, y, z)]
    if order == 2:
        values += [v * 15**0.5 for v in (x * y, y * z, z * x, (x * x - y * y) / 2)]
        values.append((2 * z * z - x * x - y * y) * (5**0.5 / 2))
    return torch.stack(values, 1)


def _local_components(spread: Tensor, share: Tensor, parents: np.ndarray, config: LinearConfig) -> Tensor:
    """(9 J, J K): for each joint the principal directions of the rotations within its reach, farther joints halved a
    step, scaled so that the first weight has a variance of 1 over training and weaker ones less, down to nothing where
    rotations do no more than shake. share: (V,) of each view, with sum 1."""
    steps = joint_distances(parents, SMPL_BODY_JOINTS)
    out = spread.new_zeros(SMPL_BODY_JOINTS, config.bases, 9 * SMPL_BODY_JOINTS)
    for joint in range(SMPL_BODY_JOINTS):
        near = torch.from_numpy(np.where(steps[joint] <= config.reach, 0.5 ** steps[joint], 0.0)).to(spread)
        weight = near.repeat_interleave(9)
        _, sizes, directions = torch.linalg.svd(spread * weight * share.sqrt()[:, None], full_matrices=False)
        deviation = sizes[: config.bases]
        if len(deviation) and deviation[0] > 1e-4:  # else these joints never move
            scale = 2 / (deviation + deviation[0]) * deviation.square() / (deviation.square() + SHAKING**2)
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
    if min(config.reach, config.beyond, config.thin) < 0:
        raise UserError("encoder.reach, encoder.beyond and encoder.thin must not be negative")
