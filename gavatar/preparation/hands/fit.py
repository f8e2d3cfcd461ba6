"""Fitting wrists and fingers to hand landmarks, on a body that was fitted already.

The forearm's twist, the wrist and the fingers of both hands are found together over all frames; the elbow's place and
all of the rest stay. Residuals are in metres and radians, as in `..fit`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.camera import Camera

from ...body.torch_rotations import matrix_from_axis_angle as torch_matrix
from ..anatomy import joint_ranges
from ..fit import huber
from .anatomy import HandAnatomy, hand_anatomy
from .landmarks import BONES, LEAST_SIDE, SIDES, HandLandmarks

STEPS = 250
IMAGE_SIGMA = 0.006  # metres: fingers are 15 mm thick
BONE_SIGMA = 0.5  # radians; a network's depth of one small picture is rough
OFFSET_SIGMA = 0.005  # metres, how far a landmark may sit from its joint, the same way in every frame
TWIST_SIGMA, MOST_TWIST = 0.5, 1.5  # radians of the forearm, beyond what the body's fit gave it
ACCELERATION = 150.0  # radians / s^2
WEIGHTS = {"image": 1.0, "bones": 0.5, "fingers": 0.03, "wrist": 0.1, "coupled": 0.05, "smooth": 1.0, "places": 0.02}
NEAR = 0.15  # metres between the fitted wrist and the landmarks' within which they are taken for this hand's
SEEN = 0.05  # least share of the frames with a hand for which its fingers are fitted


@dataclasses.dataclass(frozen=True)
class HandFit:
    """poses: (T, J, 3) axis-angle, the body's with forearms, wrists and fingers as found. seen: (2,) share of the
    frames in which the left and the right hand's fingers were seen. error: (2,) pixels, the landmarks' median distance
    to the body's, NaN where never seen. size: (2,) pixels, the median length of an outstretched hand where one was
    found, 0 where none was."""

    poses: np.ndarray
    seen: np.ndarray
    error: np.ndarray
    size: np.ndarray

    def sentences(self) -> list[str]:
        """What of the hands was seen, for people."""
        said = []
        for h, side in enumerate(SIDES):
            if self.seen[h] > 0:
                continue
            why = (f"{self.size[h]:.0f} pixels long, fingers need {LEAST_SIDE:.0f}" if self.size[h] > 0
                   else "seen too seldom")  # fmt: skip
            said.append(f"the {side} hand's fingers are not fitted ({why}): they rest relaxed")
        return said


def fit_hands(data: BodyData, cameras: list[Camera], hands: list[HandLandmarks | None], poses: np.ndarray,
              trans: np.ndarray, betas: np.ndarray, fps: float, resting: tuple[str, ...] = ()) -> HandFit:  # fmt: skip
    """Fit wrists and fingers to what C cameras saw. poses: (T, J, 3) axis-angle. trans: (T, 3). resting: names of
    joints that no frame shows, which keep their pose. A hand that is hardly seen hangs relaxed."""
    anatomy = hand_anatomy(data, betas)
    fitter = _HandFitter(data, anatomy, cameras, hands, poses, trans, betas, fps)
    seen = (fitter.weight > 0.1).any(0).mean(0)
    free = np.array([seen[h] >= SEEN and f"{side}_wrist" not in resting for h, side in enumerate(SIDES)])
    poses = poses.copy()
    for h in range(2):
        poses[:, anatomy.joints[h, 1:]] = anatomy.relaxed_pose()[h]
    error = np.full(2, np.nan)
    if free.any():
        found, error = fitter.run()
        for h in np.flatnonzero(free).tolist():
            poses[:, [fitter.elbows[h], *anatomy.joints[h]]] = found[h]
    return HandFit(poses, np.where(free, seen, 0), np.where(free, error, np.nan), _sizes(hands))


def _sizes(hands: list[HandLandmarks | None]) -> np.ndarray:
    found = [[h.size[h.weight[:, side] > 0, side] for h in hands if h is not None] for side in range(2)]
    joined = [np.concatenate(sizes) if sizes else np.zeros(0) for sizes in found]
    return np.array([float(np.median(sizes)) if len(sizes) else 0.0 for sizes in joined])


class _HandFitter:
    def __init__(self, data: BodyData, anatomy: HandAnatomy, cameras: list[Camera], hands: list[HandLandmarks | None],
                 poses: np.ndarray, trans: np.ndarray, betas: np.ndarray, fps: float):  # fmt: skip
        self.anatomy, self.cameras, self.fps = anatomy, cameras, fps
        names = list(data.joint_names)
        self.elbows = [names.index(f"{side}_elbow") for side in SIDES]
        self.elbow_pose = poses[:, self.elbows].copy()
        self.wrist_pose = poses[:, anatomy.joints[:, 0]].copy()
        self.forearm_at, self.wrist_at = _placed(data, anatomy, self.elbows, poses, trans, betas)
        self._observe(hands)
        low, high, _, sigma = joint_ranges(tuple(names))
        self.wrist_low, self.wrist_high, self.wrist_sigma = (_tensor(v[anatomy.joints[:, 0]])[:, None]
                                                             for v in (low, high, sigma))  # fmt: skip
        self._unknowns()

    def _observe(self, hands: list[HandLandmarks | None]) -> None:
        """Believe the landmarks that lie at a wrist of the body; those that the sides' exchange put at the other
        one are given to that."""
        T = len(self.wrist_at)
        taken = [HandLandmarks.unseen(T) if h is None else h for h in hands]
        self.image, self.world = np.zeros((len(taken), T, 2, 21, 2)), np.zeros((len(taken), T, 2, 21, 3))
        self.weight = np.zeros((len(taken), T, 2))
        for c, (camera, hand) in enumerate(zip(self.cameras, taken, strict=True)):
            projected = camera.project(self.wrist_at.reshape(-1, 3)).reshape(T, 2, -1)
            metres = projected[..., 2] / camera.fx
            R = camera.T_camera_world[:3, :3]
            off = np.linalg.norm(hand.image[:, :, None, 0] - projected[:, None, :, :2], axis=-1) * metres[:, None]
            crossed = (off[:, 0, 1] + off[:, 1, 0]) < (off[:, 0, 0] + off[:, 1, 1])
            crossed &= (hand.believed > 0).all(1)
            order = np.where(crossed[:, None], [1, 0], [0, 1])
            self.image[c] = np.take_along_axis(hand.image, order[..., None, None], 1)
            world = np.take_along_axis(hand.world, order[..., None, None], 1)
            ray = (self.image[c][:, :, 9] - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
            ray = np.concatenate([ray, np.ones_like(ray[..., :1])], -1)
            turn = rotation_between(np.array([0.0, 0.0, 1.0]), ray / np.linalg.norm(ray, axis=-1, keepdims=True))
            self.world[c] = np.einsum("thab,thkb->thka", turn, world) @ R
            off = np.take_along_axis(off, order[..., None], 1)[:, [0, 1], [0, 1]]
            self.weight[c] = np.take_along_axis(hand.believed, order, 1) * (off < NEAR)

    def _unknowns(self) -> None:
        anatomy, T = self.anatomy, len(self.wrist_at)
        self.twist = torch.zeros(2, T, requires_grad=True)
        self.wrist = _tensor(self.wrist_pose).transpose(0, 1).contiguous().requires_grad_()
        self.relaxed, self.finger_sigma = _tensor(anatomy.relaxed), _tensor(anatomy.sigma)
        self.low, self.high = _tensor(anatomy.low), _tensor(anatomy.high)
        self.fingers = self.relaxed.expand(2, T, 15, 3).clone().requires_grad_()
        self.offsets = torch.zeros(21, 3, requires_grad=True)
        self.size = torch.zeros((), requires_grad=True)
        self.axes, self.forearm = _tensor(anatomy.axes)[:, None], _tensor(anatomy.forearm)[:, None]
        self.arm = _tensor(self.forearm_at).transpose(0, 1)
        self.wrists = _tensor(self.wrist_at).transpose(0, 1)
        self.rest, self.tips = _tensor(anatomy.rest), _tensor(anatomy.tips)
        a, b = np.array(BONES).T
        bones = self.world[..., b, :] - self.world[..., a, :]
        length = np.linalg.norm(bones, axis=-1, keepdims=True)
        self.bones = _tensor(bones / np.maximum(length, 1e-6)).transpose(1, 2)
        self.known = _tensor(length[..., 0] > 1e-3).transpose(1, 2)
        self.pixels, self.belief = _tensor(self.image).transpose(1, 2), _tensor(self.weight).transpose(1, 2)

    def rotations(self) -> tuple[Tensor, Tensor]:
        """(2, T, 3, 3) hands in the world and (2, T, 15, 3, 3) fingers about their parents."""
        forearm = self.arm @ torch_matrix(self.twist[..., None] * self.forearm)
        return forearm @ torch_matrix(self.wrist), torch_matrix((self.axes @ self.fingers[..., None])[..., 0])

    def points(self, hand: Tensor, fingers: Tensor) -> Tensor:
        """(2, T, 21, 3) landmarks of the body's hands in the world, around their wrists."""
        flip = torch.stack([torch.ones(3), torch.tensor([-1.0, 1.0, 1.0])])
        offsets = self.offsets[None] * flip[:, None]
        places: list[Tensor] = [torch.zeros_like(hand[..., 0]) + (hand @ offsets[:, None, 0, :, None])[..., 0]]
        for f in range(5):
            R, p = hand, torch.zeros_like(hand[..., 0])
            for k in range(3):
                j = 3 * f + k
                start = self.rest[:, j + 1] - (self.rest[:, j] if k else 0)
                p = p + (R @ start[:, None, :, None])[..., 0]
                R = R @ fingers[:, :, j]
                places.append(p + (R @ offsets[:, None, 4 * f + k + 1, :, None])[..., 0])
            tip = self.tips[:, f] + offsets[:, 4 * f + 4]
            places.append(p + (R @ tip[:, None, :, None])[..., 0])
        return torch.stack(places, 2) * torch.exp(self.size)

    def losses(self) -> dict[str, Tensor]:
        """Every term, unweighted."""
        hand, fingers = self.rotations()
        points = self.points(hand, fingers)
        image = bones = torch.zeros(())
        a, b = np.array(BONES).T
        direction = torch.nn.functional.normalize(points[:, :, b] - points[:, :, a], dim=-1)
        for c, camera in enumerate(self.cameras):
            pixels, metres = self._project(camera, points + self.wrists[:, :, None])
            gap = pixels - self.pixels[c]
            # where the hand is as a whole is for the body to say: a wrist that is off by some pixels bends no finger
            gap = (gap - gap.mean(2, keepdim=True)) * metres[..., None, None]
            distance = gap.square().sum(-1).add(1e-12).sqrt()
            image = image + (_robust(distance, IMAGE_SIGMA).mean(2) * self.belief[c]).mean()
            bend = (2 - 2 * (direction * self.bones[c]).sum(-1)).clamp_min(0).add(1e-12).sqrt()
            bones = bones + (huber(bend, BONE_SIGMA) * self.known[c] * self.belief[c][..., None]).mean()
        drop = self.fingers.unflatten(2, (5, 3))[:, :, 1:, 1:, 1]  # two last joints of four fingers share tendons
        terms = {
            "image": image, "bones": bones,
            "fingers": ((self.fingers - self.relaxed) / self.finger_sigma).square().sum((2, 3)).mean(),
            "wrist": (self.wrist / self.wrist_sigma).square().sum(-1).mean()
            + (self.twist / TWIST_SIGMA).square().mean(),
            "coupled": ((drop[..., 1] - 0.6 * drop[..., 0]) / 0.2).square().sum(-1).mean(),
            "smooth": self._smoothness(hand, fingers),
            "places": (self.offsets / OFFSET_SIGMA).square().sum() + (self.size / 0.1).square(),
        }  # fmt: skip
        return terms

    def _project(self, camera: Camera, points: Tensor) -> tuple[Tensor, Tensor]:
        T = _tensor(camera.T_camera_world)
        local = points @ T[:3, :3].T + T[:3, 3]
        depth = local[..., 2:].clamp_min(0.1)
        pixels = local[..., :2] / depth * _tensor([camera.fx, camera.fy]) + _tensor([camera.cx, camera.cy])
        return pixels, depth.detach().mean((2, 3)) / camera.fx

    def _smoothness(self, hand: Tensor, fingers: Tensor) -> Tensor:
        if len(self.wrist_at) < 3:
            return torch.zeros(())
        scale = self.fps**2 / ACCELERATION
        step = hand[:, :-1].transpose(-1, -2) @ hand[:, 1:]
        spin = (step[:, 1:] - step[:, :-1]).square().sum((-1, -2)).add(1e-12).sqrt() * (scale / 2**0.5)
        turn = (self.fingers[:, 2:] - 2 * self.fingers[:, 1:-1] + self.fingers[:, :-2]).square().sum(-1)
        return 3 * huber(spin, 1.0).mean() + huber(turn.add(1e-12).sqrt() * scale, 1.0).sum(-1).mean()

    def run(self) -> tuple[np.ndarray, np.ndarray]:
        """(2, T, 17, 3) axis-angle of elbow, wrist and fingers, and (2,) pixels of error."""
        rates = {self.fingers: 0.03, self.wrist: 0.02, self.twist: 0.02, self.offsets: 0.0005, self.size: 0.005}
        optimizer = torch.optim.Adam([{"params": [u], "lr": rate} for u, rate in rates.items()], betas=(0.9, 0.99))
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: min(1.0, (step + 1) / 10) * (0.02 + 0.49 * (1 + np.cos(np.pi * step / STEPS)))
        )
        for _ in range(STEPS):
            optimizer.zero_grad()
            total = sum((WEIGHTS[name] * term for name, term in self.losses().items()), torch.zeros(()))
            total.backward()
            optimizer.step()
            schedule.step()
            with torch.no_grad():
                self.fingers.clamp_(self.low, self.high)
                self.wrist.clamp_(self.wrist_low, self.wrist_high)
                self.twist.clamp_(-MOST_TWIST, MOST_TWIST)
        return self._result()

    @torch.no_grad()
    def _result(self) -> tuple[np.ndarray, np.ndarray]:
        hand, fingers = self.rotations()
        points = self.points(hand, fingers) + self.wrists[:, :, None]
        error = np.full(2, np.nan)
        for h in range(2):
            miss = []
            for c, camera in enumerate(self.cameras):
                gap = (self._project(camera, points)[0] - self.pixels[c])[h]
                distance = (gap - gap.mean(1, keepdim=True)).norm(dim=-1)
                miss.append(distance[self.belief[c][h] > 0.1].reshape(-1))
            if len(joined := torch.cat(miss)):
                error[h] = float(joined.median())
        turns = self.twist.double().numpy()[..., None] * self.anatomy.forearm[:, None]
        elbow = matrix_from_axis_angle(self.elbow_pose.transpose(1, 0, 2)) @ matrix_from_axis_angle(turns)
        bent = np.einsum("hjab,htjb->htja", self.anatomy.axes, self.fingers.double().numpy())
        parts = [axis_angle_from_matrix(elbow)[:, :, None], self.wrist.double().numpy()[:, :, None], bent]
        return np.concatenate(parts, 2), error


def _placed(data: BodyData, anatomy: HandAnatomy, elbows: list[int], poses: np.ndarray, trans: np.ndarray,
            betas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(T, 2, 3, 3) the forearms' rotations and (T, 2, 3) the wrists' places in the world."""
    T = joint_transforms(poses, data.shaped(betas)[1], data.parents)
    return T[:, elbows, :3, :3], T[..., :3, 3][:, anatomy.joints[:, 0]] + trans[:, None]


def _robust(residual: Tensor, sigma: float) -> Tensor:
    square = (residual / sigma) ** 2
    return square / (1 + square / 25)


def _tensor(array: object) -> Tensor:
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32)
