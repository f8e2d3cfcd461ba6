"""An avatar as a program sees it: what `import gavatar_runtime` offers."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .avatar import playing
from .avatar.poses import joint_rows, numbers, pose_of_parts
from .bundle import Bundle, read_bundle
from .conversions import convert
from .errors import WrongValue
from .motions.builtin import relaxed_pose
from .notes import Note
from .play.performance import PlayReport, perform
from .play.staging import Level, Shot, gaussians_of_side
from .render.renderer import Renderer
from .tiers import stored_tiers
from .values.camera import Camera
from .values.gaussians import Gaussians
from .values.motion import Motion

if TYPE_CHECKING:
    from .view.server import Viewer


def load(
    path: str | os.PathLike | Bundle,
    *,
    tier: str = "",
    gaussians: int | None = None,
    uv: int | None = None,
    threads: int | None = None,
) -> Avatar:
    """The avatar in a bundle.

    tier: how its Gaussians are decoded, of those that the bundle holds; '' for the networks as they were trained.
    gaussians: at most so many of them, each the larger, None for all. uv: the former way to say so, as the side of an
    atlas with so many texels on the body.
    threads: that decode, None for one a core.
    Raises UserError for a bundle that is not there, damaged or of a later format, and for what it does not hold.
    """
    bundle = path if isinstance(path, Bundle) else read_bundle(path)
    if gaussians is not None and uv is not None:
        raise WrongValue("`gaussians` and `uv` both choose the level of detail: give one of them")
    if uv is not None:
        Level(uv=uv)
        gaussians, note = gaussians_of_side(bundle, uv)
        warnings.warn(note, Note, stacklevel=2)
    return Avatar(bundle, tier=tier, gaussians=gaussians, threads=threads)


class Avatar(playing.Avatar):
    """A person in a bundle, to be posed, drawn, played and saved.

    A frame is given as `pose`, in rows (K, 3) or flat (3 K,), axis-angle of each joint relative to its parent, radians,
    of the body's own joints or of a skeleton of the SMPL family: 22, 24 (SMPL, 72 numbers), 52 (SMPL-H and AMASS, 156)
    or 55 (SMPL-X); or in parts as smplx names them, `global_orient=`, `body_pose=`, `left_hand_pose=`, ...
    (`poses.pose_of_parts`); with neither the person stands at ease. trans, or transl: (3,) metres, added after posing.
    expression: (E,) coefficients of a body with a face. What moves in a pose that the body lacks is left out with a
    warning. The world is y-up, in metres; a person who is not turned faces +z.

    tier, gaussians, threads and more: see `playing.Avatar`. Every method raises UserError for what the caller can mend,
    most often `WrongValue`, which is a ValueError too.
    """

    def __repr__(self) -> str:
        every = self.bundle.manifest.gaussians
        count = f"{len(self)}" if len(self) == every else f"{len(self)} of {every}"
        how = "no tier" if self.tier is None else f"tier {self.tier} (stored: {', '.join(self.tiers)})"
        body = self.bundle.manifest.body.get("model", "unknown")
        moves = "moves with the pose" if self.dynamic else "one look for all poses"
        return (
            f"<Avatar '{self.name}': {count} Gaussians, {how}, body {body} of {len(self.joint_names)} joints, {moves}>"
        )

    @property
    def tiers(self) -> tuple[str, ...]:
        """The tiers that its bundle holds."""
        return tuple(stored_tiers(self.bundle))

    @functools.cached_property
    def renderer(self) -> Renderer:
        """What `render` draws with, the fastest that is there; may be replaced, as by `Renderer(avatar, "numpy")`."""
        return Renderer(self)

    def gaussians(
        self,
        pose: Any = None,
        trans: Any = None,
        expression: Any = None,
        *,
        camera: Camera | None = None,
        normals: bool = False,
        copy: bool = True,
        **parts: Any,
    ) -> Gaussians:
        """The Gaussians of a frame, in the world, float32; see `playing.Avatar.gaussians` for what else is said."""
        frame = self._frame(pose, trans, expression, parts)
        return super().gaussians(*frame, camera=camera, normals=normals, copy=copy)

    def render(
        self,
        pose: Any = None,
        camera: str | float | Camera = "front",
        *,
        trans: Any = None,
        expression: Any = None,
        size: int | None = None,
        width: int | None = None,
        height: int | None = None,
        background: str | Sequence[float] = "white",
        **parts: Any,
    ) -> np.ndarray:
        """(H, W, 3) uint8 sRGB, an image of a frame. (`Renderer.draw` gives floats, alpha and depth.)

        camera: `front`, `left`, `back`, `right` or degrees towards the person's left, which stands level and as far
        away as holds the person; or a camera of your own. size: pixels of both sides, or width and height; 512, or a
        camera's own, where none is given. background: a colour's name, `#rrggbb`, or (3,) in [0, 1].
        """
        motion = self._still(pose, trans, expression, parts)
        view = Shot(size=size, width=width, height=height, camera=camera, background=background)
        (shot,) = view.cameras(self, motion)
        gaussians = self.renderer.gaussians(*motion.at(0), camera=shot)
        return self.renderer.rasterize_uint8(gaussians, shot, view.color).copy()

    def play(
        self,
        motion: str | Path | Motion | Sequence[str | Path | Motion] | None = None,
        out: str | os.PathLike | None = None,
        **how: Any,
    ) -> PlayReport:
        """Play a motion into a file, as `gavatar-play` does: `avatar.play("wave", "wave.mp4", fps=30)`.

        motion: a built-in one by its name, None for a turn, a file, or a `Motion`; or several, one after another:
        `avatar.play(["walk", "wave"], blend=0.4)`. out: a video, a sheet of images, a
        folder of frames, Gaussians in `frames/%06d.ply`, ... by its name; None is a video beside the bundle. how: see
        `play.performance.perform`. Returns what was played, and what each stage of it took.
        """
        try:
            return perform(self, motion, out, **how)
        finally:
            self.follow(None)  # a pose has the same Gaussians, to the last bit, whatever was played before

    def convert(
        self,
        path: str | os.PathLike,
        *,
        motions: Iterable[str | Path | Motion] | None = None,
        tier: str | None = None,
        gaussians: int | Literal["auto"] | None = None,
        conversion: str | None = None,
        conversion_options: Mapping[str, Any] | None = None,
    ) -> None:
        """Turn the avatar with motions into another program's file, as `gavatar-convert` does: `avatar.convert(
        "anna.html", motions=["wave", "dance.npz"])` writes a web page that plays offline.

        motions: built-in ones by name, files or `Motion`s, None for some built-in ones; the first plays at the start.
        tier: how the look is taken, None for the best that the format can play. gaussians: at most so many, "auto" for
        as many as the footage's pixels were worth. conversion, conversion_options: the name of one where the suffix
        does not tell, and options of its own.
        """
        notes = convert(
            self.bundle, path, motions=motions, tier=tier, gaussians=gaussians, name=conversion,
            options=conversion_options,
        )  # fmt: skip
        for note in notes:
            warnings.warn(note, Note, stacklevel=2)

    def view(self, motions: Sequence[str | Path | Motion] = (), *, port: int = 0) -> Viewer:
        """Show the avatar in a page, as `gavatar-view` does: in a notebook the last line of a cell shows it there;
        elsewhere open its `address` in a browser on this machine.

        motions: beside the built-in ones; the first plays. port: to listen on, 0 for any that is free. What comes back
        serves the page until it is closed, deleted or the program ends.
        """
        from .view.server import Viewer
        from .view.viewed_avatar import ViewedAvatar

        return Viewer(ViewedAvatar(self.bundle, motions, tier=self.tier), port=port)

    def save(
        self,
        path: str | os.PathLike,
        pose: Any = None,
        *,
        trans: Any = None,
        expression: Any = None,
        output: str | None = None,
        output_options: Mapping[str, Any] | None = None,
        **parts: Any,
    ) -> None:
        """Write a frame to a file, by its suffix: `.ply` and its like hold the Gaussians, `.png` an image.

        output, output_options: the name of an output where the suffix does not tell, and options of its own.
        """
        motion = self._still(pose, trans, expression, parts)
        report = self.play(motion, path, output=output, output_options=output_options)
        for note in report.notes:
            warnings.warn(note, Note, stacklevel=2)

    def _still(self, pose: Any, trans: Any, expression: Any, parts: dict[str, Any]) -> Motion:
        """One frame as a motion that fits the body."""
        pose, trans, expression = self._frame(pose, trans, expression, parts)
        pose, trans = self._standing(pose, trans)
        face = self._face(expression)
        rows = None if face is None else face[1][None]
        return Motion(pose[None], trans[None], 1.0, name="pose", expression=rows)

    def _frame(
        self, pose: Any, trans: Any, expression: Any, parts: dict[str, Any]
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Pose (J, 3), translation and expression as `playing.Avatar.gaussians` takes them."""
        if "transl" in parts:
            if trans is not None:
                raise WrongValue("`trans` and `transl` are the same: give one of them")
            trans = parts.pop("transl")
        if pose is not None and parts:
            raise WrongValue(
                f"`pose` is whole, and {', '.join(f'`{name}`' for name in parts)} beside it: leave one of them out"
            )
        if parts:
            pose, lacking = pose_of_parts(parts, self.body)
        elif pose is None:
            pose, lacking = self._fitted(relaxed_pose())[0], ()
        else:
            pose, lacking = self._fitted(joint_rows(pose, self.joint_names))
        if lacking:
            warnings.warn(
                f"the body has no {', '.join(lacking)}: what the pose does there is left out", Note, stacklevel=3
            )
        given = [None if v is None else numbers(n, v) for n, v in (("trans", trans), ("expression", expression))]
        trans, expression = (None if array is None else array.reshape(-1) for array in given)
        return pose, trans, expression

    def _fitted(self, rows: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        """(J, 3) of rows of any skeleton, and what moves in them that the body lacks."""
        if len(rows) == len(self.joint_names):
            return rows, ()
        motion, lacking = self.fit(Motion(rows[None].astype(np.float32), np.zeros((1, 3), np.float32), 1.0))
        return motion.poses[0], lacking
