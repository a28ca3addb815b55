"""Generators of affine transforms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape

__all__ = ["AffineGenerator"]


class AffineGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomAffine`.

    Args:
        degrees: angle, a number s for -s to s, or a pair.
        translate: largest shifts along x and y, as fractions of width and height.
        scale: a pair; or two pairs, for x and for y.
        shear: degrees: a number s for -s to s along x, a pair along x, or two pairs for x and y.

    Returns:
        translations (B, 2) in pixels, center (B, 2), scale (B, 2), angle, shear_x and shear_y (B,) in degrees.

    Raises:
        TypeError, ValueError: a range of another form.

    Example:
        >>> import kvision as K
        >>> params = K.augmentation.random_generator.AffineGenerator(10.0)((2, 3, 8, 8))
        >>> params["center"]
        tensor([[3.5000, 3.5000],
                [3.5000, 3.5000]])
    """

    fields = (("angle", 0), ("translations", 2), ("scale", 2), ("shear_x", 0), ("shear_y", 0))

    def __init__(self, degrees: Any, translate: Any = None, scale: Any = None, shear: Any = None) -> None:
        super().__init__()
        op = "RandomAffine"
        ranges.keep_parameters(self, degrees=degrees, translate=translate, scale=scale, shear=shear)
        self._degrees = ranges.parse(op, "degrees", degrees, center=0.0, bounds=(-360.0, 360.0))
        self._translate = None if translate is None else _translations(op, translate)
        self._scale = None if scale is None else ranges.pairs(op, "scale", scale, 2, bounds=(0.0, float("inf")))
        self._one_scale = self._scale is not None and self._scale[0] is self._scale[1]
        self._shear = None if shear is None else _shears(op, shear)

    def draws(self, shape: Shape) -> Sequence[Any]:
        height, width = shape[-2:]
        zero, one = ranges.Range(0.0, 0.0), ranges.Range(1.0, 1.0)
        x, y = self._translate or (zero, zero)
        scale_x, scale_y = self._scale or (one, one)
        shear_x, shear_y = self._shear or (zero, zero)
        second = ranges.Range(1.0, 1.0) if self._one_scale else scale_y
        return [
            self._degrees.uniform(),
            x.uniform(float(width)),
            y.uniform(float(height)),
            scale_x.uniform(identity=1.0),
            second.uniform(identity=1.0),
            shear_x.uniform(),
            shear_y.uniform(),
        ]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        params = super().to_params(columns, shape)
        if self._one_scale:
            params["scale"] = params["scale"][:, :1].expand(-1, 2)
        height, width = shape[-2:]
        center = torch.tensor([(width - 1) / 2, (height - 1) / 2], device=columns.device)
        return {**params, "center": center.expand(columns.shape[0], 2)}

    @property
    def scale_columns(self) -> tuple[int, int]:
        """The columns of the scales along x and y."""
        return (3, 3) if self._one_scale else (3, 4)


def _translations(op: str, value: Any) -> list[ranges.Range]:
    return [ranges.parse(op, "translate", part, center=0.0, bounds=(-1.0, 1.0)) for part in value]


def _shears(op: str, value: Any) -> list[ranges.Range]:
    zero = ranges.Range(0.0, 0.0)
    if isinstance(value, Tensor) and not value.requires_grad:
        value = value.tolist()
    if isinstance(value, Sequence) and (len(value) == 4 or isinstance(value[0], Sequence)):
        return ranges.pairs(op, "shear", value, 2, bounds=(-360.0, 360.0))
    return [ranges.parse(op, "shear", value, center=0.0, bounds=(-360.0, 360.0)), zero]
