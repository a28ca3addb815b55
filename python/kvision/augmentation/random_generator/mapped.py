"""Generators of parameters by name and of maps of noise, for classes that need no formula of their own to draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from torch import Tensor

from kvision.augmentation.draws import integer
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import Shape
from kvision.augmentation.random_generator.plain import PlainUniformGenerator

__all__: list[str] = []  # Kornia has none of these


class NoiseMap(NamedTuple):
    """Numbers of each pixel, (B, channels, height, width): uniform in [0, 1), or of the standard normal distribution."""

    normal: bool = False
    size: tuple[int | None, int | None, int | None] = (None, None, None)  # None: that of the images

    def draw(self, noise: PixelNoise, shape: Shape, number: int) -> Tensor:
        """The map with a number of its own among those of an augmentation, float32."""
        size = [shape[0], *(n if own is None else own for own, n in zip(self.size, shape[1:]))]
        return noise.normal(size, map=number) if self.normal else noise.uniform(size, number).float()


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
        maps: Mapping[str, NoiseMap] | None = None,
        identity: Sequence[float] | None = None,
        op: str,
    ) -> None:
        super().__init__(*samplers, identity=identity, op=op)
        self.integers, self.maps = dict(integers or {}), dict(maps or {})
        self.fields = (*self.fields, *((name, 0) for name in self.integers))
        self.per_pixel = bool(self.maps)

    def draws(self, shape: Shape) -> Sequence[Any]:
        own = (integer(low, high, low, *step) for low, high, *step in self.integers.values())
        return [*super().draws(shape), *own]

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        return {name: map.draw(noise, shape, number) for number, (name, map) in enumerate(self.maps.items())}
