"""Images times a factor plus a shift, clamped to [0, 1] on request: a step of color programs."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision.color.program import step


def _scale_shift_reference(x: Tensor, factor: float | Tensor, shift: float | Tensor, clip: float | Tensor) -> Tensor:
    y = x * factor + shift
    return clamp(y, 0, 1) if clip else y


def _scale_shift_rgb_reference(x: Tensor, *numbers: float | Tensor) -> Tensor:
    *p, clip = numbers
    return torch.cat([_scale_shift_reference(c, p[i], p[3 + i], clip) for i, c in enumerate(x.split(1, 1))], 1)


scale_shift = step("scale_shift", _scale_shift_reference)
scale_shift_rgb = step("scale_shift_rgb", _scale_shift_rgb_reference)
