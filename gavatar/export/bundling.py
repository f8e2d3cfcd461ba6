"""From a trained run to a bundle that plays without torch: each step takes a value and gives the next one.

sample -> without limbs never filmed -> (drop what is unseen) -> pack -> add tiers -> verify -> measure -> write.
No step changes the run it is given.
"""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gavatar_runtime.bundle import Manifest, write_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.tiers import members_read
from gavatar_runtime.values.surface import Surface

from ..measure.tier_costs import CAPTURE, MIXED, describe_tiers, on_front
from ..registry import DECODERS, ENCODERS, TIERS, split_node
from ..training.run import Run
from .half_person import never_filmed
from .packing import manifest_of, members_of, metadata_of
from .seen import difference, seen
from .tier_source import AvatarSource
from .verification import verify

MEASURED_POSES = 8  # of the capture, and as many mixed ones, that tiers are compared on


@dataclasses.dataclass(frozen=True)
class Sampled:
    """A run on the points that its bundle will hold. run: whose avatar stands on them. unseen: what was left out, for
    the manifest, None where nothing was to be."""

    run: Run
    unseen: dict[str, float] | None = None


@dataclasses.dataclass(frozen=True)
class Bundled:
    """A bundle before it is written. members: contents by file name."""

    manifest: Manifest
    members: dict[str, bytes]

    def write(self, path: Path) -> Manifest:
        """Write it to `path` and return its manifest with the members' sums."""
        return write_bundle(path, self.manifest, self.members)


def export(
    run: Run,
    path: str | Path,
    poses: int = 8,
    *,
    gaussians: int | None = None,
    tiers: Sequence[str] = (),
    drop_unseen: bool = False,
    progress: bool = False,
) -> Manifest:
    """Write the bundle of a run to `path` and return its manifest.

    gaussians: how many, where its points are placed; None for those it was trained with (scales in units of the point
    spacing keep the surface closed). tiers: cheaper ways to decode it that are stored too, each with its measured
    error and cost. drop_unseen: leave out Gaussians that no training view sees nor any of their neighbours
    (`unseen.seen`); the manifest's `training` says under `unseen` how many, and what that changed.

    The bundle is first written beside its place, played back and compared with the PyTorch model; it is put in place
    only if positions agree within 0.1 mm and colours within 1/255, else UserError and nothing is left.
    """
    names = with_needs(tiers, run)
    return _exported(
        run, Path(path), poses, names, gaussians=gaussians, drop_unseen=drop_unseen, progress=progress
    ).write(Path(path))


def export_front(
    run: Run,
    path: str | Path,
    poses: int = 8,
    *,
    gaussians: int | None = None,
    drop_unseen: bool = False,
    progress: bool = False,
) -> Manifest:
    """As `export`, with those tiers that no other stored tier beats in both speed and error, as measured here. A static
    avatar has none."""
    names = [] if run.avatar.encoder is None else with_needs(TIERS.names(), run)
    bundled = _exported(run, Path(path), poses, names, gaussians=gaussians, drop_unseen=drop_unseen, progress=progress)
    return (front(bundled) if names else bundled).write(Path(path))


def _exported(
    run: Run, path: Path, poses: int, tiers: list[str], *, gaussians: int | None, drop_unseen: bool, progress: bool
) -> Bundled:
    """Everything but the writing."""
    check_exportable(run)
    sampled = without_limbs(sample(run, gaussians))
    if drop_unseen:
        sampled = drop(sampled, progress)
    source = AvatarSource(sampled.run, metadata_of(manifest_of(sampled.run)), progress)
    bundled = add_tiers(pack(sampled), tiers, source)
    with _draft(path) as draft:
        bundled.write(draft)
        check = verify(draft, sampled.run, poses)
        check.require(path)
        bundled = _with(bundled, export_check=check.as_json())
        return measure(bundled, draft, source) if tiers else bundled


def check_exportable(run: Run) -> None:
    """UserError where encoder or decoder of the run says that it is not exported."""
    parts = [(DECODERS, run.config.decoder)]
    if run.avatar.encoder is not None:
        parts.append((ENCODERS, run.config.encoder))
    for registry, node in parts:
        reason = registry.traits(*split_node(node)).not_exported
        if reason:
            raise UserError(f"{run.directory}: {reason}")


