"""Pixel values: integer levels to [0, 1] and back. Used to read, write and show images."""

from __future__ import annotations

import torch
from torch import Tensor


def to_unit(x: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """`x` as floating point: integers divided in `dtype` by the largest number of their type, floats as they are."""
    if x.is_floating_point():
        return x
    if x.dtype == torch.bool:
        return x.to(dtype)
    return x.to(dtype) / torch.iinfo(x.dtype).max


def to_dtype(x: Tensor, dtype: torch.dtype | None) -> Tensor:
    """`x` in a floating-point type or uint8, scaled from the range of its type to that of the other; None: as it is."""
    if dtype is None or x.dtype == dtype:
        return x
    if dtype == torch.uint8:
        return to_uint8(x)
    # Half types cannot hold the largest integers.
    return to_unit(x, torch.float64 if dtype == torch.float64 else torch.float32).to(dtype)


def to_uint8(x: Tensor) -> Tensor:
    """`x` as 8-bit levels, rounded to the nearest: floats from [0, 1], clamped, with NaN black; integers rescaled."""
    if x.dtype == torch.uint8:
        return x
    x = to_unit(x)
    if x.dtype in (torch.float16, torch.bfloat16):
        x = x.float()  # a half type cannot hold 255 * x exactly enough to round it
    levels: Tensor = x.nan_to_num().clamp(0, 1) * 255
    return levels.round().to(torch.uint8)
