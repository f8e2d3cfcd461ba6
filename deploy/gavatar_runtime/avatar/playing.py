"""An avatar that plays: ONNX Runtime decodes the Gaussians, linear blend skinning carries them into a pose."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from time import perf_counter

import numpy as np

from ..bundle import Bundle, read_bundle
from ..decoding.detail import first
from ..errors import WrongValue
from ..geometry.skinning import skin
from ..tiers import Parts, build_tier, player_tiers
from ..values.camera import Camera
from ..values.gaussians import Gaussians
from ..values.motion import Motion
from ..values.surface import Surface
from .buffers import InTurn
from .expression import Expression, read_expression
from .folding import Folded
from .played import PlayedAvatar
from .played_body import read_body
from .pose_blendshapes import Turns, read_pose_blendshapes
from .reuse import Sparing
from .seen_evidence import read_evidence
from .visibility import seen_from


class Avatar(PlayedAvatar):
    """The avatar of a bundle at one level of detail, ready to be posed.

    bundle: an opened `Bundle` or the path of one. tier: how its Gaussians are decoded, one that the bundle holds, ''
    for the one that every bundle does; None opens the body alone, at a fraction of the cost, for whatever asks for no
    Gaussians. gaussians: at most so many, each the larger, None for all of the bundle (`detail.first`).
    reuse: decode every so many calls only (`reuse.Faded`). seen_only: decode only what the camera given to `gaussians`
    can see, where the tier and the bundle can do that and decodes are not reused (`visibility.seen_from`).
    threads: that decode, None for one a core. Its fields are those of `PlayedAvatar`.
    Raises UserError for a bundle that cannot be read or that ONNX Runtime cannot load.
    """

    def __init__(
        self,
        bundle: Bundle | str | os.PathLike,
        *,
        tier: str | None = "",
        gaussians: int | None = None,
        reuse: int = 1,
        seen_only: bool = False,
        threads: int | None = None,
    ):
        for name, value in (("threads", threads), ("reuse", reuse)):
            if value is not None and value < 1:
                raise WrongValue(f"`{name}={value}`: give a whole number from 1 up")
        self.bundle = bundle if isinstance(bundle, Bundle) else read_bundle(bundle)
        self.name = self.bundle.manifest.name
        self.pixel = _training_pixel(self.bundle)
        stored, map_surface = self.bundle.surfaces()
        chosen, added = (None, None) if gaussians is None or gaussians >= len(stored) else first(stored, gaussians)
        self.surface = stored if chosen is None else stored.take(chosen)
        self.joints = self.surface.joints
        expression = read_expression(self.bundle, len(stored), len(self.joints))
        self.expression = None if expression is None else expression.taken(chosen, len(stored))
        known = read_evidence(self.bundle, len(stored))
        self.evidence = known if known is None or chosen is None else known.take(chosen)
        self._offsets = self._read_offsets(len(stored), chosen)
        self.body = read_body(self.bundle, self.joints, 0 if expression is None else expression.count)
        self.joint_names = self.body.joint_names
        self.stage_seconds: dict[str, float] = {}
        self.tier = player_tiers().default if tier == "" else tier
        self._decode: Sparing | None = None
        if self.tier is not None:
            parts = Parts(self.bundle, stored, map_surface, threads, chosen, added)
            built = build_tier(self.tier, parts)
            rest = np.zeros_like(self.joints, np.float32)
            self._decode = Sparing(built, reuse, len(self.surface)).tried(rest, len(self.surface))
        self.seen_only = bool(seen_only and self._decode is not None and self._decode.picks)
        self._means = InTurn(lambda: np.empty((len(self.surface), 3), np.float32))
        self._normals = InTurn(lambda: np.empty((len(self.surface), 3), np.float32))
        self._folded: Folded | None = None

    def _read_offsets(self, stored: int, chosen: np.ndarray | None) -> Callable[[np.ndarray], np.ndarray] | None:
        """From a pose to what its blendshapes add to the points, None where there are none."""
        blendshapes = read_pose_blendshapes(self.bundle, stored, len(self.joints))
        if blendshapes is None:
            return None
        return functools.partial(blendshapes.taken(chosen).offsets, turns=Turns.of(self.surface))

    @property
    def dynamic(self) -> bool:
        """Whether the look depends on the pose."""
        return self.bundle.manifest.dynamic

    @property
    def networks(self) -> bool:
        """Whether networks run over Gaussians in each frame that is decoded."""
        return self._decode is not None and self._decode.networks

    def fit(self, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
        """See `PlayedBody.fit`."""
        return self.body.fit(motion)

    def follow(self, motion: Motion | None) -> None:
        """Prepare for the poses of a fitted motion: joints that it never moves are folded into their parents, which
        spares a tenth of skinning where that is the fingers. Any other pose remains right, at the former cost. The sums
        of skinning come in another order then; None: as before any motion."""
        self._folded = None if motion is None else Folded.of(self.surface, motion.poses)

    def gaussians(
        self,
        pose: np.ndarray,
        trans: np.ndarray | None = None,
        expression: np.ndarray | None = None,
        *,
        camera: Camera | None = None,
        normals: bool = False,
        copy: bool = True,
    ) -> Gaussians:
        """The avatar in one pose.

        pose: (J, 3) axis-angle relative to the parent joint, radians; with another number of joints it is fitted as
        `fit` does. trans: (3,) metres, zero if None. expression: (E,) coefficients or fewer, zero if None; an avatar
        whose `expression` is None takes none. camera: that will look at it, which only `seen_only` needs.
        normals: also give those of the body's surface, for rasterizers that want them. copy: give arrays that nothing
        else writes to; without, they are to be read only, and are filled again by the third call from this one.
        Returns N isotropic Gaussians in the world, float32, opaque (fewer with `seen_only`).
        Raises WrongValue for a pose, a translation or an expression that it cannot have, NaN and infinite ones among
        them, and for an avatar without a tier.
        """
        if self._decode is None:
            raise WrongValue("this avatar was opened with tier=None: it has a body and no Gaussians")
        pose, trans = self._standing(pose, trans)
        face = self._face(expression)
        start = perf_counter()
        surface, A = self._transforms(pose, face)
        A[:, :3, 3] += trans
        means, index, weight = self._means.next(), surface.joint_index, surface.joint_weight
        turned = self._skinned_normals(surface, A) if normals else None
        rows = None
        if self.seen_only and camera is not None:
            facing = self._skinned_normals(surface, A) if turned is None else turned
            rows = seen_from(skin(surface.points, index, weight, A, means), facing, camera)
            index, weight, means = index[rows], weight[rows], means[: len(rows)]
            turned = None if turned is None else turned[rows]
        before = perf_counter() - start
        points, colors, scales = self._decode(pose, rows)
        decoded = perf_counter()
        points = self._shaped(points, pose, face, rows)
        means = skin(points, index, weight, A, means)
        self.stage_seconds = {**self._decode.stage_seconds, "skin": before + perf_counter() - decoded}
        posed = Gaussians(means=means, scales=scales, colors=colors, normals=turned)
        return posed.copied() if copy else posed

    def _standing(self, pose: np.ndarray, trans: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Pose (J, 3) and translation (3,) as float32, checked."""
        with np.errstate(over="ignore"):  # what overflows there counts as infinite too
            pose = np.asarray(pose, np.float32)
            trans = np.zeros(3, np.float32) if trans is None else np.asarray(trans, np.float32)
        if pose.ndim != 2 or pose.shape[1] != 3:
            raise WrongValue(f"pose has shape {pose.shape}, expected (J, 3)")
        if trans.shape != (3,):
            raise WrongValue(f"trans has shape {trans.shape}, expected (3,)")
        if len(pose) != len(self.joint_names):
            pose = self.fit(Motion(pose[None], trans[None], 1.0))[0].poses[0]
        bad = ~np.isfinite(pose).all(1)
        if bad.any():
            raise WrongValue(f"the pose of joint '{self.joint_names[int(np.argmax(bad))]}' is NaN or infinite")
        if not np.isfinite(trans).all():
            raise WrongValue("the translation is NaN or infinite")
        return pose, trans

    def _face(self, expression: np.ndarray | None) -> tuple[Expression, np.ndarray] | None:
        """What moves the face and the (E,) coefficients by which it does, None where it is at rest."""
        if expression is None or not np.any(expression):
            return None
        if self.expression is None:
            raise WrongValue("this avatar has no expressions: leave the expression out")
        return self.expression, self.expression.filled(np.asarray(expression, np.float32))

    def _transforms(self, pose: np.ndarray, face: tuple[Expression, np.ndarray] | None) -> tuple[Surface, np.ndarray]:
        """The surface to skin by, and its joints' (J, 4, 4) canonical-to-posed transforms, without translation."""
        if face is not None:  # which moves joints: none of them rests
            expression, coefficients = face
            return self.surface, self.surface.skin_transforms(pose, expression.joints @ coefficients)
        if self._folded is not None and self._folded.fits(pose):
            return self._folded.surface, self._folded.surface.skin_transforms(pose[self._folded.moving])
        return self.surface, self.surface.skin_transforms(pose)

    def _skinned_normals(self, surface: Surface, A: np.ndarray) -> np.ndarray:
        """(N, 3) normals of the body's surface; blending rotations shortens them, never lengthens."""
        turn = A.copy()
        turn[:, :3, 3] = 0
        return skin(surface.normals, surface.joint_index, surface.joint_weight, turn, self._normals.next())

    def _shaped(
        self,
        points: np.ndarray,
        pose: np.ndarray,
        face: tuple[Expression, np.ndarray] | None,
        rows: np.ndarray | None,
    ) -> np.ndarray:
        """Canonical points moved by blendshapes of pose and face. rows: which they are, None for all."""
        if self._offsets is not None:
            offsets = self._offsets(pose)
            points = points + (offsets if rows is None else offsets[rows])
        if face is None:
            return points
        expression, coefficients = face
        return expression.taken(rows, len(self)).points(points, coefficients)


def _training_pixel(bundle: Bundle) -> float | None:
    value = bundle.manifest.training.get("pixel_m")
    return float(value) if isinstance(value, (int, float)) and 0 < value < np.inf else None
