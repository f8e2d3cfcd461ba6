"""What is left to `auto`, decided by what is measured on the footage, and told in words."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import torch

from .plan import Plan
from .record import Record
from .remedies.brightness import brightness
from .remedies.exposure import Exposure
from .remedies.mask_border import MaskBorder, mask_border
from .remedies.pose_quality import UNSTEADY, unsteadiness
from .remedies.see_through import FLOORS, least_floor, see_through
from .remedies.shape import new_shape
from .remedies.shape_trial import shape_trial
from .scene import Scene
from .verdicts import Choice, FillingVerdict

SHAPE_GAIN = 0.35  # dB on left-out views; right shapes gain 0.04 to 0.22, one that is off by a standard deviation 0.6
WAITING = 0.05  # of stage 1, before poses that are good begin to move: until then the avatar is a blur


class Chooser:
    """Settles settings of a scene and notes each choice in the record, once: a continued run finds it there."""

    def __init__(self, scene: Scene, record: Record):
        self.scene, self.record = scene, record

    @property
    def choices(self) -> Mapping[str, Choice]:
        """Those made so far, by setting."""
        return self.record.verdicts.choices or {}

    def masks(self) -> None:
        """`mask_matte` of the footage, before any image of it is used."""
        footage = self.scene.footage
        if "mask_matte" not in self.choices:
            self.record.verdicts.chose("mask_matte", _of_masks(mask_border(footage.capture, footage.views)))
        footage.mask_matte = float(self.choices["mask_matte"].value)

    def window(self, plan: Plan, scale: float) -> Plan:
        """The plan with `motion.start` settled, before the first step. scale: of the images."""
        if not plan.waits:
            return plan
        if "motion.start" not in self.choices:
            self.record.verdicts.chose("motion.start", _of_poses(unsteadiness(self.scene, scale)))
        start = min(float(self.choices["motion.start"].value), plan.window[1])
        return dataclasses.replace(plan, window=(start, plan.window[1]))

    def exposure(self, scale: float) -> bool:
        """Whether `exposure` is learnt: then the scene has one from here on, which begins with what was measured."""
        scene, measured = self.scene, brightness(self.scene, scale)
        if measured is None:
            choice = Choice(False, None, "too few views show enough of the person to tell whether brightness drifts")
        else:
            drifts, share = measured.drifts, f"{max(1.0, 100 * measured.common):.0f} %"
            told = f"brightness drifts by {share}: corrected" if drifts else f"brightness is steady within {share}"
            choice = Choice(drifts, measured.common, told)
            if measured.log_gain is not None:
                scene.exposure = Exposure(len(scene.views)).to(scene.device)
                with torch.no_grad():
                    scene.exposure.log_gain.copy_(torch.from_numpy(measured.log_gain))
        self.record.verdicts.chose("exposure", choice)
        return bool(choice.value)

    def shape(self, scale: float) -> bool:
        """Whether `motion.betas` are learnt: then the scene has a correction of the shape from here on."""
        scene, trial = self.scene, shape_trial(self.scene, scale)
        if trial is None:
            choice = Choice(False, None, "nothing tells whether the shape fits")
        else:
            worth, gain = trial.gain_db >= SHAPE_GAIN, f"{trial.gain_db:+.2f} dB"
            told = f"another shape fits better ({gain}): learnt" if worth else f"the shape fits (another: {gain})"
            choice = Choice(worth, trial.gain_db, told)
            if worth:
                scene.shape = new_shape(scene.built).to(scene.device)
        self.record.verdicts.chose("motion.betas", choice)
        return bool(choice.value)

    def floor(self, image: float) -> None:
        """`decoder.scale_floor` where it is left to the footage, by what shows through the avatar as it is. image:
        scale of the images trained on."""
        decoder = self.scene.avatar.decoder
        if not self.scene.avatar.decoder_traits.finds_floor or "decoder.scale_floor" in self.choices:
            return
        shares = see_through(self.scene, image, FLOORS)
        value = least_floor(shares)
        decoder.floor.fill_(value)
        through = f"{100 * shares[0]:.2f} % of the body would be see-through from elsewhere"
        told = (
            f"{through}: points no smaller than {value} of their spacing"
            if value > FLOORS[0]
            else f"{through}: left as it is"
        )
        self.record.verdicts.chose("decoder.scale_floor", Choice(value, round(shares[0], 5), told))

    def mended(self, wrong: Mapping[str, list[int]]) -> None:
        """Note which frames were mended, by what was wrong with them."""
        verdicts = self.record.verdicts
        verdicts.frames_mended = sorted(frame for frames in wrong.values() for frame in frames)
        said = {"exchanged": "with left and right exchanged", "drawn along": "drawn off from a better estimate"}
        parts = [f"{_frames(len(frames))} {said.get(name, name)}" for name, frames in wrong.items() if frames]
        told = f"{', '.join(parts)}: mended" if parts else "no frame's pose is plainly wrong"
        count = len(verdicts.frames_mended)
        verdicts.chose("motion.mend", Choice(bool(count), float(count), told))

    def filled(self, unseen: FillingVerdict) -> None:
        """Note how much of the body was hardly seen, and took on what is around it."""
        share = unseen.points / max(unseen.of, 1)
        told = f"{100 * share:.0f} % of the body was never seen squarely" + (": filled" if unseen.filled else "")
        self.record.verdicts.unseen = unseen
        self.record.verdicts.chose("unseen", Choice(bool(unseen.filled), round(share, 4), told))

    @property
    def paragraph(self) -> str:
        """All choices in words, empty where none was made."""
        return "; ".join(choice.sentence for choice in self.choices.values())


def _of_masks(border: MaskBorder | None) -> Choice:
    if border is None:
        return Choice(0.0, None, "colours do not tell whether masks fit")
    off, value = border.pixels, border.mending
    if not value:
        return Choice(0.0, off, f"masks fit within {max(0.1, abs(off)):.1f} px")
    return Choice(value, off, f"masks are too {'wide' if off > 0 else 'narrow'} by {abs(off):.1f} px: mended")


def _of_poses(unsteady: float | None) -> Choice:
    if unsteady is None:
        return Choice(0.0, None, "too few views show enough of the person to tell how good the poses are")
    good = unsteady < UNSTEADY
    told = f"silhouettes fit evenly, within {100 * unsteady:.1f} %: poses wait for the avatar"
    uneven = f"silhouettes fit unevenly, within {100 * unsteady:.1f} %: poses move at once"
    return Choice(WAITING if good else 0.0, round(unsteady, 4), told if good else uneven)


def _frames(count: int) -> str:
    return f"{count} frame" if count == 1 else f"{count} frames"
