"""In what precision the decoder is trained: most of a step's arithmetic is its matrix products."""

from __future__ import annotations

from typing import Any

import torch

from gavatar_runtime.errors import UserError

from ..registry import DECODERS, split_node


def mixed(precision: str, decoder: dict[str, Any], device: torch.device) -> bool:
    """Whether a decoder, the node of one, is to be trained in bfloat16: asked for, or `auto` where the processor
    multiplies it natively and the decoder says that it keeps its outputs in float32 (`DecoderTraits.mixed_precision`).

    Raises UserError when it is asked for of a decoder that does not."""
    able = DECODERS.traits(*split_node(decoder)).mixed_precision
    if precision == "bfloat16" and not able:
        raise UserError(f"precision=bfloat16: decoder '{decoder['name']}' trains in float32 only")
    return precision == "bfloat16" or (precision == "auto" and able and multiplies_bfloat16(device))


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether matrix products in bfloat16 are native there; where they are emulated they are the slower ones."""
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    if device.type != "cpu" or not torch.backends.mkldnn.is_available():
        return False
    # newer than the oldest torch that is supported
    able: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(able.get("avx512_bf16") or able.get("amx_bf16"))
