"""No pose encoder: the static avatar of stage 1."""

from __future__ import annotations

from gavatar.registry import ENCODERS, EncoderTraits, NoOptions


@ENCODERS.register(
    "none",
    summary="static avatar: appearance does not depend on the pose (stage 1 only)",
    traits=EncoderTraits(static=True, inputs={}),
)
def no_encoder(config: NoOptions, *, channels: int, map_size: int) -> None:
    """There is nothing to build; the avatar skips stage 2."""
    return None
