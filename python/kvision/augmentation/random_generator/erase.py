"""Generators of rectangles that are erased."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._constants import constant
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import ShapeError

__all__ = ["RectangleEraseGenerator"]


class RectangleEraseGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomErasing`.

    Args:
        scale: pair of lowest and highest area, as fractions of the image's.
        ratio: pair of lowest and highest height to width.
        value: the fill value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.

    Returns:
        widths, heights, xs, ys in pixels, (B,) each; values (B,), (B, C) of channels, or (B, C, H, W) of noise.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> params = K.augmentation.random_generator.RectangleEraseGenerator((0.25, 0.25), (1.0, 1.0))((1, 3, 8, 8))
        >>> params["widths"], params["heights"]
        (tensor([4.]), tensor([4.]))
    """

    def __init__(self, scale: Numbers = (0.02, 0.33), ratio: Numbers = (0.3, 3.3), value: Any = 0.0) -> None:
        super().__init__()
        op, unbounded = "RandomErasing", (0.0, float("inf"))
        scale, ratio = ranges.without_gradient(op, "scale", scale), ranges.without_gradient(op, "ratio", ratio)
        self._scale = ranges.parse(op, "scale", scale, bounds=unbounded)
        self._ratio = ranges.parse(op, "ratio", ratio, bounds=(1e-6, float("inf")))
        self.value = ranges.fill_value(op, "value", value)
        self.per_pixel = self.value == "random"

    def draws(self, shape: Shape) -> Sequence[Any]:
        if isinstance(self.value, list) and len(self.value) != shape[1]:
            raise ShapeError(f"RandomErasing: expected value of {shape[1]} channels, got {len(self.value)}")
        numbers = (self._scale.low, self._scale.high, self._ratio.low, self._ratio.high)
        return [Draw("rectangle", (*numbers, float(shape[-2]), float(shape[-1])))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        x, y, w, h = columns.unbind(1)
        params = {"widths": w, "heights": h, "xs": x, "ys": y}
        if isinstance(self.value, list):
            params["values"] = constant(tuple(self.value), columns).repeat(len(columns), 1)
        elif not isinstance(self.value, str):
            params["values"] = torch.full_like(x, self.value)
        return params

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        return {"values": noise.uniform(shape)}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return torch.stack([params[name] for name in ("xs", "ys", "widths", "heights")], 1)
