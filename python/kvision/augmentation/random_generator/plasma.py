"""Generators of fractal maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import Shape
from kvision.augmentation.random_generator.fractal_noise import fractal_noise
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import Numbers


class PlasmaGenerator(PlainUniformGenerator):
    """Draws the roughness of a fractal map, other ranges, and the map: plasma (B, C, H, W), or (B, 1, H, W)."""

    per_pixel = True

    def __init__(self, op: str, roughness: Numbers, *others: Sequence[Any], one_channel: bool = False) -> None:
        super().__init__((roughness, "roughness", None, (0.0, 1.0)), *others, op=op)
        self._one_channel = one_channel

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        """The map of a batch, or of a list whose shape has height and width of each image."""
        return {"plasma": self.plasma(columns, shape[1], shape[2:], noise)}

    def plasma(self, columns: Tensor, channels: int, sides: Sequence[int], noise: PixelNoise) -> Tensor:
        """The maps of images of so many channels, of one height and width, or of those of each; as large as the largest."""
        return fractal_noise(columns[:, 0], noise, (1 if self._one_channel else channels, *sides))
