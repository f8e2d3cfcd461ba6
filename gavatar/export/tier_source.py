"""Building the tiers of an avatar: what every builder starts from, and how a fine surface reads a coarse one."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np
import onnx
import torch

from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.values.body import SMPL_BODY_JOINTS
from gavatar_runtime.values.surface import Atlas, Surface

from ..avatar.trainable import Avatar
from ..avatar.uv_sampling import bilinear
from ..protocols import TierSource
from ..training.posing import pose_features
from ..training.run import Run
from .onnx_graphs import with_metadata

MEAN_POSES = 24  # over which the still look is averaged: more moved it by less than an 8-bit step

_SIDES = {  # of the left side; the right one is its mirror image: y and z change sign
    1: ((-2.2, -0.4, -0.3), (0.5, 0.4, 0.7)),  # hip: bent forwards, out
    4: ((0.0, -0.1, -0.1), (2.4, 0.1, 0.1)),  # knee
    7: ((-0.6, -0.2, -0.2), (0.5, 0.2, 0.2)),  # ankle
    13: ((-0.2, -0.3, -0.2), (0.2, 0.3, 0.4)),  # collar
    16: ((-0.7, -1.5, -1.3), (0.7, 0.6, 1.5)),  # shoulder: arms down to high, forwards
    18: ((-0.3, -2.3, -0.3), (0.3, 0.1, 0.3)),  # elbow
}
RANGE = {  # radians by joint of the SMPL family, axis-angle from the T-pose
    3: ((-0.3, -0.3, -0.3), (0.8, 0.3, 0.3)), 6: ((-0.2, -0.3, -0.2), (0.6, 0.3, 0.2)),
    9: ((-0.2, -0.3, -0.2), (0.5, 0.3, 0.2)), 12: ((-0.4, -0.5, -0.3), (0.4, 0.5, 0.3)),
    15: ((-0.4, -0.5, -0.3), (0.4, 0.5, 0.3)), **_SIDES,
    **{j + 1: ((a[0], -b[1], -b[2]), (b[0], -a[1], -a[2])) for j, (a, b) in _SIDES.items()},
}  # fmt: skip


@dataclasses.dataclass
class AvatarSource(TierSource):
    """A trained run with dynamics as a `TierSource`. run: whose avatar stands on the points of the bundle. metadata: of
    the networks that are made of it. progress: shows bars."""

    run: Run
    metadata: Mapping[str, str] = dataclasses.field(default_factory=dict)
    progress: bool = True
    _placed: Avatar | None = dataclasses.field(default=None, init=False, repr=False)  # where it was decoded last

    @property
    def avatar(self) -> Avatar:
        return self.run.avatar

    @property
    def surface(self) -> Surface:
        return self.run.avatar.surface

    def surface_at(self, uv: int) -> Atlas:
        return self.run.built.atlas(uv)

    @functools.cached_property
    def train_poses(self) -> np.ndarray:
        frames = sorted({view.frame for view in self.run.capture.views(self.run.config.train_split)})
        return self.run.motion.motion().poses[frames].astype(np.float32)

    @property
    def mean_poses(self) -> np.ndarray:
        poses = self.train_poses
        return poses[evenly_spaced(len(poses), MEAN_POSES)]

    def finish(self, model: onnx.ModelProto) -> bytes:
        return with_metadata(model, self.metadata)

    def features(self, poses: np.ndarray) -> torch.Tensor:
        features = pose_features(self.avatar, self.run.built, poses)
        if features is None:
            raise ValueError("a static avatar has no pose features")
        return features

    @torch.no_grad()
    def decode(self, pose: np.ndarray, surface: Surface) -> np.ndarray:
        if self._placed is None or self._placed.surface is not surface:
            self._placed = self.avatar.sampled(surface)
        out = self._placed.attributes(self.features(pose[None]))
        return torch.cat([out.offsets[0], out.colors[0], out.scales[0][:, None]], -1).numpy()

    def mean(self, surface: Surface) -> np.ndarray:
        total = np.zeros((len(surface), 7))
        for pose in self.mean_poses:
            total += self.decode(pose, surface)
        return (total / len(self.mean_poses)).astype(np.float32)

    def random_poses(self, count: int, seed: int = 0) -> np.ndarray:
        """See `TierSource`: each body part's joints from a training frame of their own, and on half of them 0.15 rad of
        noise, so that parts are seen in combinations that were not filmed."""
        rng = np.random.default_rng(seed)
        poses = self.train_poses
        limb = limb_of_joints(self.run.built.body.data.parents)
        chosen = rng.integers(len(poses), size=(count, int(limb.max()) + 1))
        mixed = poses[chosen[:, limb], np.arange(poses.shape[1])]
        noisy = rng.random(count) < 0.5
        mixed[noisy, :SMPL_BODY_JOINTS] += rng.normal(0, 0.15, (int(noisy.sum()), SMPL_BODY_JOINTS, 3))
        return mixed.astype(np.float32)

    def wide_poses(self, count: int, seed: int = 0) -> np.ndarray:
        """See `TierSource`: each limb either bent anywhere within `RANGE` or as `random_poses` has it."""
        rng = np.random.default_rng((seed, 1))  # what is bent is drawn apart from what it is bent from
        parents = self.run.built.body.data.parents
        limb, poses = limb_of_joints(parents), self.random_poses(count, seed + 1000)  # not those of the bases again
        bent = rng.random((count, int(limb.max()) + 1)) < 0.5
        for joint, (low, high) in RANGE.items():
            drawn = rng.uniform(low, high, (count, 3))
            rows = bent[:, limb[joint]]
            poses[rows, joint] = drawn[rows]
        return poses


def limb_of_joints(parents: np.ndarray) -> np.ndarray:
    """(J,) which limb each joint belongs to: 0 the trunk with head, then one limb for each child of the trunk that
    branches off, its whole chain together."""
    trunk = {0, 3, 6, 9, 12, 15}  # pelvis, spine, neck and head, the same in every body of the SMPL family
    limb = np.zeros(len(parents), int)
    for joint, parent in enumerate(parents):
        if joint not in trunk and parent >= 0:
            limb[joint] = limb.max() + 1 if parent in trunk else limb[parent]
    return limb


def joint_of_points(surface: Surface) -> np.ndarray:
    """(N,) the joint that carries each point most, small joints (fingers, jaw, eyes) counted to the body joint they
    hang from: a point's body part, named alike on every surface of a body."""
    parents = np.asarray(surface.parents)
    body = np.arange(len(parents))
    for joint in range(SMPL_BODY_JOINTS, len(parents)):
        body[joint] = body[parents[joint]]
    strongest = np.take_along_axis(surface.joint_index, surface.joint_weight.argmax(1)[:, None], 1)[:, 0]
    return body[strongest]


def upsampling(coarse: Atlas, fine: Surface) -> tuple[np.ndarray, np.ndarray]:
    """index (N, 4) int32 and weight (N, 4) float32 of coarse points for each fine one: bilinear over the atlas, without
    texels that carry no point or one on another part of the body; there the nearest coarse point in space serves."""
    from scipy.spatial import cKDTree

    R = coarse.resolution
    point_at = np.full(R * R, -1, np.int64)
    point_at[coarse.texel] = np.arange(len(coarse))
    texels, weight = bilinear(fine.uv, R)
    index = point_at[texels]
    near = np.linalg.norm(coarse.points[index] - fine.points[:, None], axis=-1) < 3 * coarse.spacing[index]
    weight = np.where((index >= 0) & near, weight, 0)
    alone = weight.sum(1) < 0.05
    nearest = cKDTree(coarse.points).query(fine.points[alone])[1]
    weight[alone] = (1, 0, 0, 0)
    index[alone, 0] = nearest
    index = np.where(weight > 0, index, index.max(1, keepdims=True))
    return index.astype(np.int32), (weight / weight.sum(1, keepdims=True)).astype(np.float32)
