"""An avatar that plays: ONNX Runtime decodes the Gaussians, linear blend skinning carries them into a pose."""

from __future__ import annotations

import dataclasses
import os
from time import perf_counter

import numpy as np

from .body import Hands
from .bundle import Bundle, read_bundle
from .detail import thinned
from .errors import UserError
from .expression import MEMBER as EXPRESSION
from .expression import Expression
from .gaussians import Gaussians
from .motion import Motion
from .skeletons import fit_motion, scaled_to_legs
from .skinning import skin
from .surface import Surface
from .tiers import DEFAULT, Parts, player_tiers, stored_tiers


class Avatar:
    """The avatar of a bundle, ready to be posed.

    bundle: an opened `Bundle` or the path of one. tier: how its Gaussians are decoded, one that the
    bundle holds. uv: level of detail as a side of the atlas, None for all Gaussians of the bundle (`detail.thinned`).
    reuse: decode every so many calls only and fade from one result to the next in between, which lags by as many; it
    takes the calls for the frames of one motion. threads: of ONNX Runtime within one operator, None for one a core.
    joint_names: of the body, J names. joints: (J, 3) rest joints of its shape, metres. surface: where its N Gaussians
    sit. expression: `Expression` of bodies that have a face, or None. with_normals: whether `gaussians` shall give
    normals, for rasterizers that want them. stage_seconds: what the last call of `gaussians` spent on `encode`,
    `decode` and `skin`.
    Raises UserError for a bundle that cannot be read or that ONNX Runtime cannot load.
    """

    def __init__(
        self,
        bundle: Bundle | str | os.PathLike,
        *,
        tier: str = DEFAULT,
        uv: int | None = None,
        reuse: int = 1,
        threads: int | None = None,
    ):
        if threads is not None and threads < 1:
            raise UserError(f"threads={threads}: give a whole number from 1 up")
        self.bundle = bundle if isinstance(bundle, Bundle) else read_bundle(bundle)
        self.name = self.bundle.manifest.name
        if reuse < 1:
            raise UserError(f"reuse={reuse}: give a whole number from 1 up")
        stored, map_surface = self.bundle.surfaces()
        chosen, added = (None, None) if uv is None or uv == stored.resolution else thinned(stored, uv)
        self.surface = stored if chosen is None else _taken(stored, chosen)
        self.joints = self.surface.joints
        self.joint_names, self._rest_pose, self._hands = self._read_body()
        self.expression = self._read_expression(len(stored), chosen)
        self.with_normals = False
        self.stage_seconds: dict[str, float] = {}
        self.tier = tier
        self._tier = self._build_tier(tier, Parts(self.bundle, stored, map_surface, threads, chosen, added))
        self._reuse, self._faded = reuse, None
        self._static = None
        self._means = [np.empty((len(self.surface), 3), np.float32) for _ in range(3)]
        self._calls = 0

    def __len__(self) -> int:
        """The number of Gaussians."""
        return len(self.surface)

    @property
    def pixel(self) -> float | None:
        """Metres of the person that a pixel of the training images spanned (`detail.as_trained`); None where the bundle
        does not say."""
        value = self.bundle.manifest.training.get("pixel_m")
        return float(value) if isinstance(value, (int, float)) and 0 < value < np.inf else None

    @property
    def dynamic(self) -> bool:
        """Whether the look depends on the pose."""
        return self.bundle.manifest.dynamic

    def fit(self, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
        """The motion brought to this body's joints, and the names of what moves in it that the body lacks.

        Raises UserError for a NaN or infinite pose, translation or expression.
        """
        count = 0 if self.expression is None else self.expression.count
        motion, ignored = fit_motion(motion, self.joint_names, self._rest_pose, hands=self._hands, num_expression=count)
        motion = scaled_to_legs(motion, self.joint_names, self.joints)
        rows = {"pose": motion.poses, "translation": motion.trans, "expression": motion.expression}
        for key, array in rows.items():
            if array is None:
                continue
            bad = ~np.isfinite(array.reshape(len(array), -1)).all(1)
            if bad.any():
                raise UserError(f"motion '{motion.name}' has a NaN or infinite {key} at frame {int(np.argmax(bad))}")
        return motion, ignored

    def gaussians(
        self, pose: np.ndarray, trans: np.ndarray | None = None, expression: np.ndarray | None = None
    ) -> Gaussians:
        """The avatar in one pose.

        pose: (J, 3) axis-angle relative to the parent joint, radians; with another number of joints it is fitted as
        `fit` does. trans: (3,) metres, zero if None. expression: (E,) coefficients or fewer, zero if None; an avatar
        whose `expression` is None takes none. Returns N isotropic Gaussians in the world, float32, opaque; their
        arrays are filled again by the third call from this one, so copy what is to be kept.
        Raises UserError for a NaN or infinite pose or expression, ValueError for an expression that it cannot have.
        """
        pose = np.asarray(pose, np.float32)
        if pose.ndim != 2 or pose.shape[1] != 3:
            raise ValueError(f"pose has shape {pose.shape}, expected (J, 3)")
        trans = np.zeros(3, np.float32) if trans is None else np.asarray(trans, np.float32)
        if len(pose) != len(self.joint_names):
            pose = self.fit(Motion(pose[None], trans[None], 1.0))[0].poses[0]
        self._check_finite(pose, trans)

        points, colors, scales = self._decode(pose)
        decoded = perf_counter()
        shift = None
        if expression is not None and np.any(expression):
            points, shift = self._expressed(points, np.asarray(expression, np.float32))
        A = self.surface.skin_transforms(pose, shift)
        A[:, :3, 3] += trans
        self._calls += 1
        out = self._means[self._calls % 3]
        means = skin(points, self.surface.joint_index, self.surface.joint_weight, A, out)
        normals = None
        if self.with_normals:  # those of the body's surface; blending rotations shortens them, never lengthens
            A[:, :3, 3] = 0
            normals = skin(self.surface.normals, self.surface.joint_index, self.surface.joint_weight, A)
        self.stage_seconds = {**self._tier.stage_seconds, "skin": perf_counter() - decoded}
        return Gaussians(means=means, scales=scales, colors=colors, normals=normals)

    def _expressed(self, points: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (N, 3) with an expression, and the shift (J, 3) of the rest joints."""
        count = 0 if self.expression is None else self.expression.count
        if coefficients.ndim != 1 or len(coefficients) > count:
            raise ValueError(f"expression has shape {coefficients.shape}, this avatar has {count} coefficients")
        if not np.isfinite(coefficients).all():
            raise UserError("the expression is NaN or infinite")
        coefficients = np.pad(coefficients, (0, count - len(coefficients)))
        return self.expression.points(points, coefficients), self.expression.joints @ coefficients

    def _decode(self, pose: np.ndarray):
        if self._tier.moves:
            return self._tier(pose) if self._reuse == 1 else self._reused(pose)
        if self._static is None:
            self._static = self._tier(pose)
        else:
            self._tier.stage_seconds = {"encode": 0.0, "decode": 0.0}
        return self._static

    def _reused(self, pose: np.ndarray):
        phase = self._calls % self._reuse
        if phase == 0 or self._faded is None:
            latest = tuple(a.copy() for a in self._tier(pose))
            self._faded = (latest if self._faded is None else self._faded[1], latest)
        else:
            self._tier.stage_seconds = {"encode": 0.0, "decode": 0.0}
        start = perf_counter()
        before, after = self._faded
        share = np.float32((phase + 1) / self._reuse)
        mixed = tuple(a + share * (b - a) for a, b in zip(before, after, strict=True))
        self._tier.stage_seconds["decode"] += perf_counter() - start
        return mixed

    def _build_tier(self, name: str, parts: Parts):
        tiers, stored = player_tiers(), stored_tiers(self.bundle)
        tiers[name]  # an unknown name is told from one that this bundle lacks
        if name not in stored:
            raise UserError(
                f"{self.bundle.path} holds no tier '{name}' (it has {', '.join(stored)}); export it again with "
                f"gavatar-export RUN --tiers {name}"
            )
        return tiers.build(name, parts=parts)

    def _check_finite(self, pose: np.ndarray, trans: np.ndarray) -> None:
        bad = ~np.isfinite(pose).all(1)
        if bad.any():
            raise UserError(f"the pose of joint '{self.joint_names[int(np.argmax(bad))]}' is NaN or infinite")
        if not np.isfinite(trans).all():
            raise UserError("the translation is NaN or infinite")

    def _read_expression(self, stored: int, chosen: np.ndarray | None) -> Expression | None:
        if EXPRESSION not in self.bundle.manifest.members:
            return None
        source = f"{self.bundle.path}: {EXPRESSION}"
        whole = Expression.from_arrays(self.bundle.arrays(EXPRESSION), stored, self.surface.num_joints, source)
        return whole.taken(chosen, stored)

    def _read_body(self) -> tuple[tuple[str, ...], np.ndarray | None, Hands | None]:
        """Joint names, the rest pose, None where it is zero, and hand data, None where there are none."""
        arrays = self.bundle.arrays("body.npz")
        names, rest = tuple(str(name) for name in arrays.get("joint_names", ())), arrays.get("rest_pose")
        if len(names) != self.surface.num_joints:
            raise UserError(
                f"{self.bundle.path}: body.npz names {len(names)} joints and surface.npz has "
                f"{self.surface.num_joints}; export the avatar again"
            )
        if rest is not None and (rest.shape != (len(names), 3) or not np.isfinite(rest).all()):
            raise UserError(f"{self.bundle.path}: rest_pose in body.npz is not (J, 3) numbers; export the avatar again")
        return names, rest, self._read_hands(arrays)

    def _read_hands(self, arrays: dict[str, np.ndarray]) -> Hands | None:
        if "hands_components" not in arrays:
            return None
        mean, components = np.asarray(arrays.get("hands_mean")), arrays["hands_components"]
        if mean.shape != (2, 15, 3) or components.ndim != 3 or components.shape[::2] != (2, 45):
            raise UserError(
                f"{self.bundle.path}: body.npz: hands_mean and hands_components are not (2, 15, 3) and (2, K, 45) "
                "numbers; export the avatar again"
            )
        return Hands(mean.astype(np.float64), components.astype(np.float64))


def _taken(surface: Surface, chosen: np.ndarray) -> Surface:
    """The surface with only the `chosen` points."""
    names = ("texel", "uv", "face", "barycentric", "points", "normals", "joint_index", "joint_weight", "spacing")
    return dataclasses.replace(surface, **{name: getattr(surface, name)[chosen] for name in names})
