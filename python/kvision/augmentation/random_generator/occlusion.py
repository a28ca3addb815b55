"""Generators of what is dropped from images."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant, on_device
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.noise import BY_CHANNEL, RANDOM, PixelNoise, salt_and_pepper
from kvision.augmentation.random_generator.base import Shape
from kvision.augmentation.random_generator.mapped import MappedGenerator, NoiseMap
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
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
        value = _check.scalars(op, name, ranges.without_gradient(op, name, value))
        if isinstance(value, (tuple, list)) and all(_check.is_int(n) for n in value):
            return cls(*ranges.parse_integers(op, name, value, 0), True)
        fractions = ranges.parse(op, name, value, bounds=(0.0, 1.0))
        return cls(fractions.low, fractions.high, False)


WHOLE = Lengths(1.0, 1.0, False)


class Holes(NamedTuple):
    """A kind of holes: the range of their number and those of their sizes."""

    number: tuple[int, int]
    heights: Lengths = WHOLE
    widths: Lengths = WHOLE


class HolesGenerator(MappedGenerator):
    """Draws rectangles: holes (B, N, 4), x, y, width and height in pixels, of size 0 behind the drawn number of each kind."""

    def __init__(self, op: str, kinds: Sequence[Holes], fill: float | list[float] | str) -> None:
        super().__init__(maps=fill_maps(fill), op=op)
        self.kinds = kinds
        self.fields = (("holes", 4 * sum(kind.number[1] for kind in kinds)),)

    def draws(self, shape: Shape) -> Sequence[Any]:
        size = float(shape[-2]), float(shape[-1])
        return [
            Draw("rectangles", (4 * most, fewest, *map(float, heights), *map(float, widths), *size))
            for (fewest, most), heights, widths in self.kinds
        ]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"holes": columns.reshape(len(columns), columns.shape[1] // 4, 4)}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        holes: Tensor = params["holes"]
        return holes.flatten(1)


def is_hit(columns: Tensor, noise: PixelNoise, form: int, shape: Shape) -> Tensor:
    """Which pixels of images of a shape are hit by `salt_and_pepper`, bool (B, 1, H, W), or (B, C, H, W) by channel."""
    size = (shape[0], shape[1] if form & BY_CHANNEL else 1, *shape[-2:])
    kept = torch.full(size, 2, dtype=torch.uint8, device=columns.device)
    hit: Tensor = salt_and_pepper(kept, columns.detach(), *noise.arguments(form=form & BY_CHANNEL))
    return hit != 2


class PixelDropoutGenerator(PlainUniformGenerator):
    """Draws the probability that a pixel is dropped, and which ones are."""

    per_pixel = is_exact = True
    hidden = ("salt",)

    def __init__(self, probability: Any, form: int, fill: float | list[float] | str) -> None:
        bounds = (0.0, 1.0)
        super().__init__(
            (probability, "dropout_prob", None, bounds), ((0.0, 0.0), "salt", None, bounds), op="PixelDropout"
        )
        self.form, self.fill = form, fill

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        params = {"dropped": is_hit(columns, noise, self.form, shape)}
        if self.fill == "random":
            everywhere = constant(((1.0, 0.0),), columns)
            zero = columns.new_zeros(tuple(shape))
            params["fill"] = salt_and_pepper(zero, everywhere, *noise.arguments(form=RANDOM))
        return params


class Units(NamedTuple):
    """The units of a grid along an axis, and the hole in each, in pixels."""

    first: Sequence[int]
    hole: Sequence[int]
    free: Sequence[int]  # what the hole leaves of its unit
    places: Sequence[int]  # how many positions the hole may have


@functools.lru_cache(maxsize=64)
def units_along(size: int, counts: tuple[int, ...], ratio: float, shift: int | None) -> tuple[Units, ...]:
    """The units of an axis that has any of these numbers of them, as many each as the largest, those too many without a hole.

    A shift moves their holes, which stay in the image; None for units whose holes are moved later.
    """
    tables = []
    for count in counts:
        ends = [unit * size // count for unit in range(count + 1)]
        sides = [end - first for first, end in itertools.pairwise(ends)]
        holes = [min(max(int(side * ratio), 1), side - 1) for side in sides]
        free = [side - hole for side, hole in zip(sides, holes)]
        first = ends[:-1] if shift is None else [min(end + shift, size - hole) for end, hole in zip(ends, holes)]
        none = (0,) * (max(counts) - count)
        places = (pixels + 1 for pixels in free)
        tables.append(Units(*((*row, *none) for row in (first, holes, free, places))))
    return tuple(tables)


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

    def counts(self, shape: Shape) -> list[tuple[int, ...]]:
        """The numbers of units that an image of a shape may have, down and across: of each side of units, from the lowest on."""
        size = height, width = [int(n) for n in shape[-2:]]
        if self.unit_size_range is not None:
            low, high = self.unit_size_range
            if high > min(size):
                raise ValueCheckError(
                    f"GridDropout: expected unit_size_range of at most the shorter side, {min(size)}, got {high}"
                )
            return [tuple(n // unit for unit in range(low, high + 1)) for n in size]
        if self.holes_number_xy is not None:
            across, down = self.holes_number_xy
            return [(min(down, height),), (min(across, width),)]
        return [(n // max(2, n // 10) or 1,) for n in size]

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        params = super().pixel_params(columns, shape, noise)
        if self.random_offset:
            down, across = (max(counts) for counts in self.counts(shape))
            params["offsets"] = NoiseMap(size=(2, down, across)).draw(noise, shape, len(self.maps))
        return params

    def offsets_of_list(self, noise: PixelNoise, counts: Sequence[Sequence[tuple[int, ...]]]) -> Tensor:
        """The offsets (B, 2, R, C) of images with the `counts` of each, for as many units as the most have."""
        units = [[max(along) for along in own] for own in counts]
        drawn = noise.uniform_list([(2, *own) for own in units], len(self.maps))
        down, across = (max(along) for along in zip(*units))
        sizes = torch.tensor(units, device="cpu")
        rows, columns = sizes[:, :1, None], sizes[:, 1:, None]
        place = torch.arange(down, device="cpu")[:, None] * columns + torch.arange(across, device="cpu")
        ends = 2 * (rows * columns).cumsum(0)
        first = ends - 2 * rows * columns
        at = torch.stack([first + place, first + rows * columns + place], 1).minimum(ends[:, None] - 1)
        values = torch.cat([own.flatten() for own in drawn])
        return values[on_device(at, values.device)]
