"""Pixel values: integer levels to [0, 1] and back, and colour to grey. Used where files and screens meet tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision.core.exceptions import TypeCheckError


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


def luma(rgb: Tensor) -> Tensor:
    """The grey picture (1, H, W) of a colour one (3, H, W): 0.299 R + 0.587 G + 0.114 B (ITU-R BT.601).

    8-bit pictures take OpenCV's fixed-point weights, so that the levels are those of `cv2.cvtColor`.
    """
    if rgb.dtype == torch.uint8:
        r, g, b = rgb.int()
        grey: Tensor = (9798 * r + 19235 * g + 3735 * b + (1 << 14)) >> 15
        return grey.to(torch.uint8)[None]
    if not rgb.is_floating_point():
        raise TypeCheckError(
            f"luma: expected rgb to be uint8 or floating point, got {rgb.dtype}", actual_type=rgb.dtype
        )
    r, g, b = rgb
    grey = 0.299 * r + 0.587 * g + 0.114 * b
    return grey[None]
