"""Generators of affine transforms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers, NumbersOfAxes
from kvision.augmentation.transforms import center_of
from kvision.core.exceptions import TypeCheckError

__all__ = ["AffineGenerator", "ShearGenerator", "TranslateGenerator"]


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
        TypeError, ValueError: a range does not have the form in Args.

    Example:
        >>> import kvision as K
        >>> params = K.augmentation.random_generator.AffineGenerator(10.0)((2, 3, 8, 8))
        >>> params["center"]
        tensor([[3.5000, 3.5000],
                [3.5000, 3.5000]])
    """

    fields = (("angle", 0), ("translations", 2), ("scale", 2), ("shear_x", 0), ("shear_y", 0))

    def __init__(
        self,
        degrees: NumbersOfAxes,
        translate: NumbersOfAxes | None = None,
        scale: NumbersOfAxes | None = None,
        shear: NumbersOfAxes | None = None,
    ) -> None:
        super().__init__()
        op = "RandomAffine"
        degrees, translate, scale, shear = ranges.keep_parameters(
            self, degrees=degrees, translate=translate, scale=scale, shear=shear
        )
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
        center = torch.tensor(center_of(shape), device=columns.device)
        return {**params, "center": center.expand(columns.shape[0], 2)}

    @property
    def scale_columns(self) -> tuple[str, str]:
        """The names of the columns of the scales along x and y."""
        return ("scale[0]", "scale[0]" if self._one_scale else "scale[1]")


def _translations(op: str, value: Any) -> list[ranges.Range]:
    if not isinstance(value, (Sequence, Tensor)) or isinstance(value, str) or len(value) != 2:
        raise TypeCheckError(f"{op}: expected translate to be two numbers, got {value!r}")
    return [ranges.parse(op, "translate", part, center=0.0, bounds=(-1.0, 1.0)) for part in value]


def _shears(op: str, value: Any) -> list[ranges.Range]:
    zero = ranges.Range(0.0, 0.0)
    if isinstance(value, Tensor) and not value.requires_grad:
        value = value.tolist()
    if isinstance(value, Sequence) and (len(value) == 4 or (len(value) and ranges.is_nested(value[0]))):
        return ranges.pairs(op, "shear", value, 2, bounds=(-360.0, 360.0))
    return [ranges.parse(op, "shear", value, center=0.0, bounds=(-360.0, 360.0)), zero]


class ShearGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomShear`.

    Args:
        shear: degrees: a number s for -s to s along x, a pair along x, or two pairs for x and y.

    Returns:
        center (B, 2), shear_x and shear_y (B,) in degrees.

    Raises:
        TypeError, ValueError: a range does not have the form in Args.

    Example:
        >>> import kvision as K
        >>> sorted(K.augmentation.random_generator.ShearGenerator((5.0, 10.0))((2, 3, 8, 8)))
        ['center', 'shear_x', 'shear_y']
    """

    fields = (("shear_x", 0), ("shear_y", 0))

    def __init__(self, shear: NumbersOfAxes) -> None:
        super().__init__()
        (shear,) = ranges.keep_parameters(self, shear=shear)
        self._shear = _shears("RandomShear", shear)

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [r.uniform() for r in self._shear]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        center = torch.tensor(center_of(shape), device=columns.device)
        return {"center": center.expand(columns.shape[0], 2), **super().to_params(columns, shape)}


class TranslateGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomTranslate`.

    Args:
        translate_x: a pair, as fractions of the width; None for no shift.
        translate_y: a pair, as fractions of the height; None for no shift.

    Returns:
        translate_x and translate_y (B,) in pixels.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not within -1 and 1.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.TranslateGenerator((0.5, 0.5))((1, 3, 8, 8))
        {'translate_x': tensor([4.]), 'translate_y': tensor([0.])}
    """

    fields = (("translate_x", 0), ("translate_y", 0))

    def __init__(self, translate_x: Numbers | None = None, translate_y: Numbers | None = None) -> None:
        super().__init__()
        translate_x, translate_y = ranges.keep_parameters(self, translate_x=translate_x, translate_y=translate_y)
        self._translate = [
            ranges.Range(0.0, 0.0)
            if value is None
            else ranges.parse("RandomTranslate", name, value, bounds=(-1.0, 1.0))
            for name, value in (("translate_x", translate_x), ("translate_y", translate_y))
        ]

    def draws(self, shape: Shape) -> Sequence[Any]:
        x, y = self._translate
        return [x.uniform(float(shape[-1])), y.uniform(float(shape[-2]))]
