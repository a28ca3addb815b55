"""Generators of weather."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.draws import integer
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers

__all__ = ["RainGenerator"]


class RainGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomRain`.

    Args:
        number_of_drops: pair of lowest and highest number, ints of at least 0.
        drop_height: pair of lowest and highest height in pixels, ints of at least 1.
        drop_width: pair of lowest and highest width in pixels, ints; negative ones lean to the left.

    Returns:
        number_of_drops_factor, drop_height_factor and drop_width_factor (B,), int64; coordinates_factor (B, N, 2) in [0, 1]
        for the highest number N: positions down and to the right, as fractions of where drops may begin.

    Raises:
        TypeError, ValueError: a range is not an ascending pair of ints, or out of its bounds.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.RainGenerator((3, 3), (5, 5), (-2, -2))
        >>> draw((2, 3, 8, 8))["coordinates_factor"].shape
        torch.Size([2, 3, 2])
    """

    per_pixel = True

    def __init__(self, number_of_drops: Numbers, drop_height: Numbers, drop_width: Numbers) -> None:
        super().__init__()
        self.number_of_drops = ranges.parse_integers("RandomRain", "number_of_drops", number_of_drops, 0)
        self.drop_height = ranges.parse_integers("RandomRain", "drop_height", drop_height, 1)
        self.drop_width = ranges.parse_integers("RandomRain", "drop_width", drop_width)

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [
            integer(*self.number_of_drops),
            integer(*self.drop_height, identity=self.drop_height[0]),
            integer(*self.drop_width),
        ]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        names = ("number_of_drops_factor", "drop_height_factor", "drop_width_factor")
        return dict(zip(names, columns.long().unbind(1)))

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        positions = noise.uniform((shape[0], 1, max(self.number_of_drops[1], 1), 2))
        return {"coordinates_factor": positions[:, 0]}
