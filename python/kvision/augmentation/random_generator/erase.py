"""Generators of rectangles that are erased."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape

__all__ = ["RectangleEraseGenerator"]


class RectangleEraseGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomErasing`.

    Args:
        scale: pair of lowest and highest area, as fractions of the image's.
        ratio: pair of lowest and highest height to width.
        value: the fill value, within 0 and 1.

    Returns:
        widths, heights, xs, ys in pixels and values, (B,) each.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> params = K.augmentation.random_generator.RectangleEraseGenerator((0.25, 0.25), (1.0, 1.0))((1, 3, 8, 8))
        >>> params["widths"], params["heights"]
        (tensor([4.]), tensor([4.]))
    """

    def __init__(self, scale: Any = (0.02, 0.33), ratio: Any = (0.3, 3.3), value: float = 0.0) -> None:
        super().__init__()
        op, unbounded = "RandomErasing", (0.0, float("inf"))
        self._scale = ranges.parse(op, "scale", scale, bounds=unbounded)
        self._ratio = ranges.parse(op, "ratio", ratio, bounds=(1e-6, float("inf")))
        self.value = ranges.parse(op, "value", (value, value), bounds=(0.0, 1.0)).low

    def draws(self, shape: Shape) -> Sequence[Any]:
        numbers = (self._scale.low, self._scale.high, self._ratio.low, self._ratio.high)
        return [Draw("rectangle", (*numbers, float(shape[-2]), float(shape[-1])))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        x, y, w, h = columns.unbind(1)
        return {"widths": w, "heights": h, "xs": x, "ys": y, "values": torch.full_like(x, self.value)}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return torch.stack([params[name] for name in ("xs", "ys", "widths", "heights")], 1)
