"""Generators of light that falls on a part of the image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._torch_compat import linspace
from kvision.augmentation import ranges
from kvision.augmentation.draws import integer
from kvision.augmentation.lists.sides import Side
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers

__all__ = ["GaussianIlluminationGenerator", "LinearCornerIlluminationGenerator", "LinearIlluminationGenerator"]

# Of rows and of columns: how much of the light their ramps have, and 1 where they fall instead of rising.
_Parts = tuple[tuple[float | Tensor, Tensor], tuple[float | Tensor, Tensor]]

# Maps are computed in float64 and rounded, so that they do not depend on the device.


class IlluminationGenerator(RandomGeneratorBase):
    """Base of generators whose columns say how the light falls."""

    def _light(self, columns: Tensor, down: Side, right: Side) -> Tensor:
        """The maps (B, H, W) of images with these sides. Those of lists are as large as the longest ones."""
        raise NotImplementedError(f"{type(self).__name__}._light")

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        sides: list[Any] = [int(n) if isinstance(n, Tensor) else n for n in shape[-2:]]
        down, right = (Side(n, n) for n in sides)
        return {"gradient": self._light(columns, down, right)[:, None].expand(*shape)}


class GaussianIlluminationGenerator(IlluminationGenerator):
    """Draws the parameters of :class:`RandomGaussianIllumination`.

    Args:
        gain: a number, or a pair within 0 and 1.
        center: a number, or a pair within 0 and 1: fractions of width and height.
        sigma: a number, or a pair within 0 and 1: fractions of width and height.
        sign: a number, or a pair within -1 and 1; numbers below 0 darken.

    Returns:
        gradient (B, C, H, W), what is added.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.GaussianIlluminationGenerator(0.5, 0.5, 0.2, 1.0)
        >>> draw((1, 1, 1, 3))["gradient"].round(decimals=2)
        tensor([[[[0.0000, 0.5000, 0.0000]]]])
    """

    def __init__(self, gain: Numbers, center: Numbers, sigma: Numbers, sign: Numbers) -> None:
        super().__init__()
        op = "RandomGaussianIllumination"
        gain, center, sigma, sign = ranges.keep_parameters(self, gain=gain, center=center, sigma=sigma, sign=sign)
        self._gain, self._center, self._sigma, self._sign = (
            ranges.parse(op, name, ranges.as_pair(value), bounds=bounds)
            for name, value, bounds in (
                ("gain", gain, (0.0, 1.0)),
                ("center", center, (0.0, 1.0)),
                ("sigma", sigma, (0.0, 1.0)),
                ("sign", sign, (-1.0, 1.0)),
            )
        )

    def draws(self, shape: Shape) -> Sequence[Any]:
        center, sigma = self._center.uniform(), self._sigma.uniform()
        return [self._gain.uniform(), self._sign.uniform(), center, center, sigma, sigma]

    def _light(self, columns: Tensor, down: Side, right: Side) -> Tensor:
        gain, sign, center_x, center_y, sigma_x, sigma_y = columns.double().unbind(1)
        rows, columns_of_map = _bump(center_y, sigma_y, down), _bump(center_x, sigma_x, right)
        low, high = (
            (of_rows * of_columns)[:, :, None]
            for of_rows, of_columns in zip(down.extremes(rows), right.extremes(columns_of_map))
        )
        stretched = (rows[:, :, None] * columns_of_map[:, None] - low) / (high - low).clamp(min=1e-12)
        return (_signed(gain, sign)[:, None, None] * stretched).to(columns.dtype)


class LinearIlluminationGenerator(IlluminationGenerator):
    """Draws the parameters of :class:`RandomLinearIllumination`.

    Args:
        gain: a number, or a pair within 0 and 1.
        sign: a number, or a pair within -1 and 1; numbers below 0 darken.

    Returns:
        gradient (B, C, H, W), what is added.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.LinearIlluminationGenerator(0.5, 1.0)((1, 1, 2, 2))["gradient"].amax()
        tensor(0.5000)
    """

    _op = "RandomLinearIllumination"

    def __init__(self, gain: Numbers, sign: Numbers) -> None:
        super().__init__()
        gain, sign = ranges.keep_parameters(self, gain=gain, sign=sign)
        self._gain = ranges.parse(self._op, "gain", ranges.as_pair(gain), bounds=(0.0, 1.0))
        self._sign = ranges.parse(self._op, "sign", ranges.as_pair(sign), bounds=(-1.0, 1.0))

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [self._gain.uniform(), self._sign.uniform(), integer(0, 3)]

    def _light(self, columns: Tensor, down: Side, right: Side) -> Tensor:
        gain, sign, direction = columns.double().unbind(1)
        light, parts = _signed(gain, sign), self._parts(direction, down, right)
        rows, columns_of_map = (
            _ramp(side, light * weight, is_reversed).to(columns.dtype)
            for side, (weight, is_reversed) in zip((down, right), parts)
        )  # whose sum is the map
        return rows[:, :, None] + columns_of_map[:, None]

    @staticmethod
    def _parts(direction: Tensor, down: Side, right: Side) -> _Parts:
        """The ramps toward the lower, upper, right and left edge."""
        is_down, is_reversed = direction < 2, direction % 2
        return (is_down, is_reversed), (~is_down, is_reversed)


class LinearCornerIlluminationGenerator(LinearIlluminationGenerator):
    """Draws the parameters of :class:`RandomLinearCornerIllumination`.

    Args:
        gain: a number, or a pair within 0 and 1.
        sign: a number, or a pair within -1 and 1; numbers below 0 darken.

    Returns:
        gradient (B, C, H, W), what is added.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.LinearCornerIlluminationGenerator(0.5, 1.0)
        >>> draw((1, 1, 3, 3))["gradient"][0, 0, 1, 1]
        tensor(0.2500)
    """

    _op = "RandomLinearCornerIllumination"

    @staticmethod
    def _parts(direction: Tensor, down: Side, right: Side) -> _Parts:
        """The ramps toward the lower right, lower left, upper right and upper left corner."""
        weight = _half_of_two(down, right)  # the ramps of both axes add up to 1
        return (weight, (direction >= 2).to(direction)), (weight, direction % 2)


def _half_of_two(down: Side, right: Side) -> float | Tensor:
    """1/2, but 1 for images of which a side has one pixel."""
    if isinstance(down.size, Tensor) and isinstance(right.size, Tensor):
        return torch.where(torch.minimum(down.size, right.size) > 1, 0.5, 1.0)[:, 0]
    return 0.5 if min(down.longest, right.longest) > 1 else 1.0


def _ramp(side: Side, light: Tensor, is_reversed: Tensor) -> Tensor:
    """From 0 to light (B,) along an axis, or back where `is_reversed` (B,) is 1: (B, size); 0 along one pixel."""
    if side.longest == 1:
        return torch.zeros_like(light)[:, None]
    if not isinstance(side.size, Tensor):
        return light[:, None] * (is_reversed[:, None] - linspace(0, 1, side.size, light)).abs()
    at, most = side.positions(light), side.size - 1
    step = 1 / most.clamp(min=1)
    ramp = torch.where(2 * at < most, step * at, 1 - step * (most - at))  # as linspace counts, to 1 exactly
    return torch.where(most > 0, light[:, None] * (is_reversed[:, None] - ramp).abs(), 0.0)


def _bump(center: Tensor, sigma: Tensor, side: Side) -> Tensor:
    """A Gaussian function (B, size) along an axis, 1 at the pixel next to the center."""
    center, sigma = center[:, None], sigma[:, None]
    squares = (side.positions(center) - (center * side.size - 0.5)) ** 2
    nearest, _ = side.extremes(squares)
    return ((nearest - squares) / (2 * (sigma * side.size).clamp(min=1e-6) ** 2)).exp()


def _signed(gain: Tensor, sign: Tensor) -> Tensor:
    return torch.where(sign < 0, -gain, gain)
