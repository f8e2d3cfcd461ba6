"""The ways to play an avatar: tier, level of detail, temporal reuse and the switches of the player's rasterizer."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import Bundle
from gavatar_runtime.decoding.detail import WORTH
from gavatar_runtime.render.choice import best_rasterizer, player_rasterizers
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.tiers import player_tiers, stored_tiers

LEVELS = (2500, 10000, 40000, 90000)  # Gaussians
FINE = 40000  # a level from which on networks may be told to pick its Gaussians


@dataclasses.dataclass(frozen=True)
class Choice:
    """One way to play. tier: '' for that which every bundle holds. gaussians: at most so many, None for all. reuse:
    decode every so many frames. seen_only: decode what the camera can see. switches: options of the player's best
    rasterizer, those that are not at their default."""

    tier: str = ""
    gaussians: int | None = None
    reuse: int = 1
    seen_only: bool = False
    switches: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def label(self) -> str:
        """For people, of the parts that are not at their default."""
        parts = [self.tier]
        if self.gaussians:
            parts.append(f"{self.gaussians} Gaussians")
        if self.reuse > 1:
            parts.append(f"reuse {self.reuse}")
        if self.seen_only:
            parts.append("seen only")
        parts += [name if value is True else f"{name} {value:g}" for name, value in self.switches.items()]
        return ", ".join(parts)

    def as_json(self) -> dict[str, Any]:
        """Every part by name, switches among them."""
        values = {"tier": self.tier, "label": self.label, "reuse": self.reuse}
        return {**values, "seen_only": self.seen_only, **_switches_off(), **self.switches}

    def open(self, bundle: Bundle, threads: int | None = None) -> Avatar:
        """The bundle's avatar, played this way."""
        return Avatar(
            bundle,
            tier=self.tier,
            gaussians=self.gaussians,
            reuse=self.reuse,
            seen_only=self.seen_only,
            threads=threads,
        )

    def renderer(self, bundle: Bundle, threads: int | None = None) -> Renderer:
        """The bundle's avatar and the player's best rasterizer, played this way."""
        return Renderer(self.open(bundle, threads), best_rasterizer(), options=self.switches, threads=threads)


def measured_switches() -> tuple[Mapping[str, Any], ...]:
    """Options of the player's best rasterizer that are worth measuring, each a choice of its own."""
    return player_rasterizers().traits(best_rasterizer()).measured


def _switches_off() -> dict[str, Any]:
    """The options of `measured_switches` at their defaults."""
    names = {name for options in measured_switches() for name in options}
    fields = dataclasses.fields(player_rasterizers()[best_rasterizer()].config)
    return {field.name: field.default for field in fields if field.name in names}


def default_choices(bundle: Bundle, enough: int | None = None) -> list[Choice]:
    """The ladder of a bundle: every stored tier, and on them the cheaper levels of detail, temporal reuse, decoding
    what is seen and the rasterizer's switches, where they can pay: nothing makes the networks of the default tier fast,
    and nothing is reused by one that runs none. enough: what `detail.count_for_size` says of this
    picture."""
    stored, default = stored_tiers(bundle), player_tiers().default
    every = bundle.manifest.gaussians
    levels = sorted({count for count in (*LEVELS, enough or every) if count < WORTH * every})
    choices = [Choice(tier) for tier in stored]
    kinds = {tier: player_tiers()[tier].kind for tier in stored}
    networks = [t for t in stored if kinds[t].networks] if bundle.manifest.dynamic else []
    cheap = [t for t in stored if t not in networks] or stored
    choices += [Choice(tier, gaussians=count) for tier in cheap for count in levels]
    choices += [Choice(tier, switches=switches) for tier in cheap for switches in measured_switches()]
    choices += [Choice(tier, reuse=k) for tier in networks if tier != default for k in (2, 4)]
    seen = [Choice(tier, seen_only=True) for tier in networks]
    choices += [choice for choice in seen if choice.open(bundle).seen_only]
    finer = [count for count in levels if count >= FINE]
    choices += [Choice(t, gaussians=n) for t in networks if kinds[t].picks and t != default for n in finer]
    return choices
