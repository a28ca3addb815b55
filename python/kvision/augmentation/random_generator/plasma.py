"""Generators of fractal maps."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import Shape
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import Numbers
from kvision.contrib.diamond_square import diamond_square


class PlasmaGenerator(PlainUniformGenerator):
    """Draws the roughness of a fractal map, other ranges, and the map: plasma (B, C, H, W), or (B, 1, H, W)."""

    per_pixel = True

    def __init__(self, op: str, roughness: Numbers, *others: Sequence[Any], one_channel: bool = False) -> None:
        super().__init__((roughness, "roughness", None, (0.0, 1.0)), *others, op=op)
        self._one_channel = one_channel

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        batch, channels = shape[0], 1 if self._one_channel else shape[1]
        maps = itertools.count()

        def random(size: Sequence[int], device: Any = None, dtype: Any = None) -> Tensor:
            return noise.uniform((batch, channels, *size[-2:]), next(maps)).reshape(tuple(size))

        if batch == 0:
            return {"plasma": columns.new_empty(batch, channels, *shape[-2:])}
        # In float64, and rounded, so that the map does not depend on the device.
        size = (batch, channels, int(shape[-2]), int(shape[-1]))
        roughness = columns[:, 0].detach().double()
        plasma = diamond_square(size, roughness, random_fn=random, device=columns.device, dtype=torch.float64)
        return {"plasma": plasma.to(columns.dtype)}
