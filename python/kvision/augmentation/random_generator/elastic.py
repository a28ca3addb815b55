"""Generators of maps that move pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision._constants import constant
from kvision.augmentation import ranges
from kvision.augmentation.draws import uniform
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers

__all__: list[str] = []  # Kornia has no public generators of these


class ElasticGenerator(RandomGeneratorBase):
    """Draws noise (B, 2, H, W) in [-1, 1]."""

    per_pixel = True
    has_planes_of_images = False

    def draws(self, shape: Shape) -> Sequence[Any]:
        return []

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {}

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        return {"noise": noise.symmetric((shape[0], 2, *shape[-2:]))}


class ThinPlateSplineGenerator(RandomGeneratorBase):
    """Draws where the corners and the center of an image go: src and dst (B, 5, 2), in coordinates from -1 to 1."""

    points = ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 0.0))

    def __init__(self, scale: float) -> None:
        super().__init__()
        self.scale = ranges.parse("RandomThinPlateSpline", "scale", (scale, scale), bounds=(0.0, float("inf"))).low

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [uniform(x - self.scale, x + self.scale, x) for point in self.points for x in point]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        source = constant(self.points, columns)
        return {"src": source.expand(columns.shape[0], 5, 2), "dst": columns.reshape(-1, 5, 2)}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return params["dst"].reshape(-1, 10)


class FisheyeGenerator(RandomGeneratorBase):
    """Draws center_x, center_y and gamma, (B, 1) each."""

    fields = (("center_x", 1), ("center_y", 1), ("gamma", 1))

    def __init__(self, center_x: Numbers, center_y: Numbers, gamma: Numbers) -> None:
        super().__init__()
        op = "RandomFisheye"
        center_x, center_y, gamma = ranges.keep_parameters(self, center_x=center_x, center_y=center_y, gamma=gamma)
        self._ranges = [
            ranges.parse(op, "center_x", center_x),
            ranges.parse(op, "center_y", center_y),
            ranges.parse(op, "gamma", gamma),
        ]

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [r.uniform(identity=identity) for r, identity in zip(self._ranges, (0.0, 0.0, 1.0))]
