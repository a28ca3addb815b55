"""Images in snow."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._limits import LUMA
from kvision._ops import match_layout, register
from kvision.geometry.transform.lists.kept_sizes import register_filter


def _reference(images: Tensor, flakes: Tensor, weight: float) -> Tensor:
    """Images x as `max(x, w x + (1 - w) (1.5 gray + 0.5))`, plus flakes (B, 1, H, W) and the same turned by half a circle.

    Gray is the luma of RGB, else the mean of channels. Flakes are rounded to steps of 1 / 255. Results are clamped to [0, 1].
    """
    is_bytes = images.dtype == torch.uint8
    x = images.float() / 255 if is_bytes else images.to(compute_dtype(images))
    gray = x.mean(1, keepdim=True)
    if x.shape[1] == 3:
        red, green, blue = (weight * channel for weight, channel in zip(LUMA, x.split(1, 1)))
        gray = red + green + blue
    bright = torch.maximum(x, torch.lerp(gray * 1.5 + 0.5, x, weight))
    snow = (flakes * 255).round() / 255
    y = clamp(clamp(bright, 0, 1) + snow + snow.flip(2, 3), 0, 1)
    return match_layout((255 * y).round().to(torch.uint8) if is_bytes else y.to(images.dtype), images)


add_snow = register("add_snow", _reference, bytes=True, casts_outputs=True)
register_filter("add_snow_list", add_snow, lambda b, flakes, weight: (flakes[b][None], weight))
