"""An avatar as one glTF file: Gaussians on a skin, a skeleton, and an animation a motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import WrongValue
from ..formats.files import atomic
from ..formats.glb_file import GlbFile
from ..geometry.rotations import quaternion_from_axis_angle
from ..play.outputs.glb import gaussian_primitive
from ..render.widening import as_filmed
from ..values.gaussians import Gaussians
from ..values.motion import Motion
from ..web.look import StillLook, read_look
from .conversion import CONVERSIONS, Conversion, Request

IN_A_SET = 4  # joints of a point in one attribute JOINTS_n


@dataclasses.dataclass
class GltfOptions:
    """joints: that a point may follow, the heaviest ones; 0 for all that it follows. Many viewers read four."""

    joints: int = 0


@CONVERSIONS.register(
    "glb", config=GltfOptions, summary="a .glb: splats (KHR_gaussian_splatting) with a skin and an animation a motion"
)
class SkinnedGlb(Conversion):
    """The Gaussians of the canonical pose; viewers that skin points move them, others show them as they are.

    Nodes are the joints, in their places at rest, standing at ease; inverse bind matrices lead from the canonical pose
    to rest. Animations: the rotation of each joint that leaves that stance, and the root's translation.
    """

    suffixes = (".glb",)

    def write(self, request: Request, path: Path) -> None:
        file = GlbFile()
        look = self._look(request)
        index, weight = self._influences(look)
        skin_of = _skeleton(file, look)
        more = {}
        for first in range(0, index.shape[1], IN_A_SET):
            part = slice(first, first + IN_A_SET)
            more[f"JOINTS_{first // IN_A_SET}"] = file.accessor(index[:, part], vertices=True)
            more[f"WEIGHTS_{first // IN_A_SET}"] = file.accessor(weight[:, part], vertices=True)
        gaussians = as_filmed(Gaussians(look.points, look.scales, look.colors), look.pixel)
        mesh = file.add("meshes", {"name": look.name, "primitives": [gaussian_primitive(file, gaussians, more)]})
        shown = file.add("nodes", {"name": f"{look.name}_gaussians", "mesh": mesh, "skin": skin_of})
        root = file.document["skins"][skin_of]["skeleton"]
        file.document |= {"scene": 0, "scenes": [{"name": look.name, "nodes": [root, shown]}]}
        for motion in request.motions:
            _animation(file, look, motion)
            if motion.expression is not None and np.any(motion.expression):
                self.notes.append(f"the facial expressions of '{motion.name}' are left out")
        with atomic(path) as temporary:
            temporary.write_bytes(file.to_bytes())

    def _look(self, request: Request) -> StillLook:
        """One look for all poses: what a skin can carry."""
        look = read_look(request.avatar, request.tier, "file")
        if request.gaussians is not None:
            look = look.thinned(request.gaussians)
        self.notes += look.notes
        if look.residual is not None and request.tier is not None:
            raise WrongValue(f"`tier={request.tier}` follows the pose, and a glTF file holds one look: leave it out")
        if look.residual is not None:
            self.notes.append("the file holds one look for all poses: what follows the pose is left out")
            look = dataclasses.replace(look, residual=None)
        return look

    def _influences(self, look: StillLook) -> tuple[np.ndarray, np.ndarray]:
        """(N, 4 k) joints, uint8 or uint16, and float32 weights that sum to one, the heaviest first; joints of weight
        zero are 0, as the format wants it."""
        most = self.options.joints
        if most < 0 or most % IN_A_SET:
            raise WrongValue(f"`joints={most}`: give a multiple of {IN_A_SET}, or 0 for all that a point follows")
        order = np.argsort(-look.joint_weight, 1, kind="stable")
        index, weight = (np.take_along_axis(a, order, 1) for a in (look.joint_index, look.joint_weight))
        used = max(1, int((weight > 0).sum(1).max(initial=1)))
        beyond = int((weight[:, IN_A_SET:] > 0).any(1).sum())
        if most and used > most:
            cut = int((weight[:, most:] > 0).any(1).sum())
            self.notes.append(f"{cut} of {len(look)} points follow more than {most} joints: the lightest are left out")
            used = most
        elif beyond:
            self.notes.append(
                f"{beyond} of {len(look)} points follow more than {IN_A_SET} joints: for a viewer that reads no more, "
                f"give the option joints={IN_A_SET}"
            )
        slots = -(-used // IN_A_SET) * IN_A_SET
        kept = np.zeros((len(look), slots), np.float32)
        kept[:, :used] = weight[:, :used]
        kept /= kept.sum(1, keepdims=True, dtype=np.float64)
        joints = np.zeros_like(kept, np.uint8 if len(look.parents) <= 256 else np.uint16)
        joints[:, :used] = index[:, :used]
        joints[kept == 0] = 0
        return joints, kept


def _skeleton(file: GlbFile, look: StillLook) -> int:
    """A node a joint, under the index of the joint, and the skin: its index."""
    stance = _gltf_quaternions(look.relaxed)
    for joint, (name, parent) in enumerate(zip(look.joint_names, look.parents, strict=True)):
        offset = look.rest[joint] - (look.rest[parent] if parent >= 0 else 0)
        node = {"name": name, "translation": offset.tolist(), "rotation": stance[joint].tolist()}
        children = np.flatnonzero(look.parents == joint).tolist()
        file.add("nodes", node | ({"children": children} if children else {}))
    bind = np.tile(np.eye(4), (len(look.parents), 1, 1))
    bind[:, :3] = look.inverse
    bind[:, :3, 3] -= look.rest  # from the canonical pose to rest, seen from the joint
    matrices = file.accessor(bind.astype(np.float32))
    root = int(np.flatnonzero(look.parents < 0)[0])
    joints = list(range(len(look.parents)))
    return file.add("skins", {"inverseBindMatrices": matrices, "joints": joints, "skeleton": root})


def _animation(file: GlbFile, look: StillLook, motion: Motion) -> None:
    """One motion under its name. Joints that it holds still, elsewhere than at ease, have one key."""
    frames = np.arange(len(motion), dtype=np.float64) / motion.fps
    times = file.accessor(frames.astype(np.float32), bounds=True)
    once = file.accessor(np.zeros(1, np.float32), bounds=True) if len(motion) > 1 else times
    root = int(np.flatnonzero(look.parents < 0)[0])
    rotations = {
        j: motion.poses[:, j] for j in range(len(look.parents)) if (motion.poses[:, j] != look.relaxed[j]).any()
    }
    tracks = [(j, "rotation", _gltf_quaternions(rotations[j])) for j in rotations]
    tracks.append((root, "translation", (look.rest[root] + motion.trans).astype(np.float32)))
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    for joint, path, values in tracks:
        still = (values == values[0]).all()
        sampler = {"input": once if still else times, "output": file.accessor(values[:1] if still else values)}
        channels.append({"sampler": len(samplers), "target": {"node": joint, "path": path}})
        samplers.append(sampler | {"interpolation": "LINEAR"})
    file.add("animations", {"name": motion.name, "samplers": samplers, "channels": channels})


def _gltf_quaternions(axis_angle: np.ndarray) -> np.ndarray:
    """(T, 3) -> (T, 4) float32 xyzw of length 1, each on the side of its predecessor, so that no reader's interpolation
    between them takes the long way round."""
    q = quaternion_from_axis_angle(np.asarray(axis_angle, np.float64))[:, [1, 2, 3, 0]]
    flips = np.cumprod(np.where((q[1:] * q[:-1]).sum(1) < 0, -1, 1))
    q[1:] *= flips[:, None]
    return q.astype(np.float32)
