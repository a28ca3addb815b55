"""Contrast of every channel around its mean."""

from __future__ import annotations

from torch import Tensor

from kvision._clamp import clamp
from kvision._ops import register, vjp


def _reference(x: Tensor, factor: float) -> Tensor:
    """Scale the distances of pixels from the mean of their channel, and clamp them to [0, 1]."""
    mean = x.mean((2, 3), keepdim=True)
    return clamp((x - mean) * factor + mean, 0, 1)


backward = register("channel_contrast_backward", vjp(_reference), layout_of=1)
channel_contrast = register(
    "channel_contrast",
    _reference,
    gradients="input: channel_contrast_backward",
    bytes=True,
    levels=255,
    clamps=True,
)
