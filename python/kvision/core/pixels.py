"""Pixel values: integer levels to [0, 1] and back. Used to read, write and show images."""

from __future__ import annotations

import torch
from torch import Tensor


def to_unit(x: Tensor) -> Tensor:
    """`x` as floating point: integers divided by the largest number of their type, floats as they are."""
    if x.is_floating_point():
        return x
    if x.dtype == torch.bool:
        return x.float()
    return x.float() / torch.iinfo(x.dtype).max


def to_uint8(x: Tensor) -> Tensor:
    """`x` as 8-bit levels, rounded to the nearest: floats from [0, 1], clamped, with NaN black; integers rescaled."""
    if x.dtype == torch.uint8:
        return x
    x = to_unit(x)
    if x.dtype in (torch.float16, torch.bfloat16):
        x = x.float()  # a half type cannot hold 255 * x exactly enough to round it
    levels: Tensor = x.nan_to_num().clamp(0, 1) * 255
    return levels.round().to(torch.uint8)
