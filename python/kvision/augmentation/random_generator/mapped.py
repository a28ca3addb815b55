"""Generators of parameters by name and of maps of noise, for classes that need no formula of their own to draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from kvision._ops import Operator
from kvision.augmentation.draws import integer, uniform
from kvision.augmentation.lists.pixels import given_maps
from kvision.augmentation.noise import MULTIPLY, SHARED, PixelNoise, gaussian_noise, on_numbers, uniform_noise
from kvision.augmentation.random_generator.base import Shape
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import LearnedUniform, Range
from kvision.geometry.transform.lists.kept_sizes import Operation

__all__: list[str] = []  # Kornia has none of these


class Map(Protocol):
    """What draws numbers of each pixel."""

    def draw(self, noise: PixelNoise, shape: Shape, number: int) -> Any:
        """The map with a number of its own among those of an augmentation, float32; with sizes of a list one of each image."""
        ...


def map_size(size: Sequence[int | None], shape: Shape) -> list[int]:
    """(B, channels, height, width) of a map for images of a shape, whose own sizes stand for None."""
    channels, *sides = size
    own = [n if side is None else side for side, n in zip(cycle(sides), shape[2:])]  # of each image of a list
    return [shape[0], shape[1] if channels is None else channels, *own]


class NoiseMap(NamedTuple):
    """Numbers of each pixel, (B, channels, height, width): uniform in [0, 1), or of the standard normal distribution."""

    normal: bool = False
    size: tuple[int | None, int | None, int | None] = (None, None, None)  # None: that of the images

    def draw(self, noise: PixelNoise, shape: Shape, number: int) -> Any:
        """The map with a number of its own among those of an augmentation, float32; with sizes of a list one of each image."""
        size = map_size(self.size, shape)
        if len(size) > 4:
            return self.draw_list(noise, [(size[1], *side) for side in zip(size[2::2], size[3::2])], number)
        return noise.normal(size, map=number) if self.normal else noise.uniform(size, number)

    def draw_list(self, noise: PixelNoise, shapes: Sequence[Shape], number: int) -> list[Tensor]:
        """The maps of the images of a list, of a shape (C, H, W) each."""
        sizes = [map_size(self.size, (1, *shape))[1:] for shape in shapes]
        return noise.normal_list(sizes, number) if self.normal else noise.uniform_list(sizes, number)


class NoiseOfList(NamedTuple):
    """A map of the images of a list, which is drawn where it is read."""

    map: Any
    source: PixelNoise
    images: Sequence[Tensor]

    def each(self, dtype: torch.dtype) -> list[Tensor]:
        """The map of each image."""
        drawn: list[Tensor] = self.map.draw_list(self.source, [tuple(x.shape) for x in self.images], 0)
        return drawn if dtype == torch.float32 else given_maps(drawn, self.source.device, dtype)


class MappedGenerator(PlainUniformGenerator):
    """Draws uniform parameters, then integers, and maps of noise.

    Args:
        *samplers: as those of the base.
        integers: the lowest and the highest integer by name, then the step where it is not 1.
        maps: maps of noise by name.
        identity: values of the uniform parameters of samples that are not chosen; default: 0.
        op: the name in messages of errors.
    """

    def __init__(
        self,
        *samplers: Sequence[Any],
        integers: Mapping[str, tuple[int, ...]] | None = None,
        maps: Mapping[str, Map] | None = None,
        identity: Sequence[float] | None = None,
        op: str,
    ) -> None:
        super().__init__(*samplers, identity=identity, op=op)
        self.integers, self.maps = dict(integers or {}), dict(maps or {})
        self.fields = (*self.fields, *((name, 0) for name in self.integers))
        self.per_pixel = bool(self.maps)
        self.has_planes_of_images = not any(getattr(map, "moves_pixels", False) for map in self.maps.values())
        self.is_exact = all(getattr(map, "is_exact", False) for map in self.maps.values())

    def draws(self, shape: Shape) -> Sequence[Any]:
        own = (integer(low, high, low, *step) for low, high, *step in self.integers.values())
        return [*super().draws(shape), *own]

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        return {name: map.draw(noise, shape, number) for number, (name, map) in enumerate(self.maps.items())}


class FactorsGenerator(PlainUniformGenerator):
    """Draws factors of pixels with a mean and a scale: the columns that an operator takes, and the map `factors` that it gives.

    Args:
        op: the name in messages of errors.
        scale: the name and the range of the deviation of normal factors about 1; or the range of uniform factors.
        size: of the map, as that of :class:`NoiseMap`.
    """

    per_pixel = True

    def __init__(
        self,
        op: str,
        scale: tuple[str, Any] | Range,
        size: tuple[int | None, int | None, int | None] = (None, None, None),
    ) -> None:
        name, values = ("scale", (0.0, 0.0)) if isinstance(scale, Range) else scale
        super().__init__(
            ((1.0, 1.0), "mean", None, None), (values, name, None, (0.0, float("inf"))), identity=[1.0, 0.0], op=op
        )
        self.between = scale if isinstance(scale, Range) else None
        self.hidden = ("mean",) if self.between is None else ("mean", name)
        self.size = size
        self.form = MULTIPLY | (0 if size[0] is None else SHARED)

    @property
    def draw(self) -> Operator:
        """The operator of the factors."""
        return gaussian_noise if self.between is None else uniform_noise

    def draws(self, shape: Shape) -> Sequence[Any]:
        if self.between is None:
            return super().draws(shape)
        if (learned := self.between.tensor) is not None:
            middle, half = learned.mean(), (learned[1] - learned[0]) / 2
            return [LearnedUniform(middle.expand(2), 1.0, 1.0), LearnedUniform(half.expand(2), 1.0, 0.0)]
        low, high = self.between.low, self.between.high
        mean, scale = (low + high) / 2, (high - low) / 2
        return [uniform(mean, mean, 1.0), uniform(scale, scale)]

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        drawing = Operation(self.draw, (columns, *noise.arguments(form=self.form)))
        return {"factors": on_numbers(drawing, map_size(self.size, shape), 1.0, columns)}
