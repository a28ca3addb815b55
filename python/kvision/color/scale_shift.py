"""Images times a factor plus a shift, clamped to [0, 1] on request: a step of color programs."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision._leading import apply_on_batch
from kvision.color.program import step


def _scale_shift_reference(x: Tensor, factor: float | Tensor, shift: float | Tensor, clip: float | Tensor) -> Tensor:
    y = x * factor + shift
    return clamp(y, 0, 1) if clip else y


def _scale_shift_rgb_reference(x: Tensor, *numbers: float | Tensor) -> Tensor:
    *p, clip = numbers
    return torch.cat([_scale_shift_reference(c, p[i], p[3 + i], clip) for i, c in enumerate(x.split(1, 1))], 1)


scale_shift = step("scale_shift", _scale_shift_reference)
scale_shift_rgb = step("scale_shift_rgb", _scale_shift_rgb_reference)


def floats_of_bytes(x: Tensor) -> Tensor:
    """Images of bytes (*, C, H, W) in [0, 1], float32, by one launch."""
    y: Tensor = apply_on_batch(partial(scale_shift, dtype=torch.float32), x, 1.0, 0.0, False)
    return y


def bytes_of_floats(y: Tensor) -> Tensor:
    """Images (*, C, H, W) in [0, 1], which they are clamped to, in bytes, without a gradient."""
    x: Tensor = apply_on_batch(partial(scale_shift, dtype=torch.uint8), y.detach(), 1.0, 0.0, True)
    return x
