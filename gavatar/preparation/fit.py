"""Fitting the body to landmarks and masks: one shape, a pose and a place in every frame.

Everything is in metres: an image residual counts as pixels x depth / focal length, so that weights mean the same for
any image size, and accelerations are physical, so that they mean the same at any frame rate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix
from gavatar_runtime.progress import Progress
from gavatar_runtime.values.camera import Camera

from ..body.skeleton import SMPL_BODY_JOINTS, BodyData
from ..body.torch_rotations import matrix_from_axis_angle
from .anatomy import joint_ranges
from .coverage import CERTAIN, covered
from .initial import Observations, facing, observe, place
from .landmarks import BONES, INDEX, MIRROR, OFFSET_SIGMA, Landmarks
from .rig import FitRig, Posed
from .silhouette import Silhouettes, nearest_to_outline, outline_gap, outside_distance

FEET, SHOULDERS = [7, 8, 10, 11], [16, 17]  # ankles and feet; of the 22 joints that the SMPL family shares
TRUNK = 1.0  # metres: a pelvis that tips over counts as a trunk of this length that leans
NEAREST_EVERY = 5  # steps between two searches for the point nearest to the outline, the dearest part of a step


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """Weights and steps of the fit. Sigmas are the deviations that cost the same as one unit elsewhere.

    steps: optimisation steps of the three stages (place, pose, silhouette). stature: the person's height in metres or
    None when unknown; with one uncalibrated camera size and distance cannot be told apart, so the prior decides.
    """

    steps: tuple[int, int, int] = (60, 150, 200)
    stature: float | None = None
    refine_cameras: bool = False  # calibrated principal points may move: a small error of a camera's direction
    surface_points: int = 1500
    num_betas: int = 10  # of an official model's 10 to 300
    image_sigma: float = 0.02  # metres
    bone_sigma: float = 0.35  # radians; depth from one view is rough
    inside_sigma: float = 0.015  # metres
    reach_sigma: float = 0.025  # metres; loose: clothes and hair are not body
    balance_sigma: float = 0.1  # metres
    tilt_sigma: float = 0.1  # radians
    trans_acceleration: float = 8.0  # metres / s^2
    angular_acceleration: float = 120.0  # radians / s^2
    # The pose stage begins with the directions of bones, which say whether a limb points to or from the camera, and
    # hands over to the image, which cannot: begun with it, a limb that starts on the wrong side stays there.
    lead: float = 0.6  # of the pose stage
    lead_bones: float = 8.0
    lead_image: float = 0.1
    # Inside weighs more than reach: clothes are larger than the body. The other way round a jacket fattens the legs.
    weights: dict = dataclasses.field(
        default_factory=lambda: {
            "image": 1.0, "bones": 0.5, "inside": 3.0, "reach": 4.0, "pose": 0.05, "betas": 0.005, "offset": 0.02,
            "smooth": 0.3, "stature": 1.0, "camera": 0.01, "balance": 0.2, "tilt": 0.003,
        }
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Fit:
    """A fitted body.

    poses: (T, J, 3) axis-angle in [0, pi], fingers zero. trans: (T, 3) metres. betas: (B,). image_error: (C, T, 33)
    pixels between landmarks and their points on the body, NaN where they are not seen with some certainty. shift: (C,
    2) pixels by which the cameras' principal points moved, zero unless they were to be refined. up: (3,) unit vector
    against gravity, as the person's balance has it. losses: last value of each term.
    """

    poses: np.ndarray
    trans: np.ndarray
    betas: np.ndarray
    image_error: np.ndarray
    shift: np.ndarray
    up: np.ndarray
    losses: dict[str, float]


def robust(residual: Tensor, sigma: float) -> Tensor:
    """Geman-McClure with a wide core: quadratic up to about 2 sigma, at most 9 for any outlier."""
    square = (residual / sigma) ** 2
    return square / (1 + square / 9)


def huber(residual: Tensor, sigma: float) -> Tensor:
    """Pseudo-Huber: quadratic inside sigma, linear beyond, so that far points still pull."""
    return 2 * (torch.sqrt(1 + (residual / sigma) ** 2) - 1)


class BodyFitter:
    """Holds the unknowns and the observations of one fit; `run` returns the result. Limbs that no frame shows rest.

    data: the body. cameras, landmarks: one per camera, same T. silhouettes: one per camera, or None
    to fit without masks. fps: frames per second. Raises UserError when no frame shows enough of the person.
    """

    def __init__(
        self,
        data: BodyData,
        cameras: list[Camera],
        landmarks: list[Landmarks],
        silhouettes: list[Silhouettes] | None,
        fps: float,
        options: FitOptions | None = None,
    ):
        self.data, self.cameras, self.fps = data, cameras, fps
        self.options = options or FitOptions()
        self.rig = FitRig(data, self.options.surface_points, self.options.num_betas)
        seen = observe(cameras, landmarks, fps)
        rest = self.rig.landmarks0.numpy().astype(np.float64)
        root = facing(cameras, seen, rest, fps)
        trans = place(cameras, seen, np.einsum("tab,kb->tka", root, rest))
        self.frames = len(root)
        ranges = joint_ranges(tuple(data.joint_names))
        self.low, self.high, self.mean, self.sigma = (_tensor(v[1:SMPL_BODY_JOINTS]) for v in ranges)
        resting = covered(cameras, landmarks).resting
        self.moving = _tensor([[name not in resting] for name in data.joint_names[1:SMPL_BODY_JOINTS]])
        self._unknowns(root, trans)
        self._observations(seen)
        self.silhouettes = silhouettes
        self.nearest: dict[int, Tensor] = {}
        self.nearest_age = [0] * len(cameras)

    def _unknowns(self, root: np.ndarray, trans: np.ndarray) -> None:
        self.root0 = _tensor(root)
        self.turn = torch.zeros(self.frames, 3, requires_grad=True)
        self.poses = self.mean.expand(self.frames, -1, -1).clone().requires_grad_()
        self.trans = _tensor(trans).requires_grad_()
        self.betas = torch.zeros(self.rig.num_betas, requires_grad=True)
        self.offsets = torch.zeros(33, 3, requires_grad=True)
        self.shift = torch.zeros(len(self.cameras), 2, requires_grad=self.options.refine_cameras)
        self.tilt = torch.zeros(2, requires_grad=True)
        self.offset_sigma = _tensor(OFFSET_SIGMA)[:, None]

    def _observations(self, seen: Observations) -> None:
        self.image, self.visibility = _tensor(seen.image), _tensor(seen.visibility) ** 2
        ankles = seen.visibility[..., [INDEX["left_ankle"], INDEX["right_ankle"]]]
        self.standing = _tensor((ankles > CERTAIN).any((0, 2)))
        a, b = np.array(BONES).T
        bones = seen.world[..., b, :] - seen.world[..., a, :]
        length = np.linalg.norm(bones, axis=-1, keepdims=True)
        weight = np.minimum(seen.visibility[..., a], seen.visibility[..., b]) * seen.world_weight[..., None]
        self.bones = _tensor(bones / np.maximum(length, 1e-6))
        self.bone_weight = _tensor(weight * (length[..., 0] > 0.01))
        self.K = [_tensor([c.fx, c.fy, c.cx, c.cy]) for c in self.cameras]
        self.R = [_tensor(c.T_camera_world[:3, :3]) for c in self.cameras]
        self.t = [_tensor(c.T_camera_world[:3, 3]) for c in self.cameras]

    def mirrored_offsets(self) -> Tensor:
        """(33, 3) landmark offsets, the same on both sides of the body."""
        flip = torch.tensor([-1.0, 1.0, 1.0])
        return 0.5 * (self.offsets + self.offsets[MIRROR] * flip)

    def posed(self, surface: bool) -> Posed:
        root = matrix_from_axis_angle(self.turn) @ self.root0
        return self.rig(self.betas, root, self.poses, self.trans, self.mirrored_offsets(), surface)

    def project(self, camera: int, points: Tensor) -> tuple[Tensor, Tensor]:
        """(..., 3) world -> (..., 2) pixels and (...) depth, kept in front of the camera (at least 0.1 m)."""
        local = points @ self.R[camera].T + self.t[camera]
        depth = local[..., 2].clamp_min(0.1)
        K = self.K[camera]
        return local[..., :2] / depth[..., None] * K[:2] + K[2:] + self.shift[camera], depth

    def losses(self, stage: int) -> dict[str, Tensor]:
        """Every term of the objective, unweighted, for stage 0 (place), 1 (pose) or 2 (silhouette)."""
        options = self.options
        masks = self.silhouettes if stage == 2 else None
        body = self.posed(surface=masks is not None)
        image = bones = inside = reach = torch.zeros(())
        measure = robust if stage == 2 else huber
        for c in range(len(self.cameras)):
            pixels, depth = self.project(c, body.landmarks)
            metres = (depth.detach() / self.K[c][0])[..., None]
            distance = ((pixels - self.image[c]) * metres).square().sum(-1).add(1e-12).sqrt()
            image = image + _mean(measure(distance, options.image_sigma), self.visibility[c])
            if masks is not None and body.surface is not None:
                more_inside, more_reach = self._silhouette_terms(c, masks[c], body.surface)
                inside, reach = inside + more_inside, reach + more_reach
        a, b = np.array(BONES).T
        direction = torch.nn.functional.normalize(body.landmarks[:, b] - body.landmarks[:, a], dim=-1)
        bend = (2 - 2 * (direction * self.bones).sum(-1)).clamp_min(0)
        bones = _mean(huber((bend + 1e-12).sqrt(), options.bone_sigma), self.bone_weight)
        prior = ((self.poses - self.mean) / self.sigma).square().sum((1, 2)).mean()
        terms = {
            "image": image, "bones": bones, "inside": inside, "reach": reach, "pose": prior,
            "betas": self.betas.square().sum(), "offset": (self.mirrored_offsets() / self.offset_sigma).square().sum(),
            "smooth": self._smoothness(body),
        }  # fmt: skip
        if stage > 0:
            terms["balance"] = huber(self._lean(body).square().sum(-1).add(1e-12).sqrt(), options.balance_sigma).mean()
            terms["tilt"] = (self.tilt / options.tilt_sigma).square().sum()
        if options.refine_cameras:
            sides = _tensor([[max(c.width, c.height)] for c in self.cameras])
            terms["camera"] = (self.shift / (0.01 * sides)).square().sum()  # one per cent of the image's side
        if options.stature is not None:
            terms["stature"] = ((self.rig.stature(self.betas) - options.stature) / 0.01) ** 2
        return terms

    def up(self) -> Tensor:
        """(3,) unit vector against gravity: the world's y, but for the tilt that is fitted."""
        return torch.nn.functional.normalize(torch.stack([self.tilt[0], torch.ones(()), self.tilt[1]]), dim=0)

    def _lean(self, body: Posed) -> Tensor:
        """(T, 3) metres, level: how far the trunk stands beside the middle of the feet. People seldom stand so that
        they would fall, which one camera cannot see when they lean towards it. Held loosely: walking is falling.
        Where no foot is seen, how far the pelvis tips over in the world as it was guessed."""
        trunk = 0.5 * (body.joints[:, 0] + body.joints[:, SHOULDERS].mean(1))
        lean, up = trunk - body.joints[:, FEET].mean(1), self.up()
        tipped = TRUNK * body.rotations[:, 0, :, 1] * torch.tensor([1.0, 0.0, 1.0])
        return torch.where(self.standing[:, None] > 0, lean - (lean @ up)[:, None] * up, tipped)

    def _silhouette_terms(self, c: int, silhouettes: Silhouettes, surface: Tensor) -> tuple[Tensor, Tensor]:
        options = self.options
        pixels, depth = self.project(c, surface)
        metres = depth.detach().mean(1, keepdim=True) / self.K[c][0]
        # vertices are all counted: a whole limb outside costs more than a finger; but of what lies beside the picture
        # no mask says anything
        width, height = silhouettes.size
        x, y = pixels.detach().unbind(-1)
        pictured = (x >= 0) & (y >= 0) & (x <= width) & (y <= height)
        inside = huber(outside_distance(silhouettes, pixels) * metres, options.inside_sigma)
        inside = (inside * pictured).mean() * 4
        if self.nearest_age[c] % NEAREST_EVERY == 0:
            self.nearest[c] = nearest_to_outline(silhouettes, pixels)
        self.nearest_age[c] += 1
        gap = outline_gap(silhouettes, pixels, self.nearest[c])
        return inside, _mean(robust(gap * metres, options.reach_sigma), silhouettes.valid)

    def _smoothness(self, body: Posed) -> Tensor:
        if self.frames < 3:
            return torch.zeros(())
        options, fps = self.options, self.fps
        place = (self.trans[2:] - 2 * self.trans[1:-1] + self.trans[:-2]) * fps**2 / options.trans_acceleration
        step = body.rotations[:-1].transpose(-1, -2) @ body.rotations[1:]  # constant while a joint turns steadily
        spin = (step[1:] - step[:-1]) * (fps**2 / options.angular_acceleration / 2**0.5)
        return (
            huber(place.square().sum(-1).add(1e-12).sqrt(), 1.0).mean()
            + huber(spin.square().sum((-1, -2)).add(1e-12).sqrt(), 1.0).sum(-1).mean()
        )

    def run(self, progress: bool = True) -> Fit:
        """Optimise in three stages and return the result."""
        stages = (
            ("place", [self.turn, self.trans, self.betas]),
            ("pose", [self.turn, self.trans, self.betas, self.poses, self.offsets, self.tilt]),
            ("silhouette", [self.turn, self.trans, self.betas, self.poses, self.offsets, self.tilt]),
        )
        side = max(self.cameras[0].width, self.cameras[0].height)
        rates = {self.turn: 0.02, self.trans: 0.02, self.betas: 0.03, self.poses: 0.03, self.offsets: 0.002,
                 self.shift: 0.0005 * side, self.tilt: 0.005}  # fmt: skip
        if self.options.refine_cameras:
            stages[1][1].append(self.shift)
            stages[2][1].append(self.shift)
        last: dict[str, float] = {}
        for stage, ((name, unknowns), steps) in enumerate(zip(stages, self.options.steps, strict=True)):
            if stage == 2 and self.silhouettes is None:
                continue
            groups = [{"params": [u], "lr": rates[u]} for u in unknowns]
            optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99))
            schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, _warm_cosine(steps))
            bar = Progress(f"fit {name}", steps, "step", show=progress)
            for step in range(steps):
                optimizer.zero_grad()
                terms = self.losses(stage)
                weights = self._weights(stage, step / steps)
                total = sum((weights[k] * v for k, v in terms.items()), torch.zeros(()))
                total.backward()
                if self.poses.grad is not None:
                    self.poses.grad *= self.moving
                optimizer.step()
                schedule.step()
                with torch.no_grad():
                    self.poses.clamp_(self.low, self.high)
                last = {k: float(v.detach()) for k, v in terms.items()}
                bar.advance(loss=float(total.detach()), image=last["image"])
            bar.close()
        if not all(torch.isfinite(u).all() for u in stages[1][1]):
            raise UserError(
                "the fit diverged to NaN: the landmarks or cameras contradict each other; check their units"
            )
        return self._result(last)

    def _weights(self, stage: int, progress: float) -> dict[str, float]:
        """The terms' weights after the share `progress` of a stage."""
        options = self.options
        before = max(0.0, 1 - progress / options.lead) if stage == 1 and options.lead > 0 else 0.0
        first = {"bones": options.lead_bones**before, "image": options.lead_image**before}
        return {name: weight * first.get(name, 1.0) for name, weight in options.weights.items()}

    @torch.no_grad()
    def _result(self, losses: dict[str, float]) -> Fit:
        body = self.posed(surface=False)
        poses = np.zeros((self.frames, self.data.num_joints, 3))
        poses[:, 0] = axis_angle_from_matrix(body.rotations[:, 0].double().numpy())
        poses[:, 1:SMPL_BODY_JOINTS] = self.poses.numpy()
        error = []
        for c in range(len(self.cameras)):
            miss = (self.project(c, body.landmarks)[0] - self.image[c]).norm(dim=-1)
            error.append(torch.where(self.visibility[c] > CERTAIN**2, miss, torch.nan).numpy())
        trans, betas, up = (value.double().numpy() for value in (self.trans, self.betas, self.up()))
        up /= np.linalg.norm(up)  # it was of unit length in float32
        return Fit(poses, trans, betas, np.stack(error), self.shift.numpy(), up, losses)


def _mean(values: Tensor, weight: Tensor) -> Tensor:
    return (values * weight).sum() / weight.sum().clamp_min(1e-6)


def _warm_cosine(steps: int) -> Callable[[int], float]:
    return lambda step: min(1.0, (step + 1) / 10) * (0.02 + 0.98 * 0.5 * (1 + np.cos(np.pi * min(step / steps, 1))))


def _tensor(array: Any) -> Tensor:
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32)