def with_needs(names: Sequence[str], run: Run) -> list[str]:
    """The tiers asked for and those they read, each once, the default one first; UserError for an unknown one, or of a
    static avatar, whose look is already one for all poses."""
    wanted: list[str] = []
    for name in dict.fromkeys(names):
        for needed in (*TIERS[name].kind.needs, name):
            if needed not in wanted and needed != TIERS.default:
                wanted.append(needed)
    if wanted and run.avatar.encoder is None:
        raise UserError(
            f"{run.directory}: a static avatar needs no tiers (asked: {', '.join(wanted)}): it is decoded once; leave "
            "`tiers` out"
        )
    return [TIERS.default, *wanted] if wanted else []


def sample(run: Run, gaussians: int | None = None) -> Sampled:
    """The run on so many points, by default on those it was trained with."""
    return Sampled(run if gaussians is None else placed(run, run.built.surface(gaussians)))


def without_limbs(sampled: Sampled) -> Sampled:
    """Without the limbs that its capture never shows. Raises UserError where nothing is left."""
    hidden = never_filmed(sampled.run)
    if not hidden.any():
        return sampled
    if hidden.all():
        raise UserError(f"{sampled.run.directory}: no part of the person was seen by the training views")
    return dataclasses.replace(
        sampled, run=placed(sampled.run, sampled.run.avatar.surface.take(np.flatnonzero(~hidden)))
    )


def drop(sampled: Sampled, progress: bool = False) -> Sampled:
    """Without the points that no training view sees nor any of their neighbours."""
    run = sampled.run
    kept = seen(run, progress=progress)
    unseen = {"dropped": int((~kept).sum()), **difference(run, kept)}
    return Sampled(placed(run, run.avatar.surface.take(np.flatnonzero(kept))), unseen)


def placed(run: Run, surface: Surface) -> Run:
    """The run, its avatar on the points of `surface`; the run given keeps its own."""
    return dataclasses.replace(run, built=dataclasses.replace(run.built, avatar=run.avatar.sampled(surface)))


def pack(sampled: Sampled) -> Bundled:
    """The bundle of one tier, the networks as trained."""
    manifest = manifest_of(sampled.run)
    if sampled.unseen is not None:
        manifest = dataclasses.replace(manifest, training=manifest.training | {"unseen": sampled.unseen})
    return Bundled(manifest, members_of(sampled.run, manifest))


def add_tiers(bundled: Bundled, names: Sequence[str], source: AvatarSource) -> Bundled:
    """With the members of further tiers."""
    members = dict(bundled.members)
    for name in names:
        members |= TIERS.build(name).build(source)
    manifest = dataclasses.replace(bundled.manifest, tiers=[{"name": name} for name in names])
    return Bundled(manifest, members)


def measure(bundled: Bundled, draft: Path, source: AvatarSource) -> Bundled:
    """With the error and the cost of each tier, measured by playing the draft."""
    filmed = source.train_poses[evenly_spaced(len(source.train_poses), MEASURED_POSES)]
    poses = {CAPTURE: filmed, MIXED: source.random_poses(MEASURED_POSES, seed=1)}
    return _with(bundled, tiers=describe_tiers(draft, poses))


def front(bundled: Bundled) -> Bundled:
    """With only those of the measured tiers that pay, and the members that they read."""
    kept = on_front(bundled.manifest.tiers)
    stored, wanted = ([tier["name"] for tier in tiers] for tiers in (bundled.manifest.tiers, kept))
    read = members_read(bundled.members, stored, wanted)
    members = {name: data for name, data in bundled.members.items() if name in read}
    return _with(dataclasses.replace(bundled, members=members), tiers=kept)


def _with(bundled: Bundled, **fields: Any) -> Bundled:
    return dataclasses.replace(bundled, manifest=dataclasses.replace(bundled.manifest, **fields))


@contextlib.contextmanager
def _draft(path: Path) -> Iterator[Path]:
    """Where to write a bundle that is not yet to be in its place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".gavatar-export-", dir=path.parent) as scratch:
        yield Path(scratch) / "draft.gavatar"
