"""Maps of vortices."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.distortion.displacement_map import MapFormula
from kvision.augmentation.distortion.distortion_base import DistortionBase
from kvision.augmentation.engine import Params
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding


class Swirl(DistortionBase, keeps_contract=True):
    """Turn images about a center, less the farther away pixels are, as `swirl` of scikit-image does.

    The pixel at distance r reads the image turned by strength 2^(-5 r / radius) radians.

    Args:
        strength_range: pair of the lowest and the highest angle at the center in radians, clockwise if positive.
        radius_range: pair of the lowest and the highest radius, above 0, where a 32nd of the angle is left, as fractions of the
            shorter side.
        center_range: pair of the lowest and the highest position of the center, as fractions of width and height.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 1, 6, 6)
        >>> torch.allclose(K.augmentation.Swirl((0.0, 0.0), p=1.0)(x), x, atol=1e-5)
        True
    """

    def __init__(
        self,
        strength_range: Numbers = (-2.0, 2.0),
        radius_range: Numbers = (0.5, 1.0),
        center_range: Numbers = (0.4, 0.6),
        resample: AnyResample = Resample.BILINEAR.name,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(resample, padding_mode, same_on_batch=same_on_batch, p=p, keepdim=keepdim, **options)
        self._param_generator = MappedGenerator(
            (strength_range, "strength", None, None),
            (radius_range, "radius", None, (1e-3, float("inf"))),
            (center_range, "center_x", None, (0.0, 1.0)),
            (center_range, "center_y", None, (0.0, 1.0)),
            identity=[0.0, 1.0, 0.5, 0.5],
            op="Swirl",
        )

    def _formula(self, params: Params, flags: dict[str, Any], like: Tensor) -> MapFormula:
        names = ("strength", "radius", "center_x", "center_y")
        return MapFormula("swirl", torch.stack([params[name].to(like) for name in names], 1))
