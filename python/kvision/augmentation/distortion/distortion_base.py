"""What distortions by maps share: how images are read, and coordinates of pixels."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.elastic import MapAugmentation
from kvision.augmentation.engine import Params
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding


class DistortionBase(MapAugmentation, keeps_contract=True):
    """Base of maps whose images are read with an interpolation and a padding of the user."""

    def __init__(self, resample: AnyResample, padding_mode: AnySamplePadding, **options: Any) -> None:
        super().__init__(**options)
        self.flags = {
            "resample": Resample.get(resample),
            "padding_mode": SamplePadding.get(padding_mode),
            "align_corners": True,
        }


def per_map(params: Params, like: Tensor, *names: str) -> list[Tensor]:
    """Parameters (B,) in the type and on the device of maps, (B, 1, 1)."""
    return [params[name].to(like)[:, None, None] for name in names]


def from_center(height: int, width: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """x (1, W) and y (H, 1) of pixels from the center of the image."""
    y, x = (torch.arange(n, dtype=like.dtype, device=like.device) - (n - 1) / 2 for n in (height, width))
    return x[None], y[:, None]
