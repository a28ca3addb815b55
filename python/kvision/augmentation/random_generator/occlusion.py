"""Generators of what is dropped from images."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation import ranges
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import Shape
from kvision.augmentation.random_generator.mapped import MappedGenerator, NoiseMap
from kvision.core.exceptions import ValueCheckError

__all__: list[str] = []  # Kornia has none of these


def fill_maps(fill: float | list[float] | str) -> dict[str, NoiseMap]:
    """The map `fill` of uniform noise, if pixels are filled with it."""
    return {"fill": NoiseMap()} if fill == "random" else {}


class Lengths(NamedTuple):
    """The lowest and the highest length of holes along an axis: pixels, or fractions of the image."""

    low: float
    high: float
    are_pixels: bool

    @classmethod
    def parse(cls, op: str, name: str, value: Any) -> Lengths:
        """A pair of ints is pixels; one of other numbers, within 0 and 1, is fractions."""
        value = _check.scalars(op, name, value)
        if isinstance(value, (tuple, list)) and all(_check.is_int(n) for n in value):
            return cls(*ranges.parse_integers(op, name, value, 0), True)
        fractions = ranges.parse(op, name, value, bounds=(0.0, 1.0))
        return cls(fractions.low, fractions.high, False)

    def of(self, u: Tensor, extent: int) -> Tensor:
        """Whole pixels of uniform numbers in [0, 1), at least one where the lowest length is above 0."""
        if self.are_pixels:
            length = (self.low + u * (self.high - self.low + 1)).floor()
        else:
            length = ((self.low + u * (self.high - self.low)) * extent).round()
        return length.clamp(min(1, extent) if self.low > 0 else 0, extent)


class Holes(NamedTuple):
    """A kind of holes: the range of their number and those of their sizes, None for the whole image."""

    number: tuple[int, int]
    heights: Lengths | None
    widths: Lengths | None


class HolesGenerator(MappedGenerator):
    """Draws rectangles: holes (B, N, 4), x, y, width and height in pixels, of size 0 behind the drawn number of each kind."""

    def __init__(self, op: str, kinds: dict[str, Holes], fill: float | list[float] | str) -> None:
        super().__init__(integers={name: kind.number for name, kind in kinds.items()}, maps=fill_maps(fill), op=op)
        self.kinds = list(kinds.values())
        self.per_pixel = True

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        sizes = [kind.number[1] for kind in self.kinds]
        drawn = noise.uniform((shape[0], 1, max(sum(sizes), 1), 4), len(self.maps))[:, 0, : sum(sizes)]
        holes = []
        for kind, number, u in zip(self.kinds, columns.unbind(1), drawn.split(sizes, 1)):
            height, width = shape[-2:]
            exists = torch.arange(u.shape[1], device=u.device) < number[:, None]
            tall = exists * (height if kind.heights is None else kind.heights.of(u[..., 2], height))
            wide = exists * (width if kind.widths is None else kind.widths.of(u[..., 3], width))
            x, y = ((u[..., 0] * (width - wide + 1)).floor(), (u[..., 1] * (height - tall + 1)).floor())
            holes.append(torch.stack([x * exists, y * exists, wide, tall], -1))
        return {**super().pixel_params(columns, shape, noise), "holes": torch.cat(holes, 1).float()}


class GridDropoutGenerator(MappedGenerator):
    """Draws the side of the units of a grid, if it has a range, and the offset of the hole in each unit, in [0, 1)."""

    def __init__(
        self,
        unit_size_range: tuple[int, int] | None,
        holes_number_xy: tuple[int, int] | None,
        random_offset: bool,
        fill: float | list[float] | str,
    ) -> None:
        op = "GridDropout"
        integers = {} if unit_size_range is None else {"unit_size": unit_size_range}
        super().__init__(integers=integers, maps=fill_maps(fill), op=op)
        self.unit_size_range, self.holes_number_xy = unit_size_range, holes_number_xy
        self.random_offset = random_offset
        self.per_pixel = self.per_pixel or random_offset

    def counts(self, shape: Shape) -> tuple[int, int]:
        """The most units that an image of a shape has, down and across."""
        height, width = shape[-2:]
        if self.unit_size_range is not None:
            low, high = self.unit_size_range
            if high > min(height, width):
                raise ValueCheckError(
                    f"GridDropout: expected unit_size_range of at most the shorter side, {min(height, width)}, got {high}"
                )
            return height // low, width // low
        if self.holes_number_xy is not None:
            across, down = self.holes_number_xy
            return min(down, height), min(across, width)
        return height // max(2, height // 10) or 1, width // max(2, width // 10) or 1

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        params = super().pixel_params(columns, shape, noise)
        if self.random_offset:
            params["offsets"] = noise.uniform((shape[0], 2, *self.counts(shape)), len(self.maps)).float()
        return params
