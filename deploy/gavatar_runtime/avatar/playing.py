"""An avatar that plays: ONNX Runtime decodes the Gaussians, linear blend skinning carries them into a pose."""

from __future__ import annotations

import os
from time import perf_counter

import numpy as np

from ..bundle import Bundle, read_bundle
from ..decoding.detail import thinned
from ..decoding.residuals import empty
from ..errors import UserError
from ..geometry.skinning import skin
from ..motions.fitting import fit_motion, scaled_to_legs
from ..plugins import load_entry_points
from ..tiers import DEFAULT, Parts, player_tiers, stored_tiers
from ..values.body import Hands
from ..values.camera import Camera
from ..values.gaussians import Gaussians
from ..values.motion import Motion
from ..values.surface import Surface
from .expression import MEMBER as EXPRESSION
from .expression import Expression
from .folding import folded, still_joints
from .played import PlayedAvatar
from .pose_blendshapes import MEMBER as POSE_BLENDSHAPES
from .pose_blendshapes import PoseBlendshapes, Turns
from .visibility import seen_from


class Avatar(PlayedAvatar):
    """The avatar of a bundle, ready to be posed.

    bundle: an opened `Bundle` or the path of one. tier: how its Gaussians are decoded, one that the bundle holds; None
    opens the body alone, at a fraction of the cost, for whatever asks for no Gaussians. uv: level of detail as a side
    of the atlas, None for all Gaussians of the bundle (`detail.thinned`).
    reuse: decode every so many calls only and fade from one result to the next in between, which lags by as many; it
    takes the calls for the frames of one motion. seen_only: decode only what the camera given to `gaussians` can see,
    where the tier and the bundle can do that and decodes are not reused (`visibility.seen_from`).
    threads: that decode, None for one a core.
    Its fields are those of `PlayedAvatar`.
    Raises UserError for a bundle that cannot be read or that ONNX Runtime cannot load.
    """

    def __init__(
        self,
        bundle: Bundle | str | os.PathLike,
        *,
        tier: str | None = DEFAULT,
        uv: int | None = None,
        reuse: int = 1,
        seen_only: bool = False,
        threads: int | None = None,
    ):
        if threads is not None and threads < 1:
            raise UserError(f"threads={threads}: give a whole number from 1 up")
        self.bundle = bundle if isinstance(bundle, Bundle) else read_bundle(bundle)
        self.name = self.bundle.manifest.name
        self.pixel = _training_pixel(self.bundle)
        if reuse < 1:
            raise UserError(f"reuse={reuse}: give a whole number from 1 up")
        stored, map_surface = self.bundle.surfaces()
        chosen, added = (None, None) if uv is None or uv == stored.resolution else thinned(stored, uv)
        self.uv = stored.resolution if uv is None else uv
        self.surface = stored if chosen is None else stored.take(chosen)
        self.joints = self.surface.joints
        self.joint_names, self._rest_pose, self._hands = self._read_body()
        self.expression = self._read_expression(len(stored), chosen)
        self._pose_blendshapes = self._read_pose_blendshapes(len(stored), chosen)
        self._turns = None if self._pose_blendshapes is None else Turns.of(self.surface)
        self.stage_seconds: dict[str, float] = {}
        self.tier = tier
        self._tier = None
        if tier is not None:
            self._tier = self._build_tier(tier, Parts(self.bundle, stored, map_surface, threads, chosen, added))
        self.seen_only = bool(seen_only and self.networks and self._tier.picks and reuse == 1)
        self._reuse, self._faded = reuse, None
        self._mixed = [empty(len(self.surface)) for _ in range(3)] if reuse > 1 else []
        self._static = None
        self._means = [np.empty((len(self.surface), 3), np.float32) for _ in range(3)]
        self._normals: list[np.ndarray] = []
        self._calls = -1
        self._posing, self._moving, self._still = self.surface, None, None

    @property
    def dynamic(self) -> bool:
        """Whether the look depends on the pose."""
        return self.bundle.manifest.dynamic

    @property
    def networks(self) -> bool:
        """Whether networks run over Gaussians in each frame that is decoded."""
        return self._tier is not None and self._tier.networks and self._tier.moves

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

    def follow(self, motion: Motion) -> None:
        """Prepare for the poses of a fitted motion: joints that it never moves are folded into their parents, which
        spares a tenth of skinning where that is the fingers. Any other pose remains right, at the former cost."""
        still = still_joints(self.surface, motion.poses)
        if still.any():
            self._posing, self._moving = folded(self.surface, still)
            self._still = still, np.asarray(motion.poses[0], np.float32)[still]
        else:
            self._posing, self._moving, self._still = self.surface, None, None

    def gaussians(
        self,
        pose: np.ndarray,
        trans: np.ndarray | None = None,
        expression: np.ndarray | None = None,
        *,
        camera: Camera | None = None,
        normals: bool = False,
    ) -> Gaussians:
        """The avatar in one pose.

        pose: (J, 3) axis-angle relative to the parent joint, radians; with another number of joints it is fitted as
        `fit` does. trans: (3,) metres, zero if None. expression: (E,) coefficients or fewer, zero if None; an avatar
        whose `expression` is None takes none. camera: that will look at it, which only `seen_only` needs.
        normals: also give those of the body's surface, for rasterizers that want them.
        Returns N isotropic Gaussians in the world, float32, opaque (fewer with `seen_only`); their arrays are filled
        again by the third call from this one, so copy what is to be kept.
        Raises UserError for a NaN or infinite pose or expression, ValueError for an expression that it cannot have and
        for an avatar without a tier.
        """
        if self._tier is None:
            raise ValueError("this avatar was opened with tier=None: it has a body and no Gaussians")
        pose = np.asarray(pose, np.float32)
        if pose.ndim != 2 or pose.shape[1] != 3:
            raise ValueError(f"pose has shape {pose.shape}, expected (J, 3)")
        trans = np.zeros(3, np.float32) if trans is None else np.asarray(trans, np.float32)
        if len(pose) != len(self.joint_names):
            pose = self.fit(Motion(pose[None], trans[None], 1.0))[0].poses[0]
        self._check_finite(pose, trans)
        coefficients = None
        if expression is not None and np.any(expression):
            coefficients = self._coefficients(np.asarray(expression, np.float32))
        start = perf_counter()
        surface, A = self._transforms(pose, coefficients)
        A[:, :3, 3] += trans
        self._calls += 1
        look = camera if self.seen_only else None
        turned = self._skinned_normals(surface, A) if normals or look is not None else None
        means, index, weight = self._means[self._calls % 3], surface.joint_index, surface.joint_weight
        rows = None
        if look is not None:
            rows = seen_from(skin(surface.points, index, weight, A, means), turned, look)
            index, weight, turned, means = index[rows], weight[rows], turned[rows], means[: len(rows)]
        before = perf_counter() - start
        points, colors, scales = self._decode(pose, rows)
        decoded = perf_counter()
        points = self._shaped(points, pose, coefficients, rows)
        means = skin(points, index, weight, A, means)
        self.stage_seconds = {**self._tier.stage_seconds, "skin": before + perf_counter() - decoded}
        return Gaussians(means=means, scales=scales, colors=colors, normals=turned if normals else None)

    def _shaped(self, points: np.ndarray, pose, coefficients: np.ndarray | None, rows: np.ndarray | None) -> np.ndarray:
        """Canonical points moved by blendshapes of pose and expression. rows: which they are, or None."""
        if self._pose_blendshapes is not None:
            offsets = self._pose_blendshapes.offsets(pose, self._turns)
            points = points + (offsets if rows is None else offsets[rows])
        if coefficients is None:
            return points
        expression = self.expression if rows is None else self.expression.taken(rows, len(self))
        return expression.points(points, coefficients)

    def _coefficients(self, expression: np.ndarray) -> np.ndarray:
        """All E coefficients of an expression."""
        count = 0 if self.expression is None else self.expression.count
        if expression.ndim != 1 or len(expression) > count:
            raise ValueError(f"expression has shape {expression.shape}, this avatar has {count} coefficients")
        if not np.isfinite(expression).all():
            raise UserError("the expression is NaN or infinite")
        return np.pad(expression, (0, count - len(expression)))

    def _transforms(self, pose: np.ndarray, coefficients: np.ndarray | None) -> tuple[Surface, np.ndarray]:
        """The surface to skin by, and its joints' (J, 4, 4) canonical-to-posed transforms, without translation."""
        if coefficients is not None:  # which moves joints of the face: none of them rests
            return self.surface, self.surface.skin_transforms(pose, self.expression.joints @ coefficients)
        if self._still is not None:
            still, held = self._still
            if np.array_equal(pose[still], held):
                return self._posing, self._posing.skin_transforms(pose[self._moving])
        return self.surface, self.surface.skin_transforms(pose)

    def _skinned_normals(self, surface: Surface, A: np.ndarray) -> np.ndarray:
        """(N, 3) normals of the body's surface; blending rotations shortens them, never lengthens."""
        if not self._normals:
            self._normals = [np.empty((len(self.surface), 3), np.float32) for _ in range(3)]
        turn = A.copy()
        turn[:, :3, 3] = 0
        out = self._normals[self._calls % 3]
        return skin(surface.normals, surface.joint_index, surface.joint_weight, turn, out)

    def _decode(self, pose: np.ndarray, rows: np.ndarray | None = None):
        if rows is not None and len(rows):
            return self._tier(pose, rows)
        if rows is not None:
            self._tier.stage_seconds = {"encode": 0.0, "decode": 0.0}
            return empty(0)
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
            latest = self._tier(pose)
            if self._faded is None:
                self._faded = tuple(tuple(a.copy() for a in latest) for _ in range(2))
            else:
                self._faded = self._faded[1], self._faded[0]
                for kept, array in zip(self._faded[1], latest, strict=True):
                    np.copyto(kept, array)
        else:
            self._tier.stage_seconds = {"encode": 0.0, "decode": 0.0}
        start = perf_counter()
        before, after = self._faded
        share = np.float32((phase + 1) / self._reuse)
        mixed = self._mixed[self._calls % 3]
        for a, b, out in zip(before, after, mixed, strict=True):
            np.subtract(b, a, out=out)
            np.multiply(out, share, out=out)
            np.add(out, a, out=out)
        self._tier.stage_seconds["decode"] += perf_counter() - start
        return mixed

    def _build_tier(self, name: str, parts: Parts):
        tiers, stored = player_tiers(), stored_tiers(self.bundle)
        if name not in tiers:
            load_entry_points()
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

    def _read_pose_blendshapes(self, stored: int, chosen: np.ndarray | None) -> PoseBlendshapes | None:
        if POSE_BLENDSHAPES not in self.bundle.manifest.members:
            return None
        arrays, source = self.bundle.arrays(POSE_BLENDSHAPES), f"{self.bundle.path}: {POSE_BLENDSHAPES}"
        return PoseBlendshapes.from_arrays(arrays, stored, self.surface.num_joints, source).taken(chosen)

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


def _training_pixel(bundle: Bundle) -> float | None:
    value = bundle.manifest.training.get("pixel_m")
    return float(value) if isinstance(value, (int, float)) and 0 < value < np.inf else None
