"""Generators of color changes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers

__all__ = ["ColorJiggleGenerator", "ColorJitterGenerator"]


class ColorJitterGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`ColorJitter`.

    Args:
        brightness, contrast, saturation: a number s for max(0, 1 - s) to 1 + s, or a pair.
        hue: a number s for -s to s, or a pair, in turns: at most half a turn.
        order: a permutation of 0 to 3; None for a random one a sample.

    Returns:
        brightness_factor, contrast_factor, saturation_factor, hue_factor (B,), and order (B, 4): which of brightness (0),
        contrast (1), saturation (2) and hue (3) comes at each position; -1 for samples that are not chosen.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> sorted(K.augmentation.random_generator.ColorJitterGenerator(brightness=0.2)((2, 3, 8, 8)))
        ['brightness_factor', 'contrast_factor', 'hue_factor', 'order', 'saturation_factor']
    """

    fields: Sequence[tuple[str, int]] = (
        ("brightness_factor", 0),
        ("contrast_factor", 0),
        ("saturation_factor", 0),
        ("hue_factor", 0),
        ("radians", 0),
        ("order", 4),
    )
    hidden: Sequence[str] = ("radians",)  # hue, as kernels take it

    def __init__(
        self,
        brightness: Numbers = 0.0,
        contrast: Numbers = 0.0,
        saturation: Numbers = 0.0,
        hue: Numbers = 0.0,
        order: Any = None,
    ) -> None:
        super().__init__()
        op = type(self).__name__.removesuffix("Generator")
        brightness, contrast, saturation, hue = ranges.keep_parameters(
            self, brightness=brightness, contrast=contrast, saturation=saturation, hue=hue
        )
        most = float("inf")
        self._brightness = ranges.parse(
            op, "brightness", brightness, center=1.0, bounds=(0.0, self._largest_brightness)
        )
        self._contrast = ranges.parse(op, "contrast", contrast, center=1.0, bounds=(0.0, most))
        self._saturation = ranges.parse(op, "saturation", saturation, center=1.0, bounds=(0.0, most))
        self._hue = ranges.parse(op, "hue", hue, center=0.0, bounds=(-0.5, 0.5))
        self.order = None if order is None else tuple(int(i) for i in order)

    _largest_brightness = float("inf")

    def draws(self, shape: Shape) -> Sequence[Any]:
        if self.order is None:
            order = [Draw("permutation", (4, -1, 0))]
        else:
            order = [Draw("integer", (i, 1, 1, -1)) for i in self.order]
        return [
            self._brightness.uniform(identity=1.0),
            self._contrast.uniform(identity=1.0),
            self._saturation.uniform(identity=1.0),
            self._hue.uniform_and_affine(2 * math.pi, 0.0),
            *order,
        ]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        params = super().to_params(columns, shape)
        params["order"] = params["order"].long()
        return params

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        order, hue = params["order"], params["hue_factor"]
        if order.dim() == 1:  # one for the batch, as Kornia has it
            order = order.expand(shape[0], -1)
        radians = ranges.affine(hue, 2 * math.pi, 0.0)
        return super().to_columns({**params, "radians": radians, "order": order.to(hue)}, shape)


class ColorJiggleGenerator(ColorJitterGenerator):
    """Draws the parameters of :class:`ColorJiggle`: as :class:`ColorJitterGenerator`, with a brightness of at most 2.

    Args:
        brightness, contrast, saturation: a number s for max(0, 1 - s) to 1 + s, or a pair.
        hue: a number s for -s to s, or a pair, in turns: at most half a turn.
        order: a permutation of 0 to 3; None for a random one a sample.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.ColorJiggleGenerator(hue=0.1)((2, 3, 8, 8))["order"].shape
        torch.Size([2, 4])
    """

    fields = (
        ("brightness_factor", 0),
        ("addition", 0),
        ("contrast_factor", 0),
        ("saturation_factor", 0),
        ("hue_factor", 0),
        ("radians", 0),
        ("order", 4),
    )
    hidden = ("addition", "radians")  # the factor of brightness less 1, which is added
    _largest_brightness = 2.0

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [self._brightness.uniform_and_affine(1.0, -1.0, identity=1.0), *super().draws(shape)[1:]]

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        addition = ranges.affine(params["brightness_factor"], 1.0, -1.0)
        return super().to_columns({**params, "addition": addition}, shape)
