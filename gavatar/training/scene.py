"""The scene: a capture's views and the avatar in them, drawn and compared in one place."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.render.widening import as_trained
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians

from ..assemble import AvatarBuild
from ..attributes import Attributes
from ..avatar.trainable import Avatar, Pose
from ..capture.capture import View
from ..config import LevelConfig
from ..protocols import Rasterizer
from .footage import Comparison, FootageSource
from .motion_table import MotionTable
from .remedies.exposure import Exposure
from .remedies.placed_evidence import PlacedEvidence
from .remedies.shape import Shape
from .verdicts import ShapeVerdict

WHITE = torch.ones(3)


class Scene:
    """An avatar before the cameras that filmed a person: all that decides what is drawn in a view.

    built: the avatar and the body it stands on. rasterize: draws Gaussians before a camera. footage: of the views; a
    row is a place in their list. motion: a pose for each frame of the capture. exposure: gains of the views, None where
    every camera shows the avatar's own colours. shape: a correction of the body's shape, None where it is as it is.
    evidence: what the views say of the body's points, None before a stage has come to its end.
    """

    def __init__(
        self,
        built: AvatarBuild,
        rasterize: Rasterizer,
        footage: FootageSource,
        motion: MotionTable,
        exposure: Exposure | None = None,
        shape: Shape | None = None,
    ):
        self.built, self.rasterize, self.footage, self.motion = built, rasterize, footage, motion
        self.exposure, self.shape = exposure, shape
        self.frames = sorted({view.frame for view in footage.views})
        self.evidence: PlacedEvidence | None = None
        self._inputs: dict[int, list[Tensor]] = {}  # of the encoder, by frame

    @property
    def avatar(self) -> Avatar:
        return self.built.avatar

    @property
    def views(self) -> list[View]:
        return self.footage.views

    @property
    def device(self) -> torch.device:
        return self.avatar.features.device

    def frames_of(self, rows: Sequence[int]) -> list[int]:
        """The frames that the views in `rows` show."""
        return [self.views[row].frame for row in rows]

    def place(self, level: LevelConfig) -> None:
        """Have the avatar's Gaussians on the points of a level."""
        surface = self.built.surface(self.built.count(level))
        if not self.avatar.placed or self.avatar.surface is not surface:
            self.avatar.sample_at(surface)

    # --- poses --------------------------------------------------------------------------------------------------------
    def encoder_inputs(self, frames: Sequence[int]) -> list[Tensor]:
        """What the encoder looks at of the refined motion, (B, ...) each, without gradient; kept until `moved`."""
        for frame in frames:
            if frame not in self._inputs:
                self._inputs[frame] = self.built.encoder_tensors(self.motion.motion(rows=[frame]).poses)
        return [torch.cat(values) for values in zip(*(self._inputs[f] for f in frames), strict=True)]

    def pose_features(self, frames: Sequence[int]) -> Tensor | None:
        """(B, C, M, M) what the encoder makes of the refined poses of `frames`, None of a static avatar."""
        return self.avatar.encode(*self.encoder_inputs(frames))

    def moved(self, frames: Sequence[int]) -> None:
        """To be told whenever the poses of these frames have changed: the encoder has to look again."""
        for frame in frames:
            self._inputs.pop(frame, None)

    @property
    def betas_change(self) -> Tensor | None:
        """What the shape is corrected by beyond the body that the avatar stands on, None where that is all."""
        return None if self.shape is None or self.shape.settled else self.shape.change

    def settle_shape(self) -> ShapeVerdict:
        """From here on the avatar is the body of the shape as it is corrected now, to be placed afresh."""
        if self.shape is None:
            raise ValueError("the shape is not corrected")
        betas = self.shape.betas
        self.shape.settled = True
        self.built.reshape(betas)
        self.motion.betas = betas.astype(np.float32)
        self._inputs.clear()
        return ShapeVerdict(self.shape.estimated.tolist(), betas.round(4).tolist())

    # --- pictures -----------------------------------------------------------------------------------------------------
    def gaussians(self, attributes: Attributes, pose: Pose) -> list[Gaussians]:
        """The avatar in B poses, in the world. attributes: of B poses, or of one for all."""
        return self.avatar.pose(attributes, pose, self.betas_change)

    def draw(
        self,
        attributes: Attributes,
        pose: Pose,
        cameras: Sequence[Camera],
        background: Tensor = WHITE,
        pixel: float | None = None,
    ) -> tuple[Tensor, Tensor]:
        """(B, 3, H, W) colours over `background` and (B, H, W) alpha of the avatar in each of B poses before a camera
        each. pixel: metres that a pixel spanned in training; a camera nearer than that widens the Gaussians."""
        background, colors, alphas = background.to(self.device), [], []
        for gaussians, camera in zip(self.gaussians(attributes, pose), cameras, strict=True):
            drawn = self.rasterize(as_trained(gaussians, camera, pixel), camera, background)
            colors.append(drawn.color.permute(2, 0, 1))
            alphas.append(drawn.alpha)
        return torch.stack(colors), torch.stack(alphas)

    def render(
        self, rows: Sequence[int], scale: float, attributes: Attributes, *, background: Tensor = WHITE,
        pose: Pose | None = None,
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        """(B, 3, H, W) colours and (B, H, W) alpha of the avatar as the cameras of the views in `rows` would have taken
        it at an image scale. pose: by default that of the views' frames."""
        cameras = self.footage.at(scale).cameras
        pose = self.motion(self.frames_of(rows)) if pose is None else pose
        color, alpha = self.draw(attributes, pose, [cameras[row] for row in rows], background)
        if self.exposure is not None:
            color = self.exposure(rows, color, alpha, background.to(self.device))
        return color, alpha

    def compare(
        self, rows: Sequence[int], scale: float, attributes: Attributes, *, background: Tensor = WHITE,
        pose: Pose | None = None,
    ) -> Comparison:  # fmt: skip
        """The views in `rows` beside what `render` draws of them."""
        footage = self.footage.at(scale)
        target, mask = footage.batch(list(rows), background, self.device)
        render, alpha = self.render(rows, scale, attributes, background=background, pose=pose)
        return Comparison(target, render, mask, alpha)

    @torch.no_grad()
    def errors(
        self, rows: Sequence[int], scale: float, *, dynamic: bool = False, poses: Callable[[int], Pose] | None = None
    ) -> np.ndarray:
        """(V,) mean squared error on white of the views in `rows`, the avatar in eval mode.

        dynamic: with the pose encoder, which looks at the refined motion. poses: gives the pose of a frame, by default
        the refined one.
        """
        avatar, errors = self.avatar, []
        training = avatar.training
        avatar.eval()
        static = None if dynamic else avatar.attributes()
        for row in rows:
            frame = self.views[row].frame
            attributes = avatar.attributes(self.pose_features([frame])) if static is None else static
            seen = self.compare([row], scale, attributes, pose=None if poses is None else poses(frame))
            difference = (seen.render - seen.target).permute(0, 2, 3, 1).contiguous()  # summed pixel by pixel
            errors.append(float(difference.square().mean()))
        avatar.train(training)
        return np.array(errors)
