"""The motion table: every frame's pose and translation, as estimated plus a learnable correction."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from gavatar_runtime.geometry.rotations import axis_angle_from_matrix
from gavatar_runtime.values.body import SMPL_BODY_JOINTS, check_motion_fits
from gavatar_runtime.values.motion import Motion

from ..avatar.trainable import Pose
from ..body.torch_rotations import matrix_from_axis_angle
from ..losses import MotionState


class MotionTable(nn.Module):
    """Poses of T frames, optimised jointly with the appearance (paper, section 4.3).

    A correction is a rotation vector composed with the estimated rotation, `R = R_estimated exp(correction)`: it stays
    small, so nothing wraps at pi, whatever the estimate's own axis-angle does. `joints`: how many of the first joints
    are corrected (the 22 body joints by default; fingers are hardly ever seen well enough).

    rotation_correction: (T, joints, 3) radians. trans_correction: (T, 3) metres. Both start at zero. An expression is
    taken as it is given.
    """

    initial_rotations: Tensor
    initial_trans: Tensor
    _expression: Tensor | None

    def __init__(self, motion: Motion, num_joints: int, joints: int = SMPL_BODY_JOINTS):
        super().__init__()
        self.fps, self.betas = motion.fps, motion.betas
        poses = check_motion_fits(np.asarray(motion.poses, np.float32), num_joints)
        trans = np.asarray(motion.trans, np.float32)
        initial = matrix_from_axis_angle(torch.as_tensor(poses, dtype=torch.float64)).float()
        self.register_buffer("initial_rotations", initial, persistent=False)
        self.register_buffer("initial_trans", torch.as_tensor(trans), persistent=False)
        expression = None if motion.expression is None else torch.as_tensor(motion.expression, dtype=torch.float32)
        self.register_buffer("_expression", expression, persistent=False)
        self.joints = min(joints, num_joints)
        self.rotation_correction = nn.Parameter(torch.zeros(len(poses), self.joints, 3))
        self.trans_correction = nn.Parameter(torch.zeros(len(poses), 3))

    def __len__(self) -> int:
        return len(self.initial_trans)

    def forward(
        self,
        frames: Tensor | slice | list[int] = slice(None),
        rotation_correction: Tensor | None = None,
        trans_correction: Tensor | None = None,
    ) -> Pose:
        """The corrected poses of the given frames (all by default), by the table's own corrections or by those
        given."""
        turn = self.rotation_correction if rotation_correction is None else rotation_correction
        shift = self.trans_correction if trans_correction is None else trans_correction
        initial = self.initial_rotations[frames]
        corrected = initial[:, : self.joints] @ matrix_from_axis_angle(turn[frames])
        rotations = torch.cat([corrected, initial[:, self.joints :]], 1)
        return Pose(rotations, self.initial_trans[frames] + shift[frames], self._expression_of(frames))

    def estimated(self, frames: Tensor | slice | list[int] = slice(None)) -> Pose:
        """The poses of the given frames (all by default) as they were estimated."""
        return Pose(self.initial_rotations[frames], self.initial_trans[frames], self._expression_of(frames))

    def _expression_of(self, frames: Tensor | slice | list[int]) -> Tensor | None:
        return None if self._expression is None else self._expression[frames]

    @torch.no_grad()
    def motion(self, name: str = "refined", rows: slice | list[int] = slice(None)) -> Motion:
        """The corrected motion as plain arrays, of the given frames (all by default)."""
        pose = self(rows)
        poses = axis_angle_from_matrix(pose.rotations.double().cpu().numpy()).astype(np.float32)
        expression = None if pose.expression is None else pose.expression.cpu().numpy()
        return Motion(poses, pose.trans.cpu().numpy(), self.fps, self.betas, name, expression=expression)

    def state(self, frames: list[int], pose: Pose) -> MotionState:
        """What losses look at of the motion: `pose`, that of `frames`, beside its estimate."""
        return MotionState(
            rotations=pose.rotations,
            rotations_initial=self.initial_rotations[frames],
            trans=pose.trans,
            trans_initial=self.initial_trans[frames],
            frame_times=torch.tensor(frames, device=pose.trans.device, dtype=pose.trans.dtype) / self.fps,
        )


def shared_frames(times: Tensor, shown: Tensor, width: float) -> tuple[Tensor, Tensor]:
    """The frames that a step on some of them moves, and the kernel by which they take part.

    The errors of pose estimators are alike in neighbouring frames, so what an image says of its own frame it says,
    less and less, of those around it: the gradient is smoothed over time by a Gaussian (a Sobolev gradient), every
    frame learns many times an epoch, and noise averages out. Where nothing is shown nothing is moved.

    times: (T,) seconds, in any order. shown: (B,) indices into them, distinct. width: standard deviation in seconds; 0
    moves the shown frames alone. Returns (R,) indices of the frames within two widths of a shown one, the shown ones
    among them, and the (R, R) kernel for `RowAdam.step`: columns of frames that were not shown are zero. ValueError
    when nothing is shown.
    """
    if len(shown) == 0:
        raise ValueError("shared_frames: at least one frame must be shown")
    if not width > 0:
        return shown, torch.eye(len(shown), device=times.device)
    rows = ((times[:, None] - times[shown]).abs().amin(1) <= 2 * width).nonzero().flatten()
    near = torch.exp(-0.5 * ((times[rows, None] - times[rows]) / width) ** 2)
    return rows, near * torch.isin(rows, shown)


def scale_gradient(values: Tensor, factor: float) -> Tensor:
    """`values` unchanged, their gradient multiplied by `factor`."""
    return values.detach() + factor * (values - values.detach())


class RowAdam(torch.optim.Optimizer):
    """Adam that touches only the given rows of its parameters, each with its own step count.

    A batch shows a few frames; with dense Adam the others would drift on by momentum, and their second moments would
    decay between visits. (torch.optim.SparseAdam needs sparse gradients, which a table read by slices and by a
    smoothness term does not have; Kingma & Ba 2015, algorithm 1, row by row.)
    """

    def __init__(
        self,
        parameters: Iterable[Tensor] | Iterable[dict[str, Any]],
        lr: float = 1e-3,
        betas: tuple[float, float] = (0.9, 0.99),
        eps: float = 1e-10,
    ):
        super().__init__(parameters, {"lr": lr, "betas": betas, "eps": eps})

    def forget(self, rows: list[int]) -> None:
        """Start afresh on these rows, as if they had never been stepped."""
        for state in self.state.values():
            for values in state.values():
                values[rows] = 0

    @torch.no_grad()
    def step(  # type: ignore[override]
        self, rows: Tensor, kernel: Tensor | None = None, own: dict[nn.Parameter, Tensor] | None = None
    ) -> None:
        """rows: (B,) int64 distinct rows to update. kernel: (B, B) mixes the gradients of those rows before the step,
        row i receives the sum over k of kernel[i, k] times the gradient of row k; None leaves each its own. own:
        further gradients, by parameter and in its shape, that are not mixed."""
        for group in self.param_groups:
            beta1, beta2 = group["betas"]
            for p in group["params"]:
                if p.grad is None:
                    continue
                state = self.state[p]
                if not state:
                    state["count"] = torch.zeros(len(p), dtype=p.dtype, device=p.device)
                    state["first"], state["second"] = torch.zeros_like(p), torch.zeros_like(p)
                g = p.grad[rows]
                if kernel is not None:
                    g = (kernel.to(g.dtype) @ g.flatten(1)).view_as(g)
                if own is not None and p in own:
                    g = g + own[p][rows]
                state["count"][rows] += 1
                count = state["count"][rows].view(-1, *[1] * (p.dim() - 1))
                first = state["first"][rows].lerp(g, 1 - beta1)
                second = state["second"][rows] * beta2 + (1 - beta2) * g * g
                state["first"][rows], state["second"][rows] = first, second
                update = (first / (1 - beta1**count)) / ((second / (1 - beta2**count)).sqrt() + group["eps"])
                p[rows] -= group["lr"] * update
