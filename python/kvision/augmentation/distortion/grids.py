"""Maps that are linear between the nodes of a grid."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation import ranges
from kvision.augmentation.distortion.displacement_map import MapFormula
from kvision.augmentation.distortion.distortion_base import DistortionBase
from kvision.augmentation.engine import Params
from kvision.augmentation.random_generator.mapped import MappedGenerator, NoiseMap
from kvision.augmentation.ranges import Numbers
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding


class GridDistortion(DistortionBase, keeps_contract=True):
    """Stretch and shrink the rows and the columns of a grid of equal cells by random factors.

    Args:
        num_steps: rows and columns of the grid.
        distort_range: pair of the lowest and the highest change of the side of a cell, above -1, as fractions of it.
        normalized: all of the image is shown; otherwise its right and lower parts may leave it or end before its border.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 1, 6, 6)
        >>> torch.allclose(K.augmentation.GridDistortion(3, (0.0, 0.0), p=1.0)(x), x, atol=1e-5)
        True
    """

    def __init__(
        self,
        num_steps: int = 5,
        distort_range: Numbers = (-0.3, 0.3),
        normalized: bool = True,
        resample: AnyResample = Resample.BILINEAR.name,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(resample, padding_mode, same_on_batch=same_on_batch, p=p, keepdim=keepdim, **options)
        op = "GridDistortion"
        (_, steps) = ranges.parse_integers(op, "num_steps", (1, num_steps))
        self._range = ranges.parse(op, "distort_range", distort_range, bounds=(-0.999, float("inf")))
        self.normalized = _check.switch(op, "normalized", normalized)
        self._param_generator = MappedGenerator(maps={"steps": NoiseMap(size=(2, 1, steps))}, op=op)

    def _formula(self, params: Params, flags: dict[str, Any], like: Tensor) -> MapFormula:
        learned, steps = self._range.tensor, params["steps"].to(like).flatten(1)  # of columns, then of rows
        if learned is None:
            factors = torch.add(1 + self._range.low, steps, alpha=self._range.high - self._range.low)
        else:
            low, high = learned.to(like).unbind()
            factors = 1 + low + (high - low) * steps
        return MapFormula("cells", factors, (self.normalized,))


class PiecewiseAffine(DistortionBase, keeps_contract=True):
    """Move the nodes of a grid at random; between them, in triangles, maps are affine. Nodes stay in the image.

    Args:
        scale_range: pair of the lowest and the highest scale: three standard deviations of the displacements of nodes, as a
            fraction of the shorter side.
        nb_rows_range: pair of the lowest and the highest number of rows of nodes, of at least 2.
        nb_cols_range: the same of columns.
        absolute_scale: scales are in pixels.
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
        >>> torch.allclose(K.augmentation.PiecewiseAffine((0.0, 0.0), p=1.0)(x), x, atol=1e-5)
        True
    """

    def __init__(
        self,
        scale_range: Numbers = (0.03, 0.05),
        nb_rows_range: tuple[int, int] = (4, 4),
        nb_cols_range: tuple[int, int] = (4, 4),
        absolute_scale: bool = False,
        resample: AnyResample = Resample.BILINEAR.name,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(resample, padding_mode, same_on_batch=same_on_batch, p=p, keepdim=keepdim, **options)
        op = "PiecewiseAffine"
        rows = ranges.parse_integers(op, "nb_rows_range", nb_rows_range, 2)
        columns = ranges.parse_integers(op, "nb_cols_range", nb_cols_range, 2)
        self.absolute_scale = _check.switch(op, "absolute_scale", absolute_scale)
        self._param_generator = MappedGenerator(
            (scale_range, "scale", None, (0.0, float("inf"))),
            integers={"rows": rows, "columns": columns},
            maps={"nodes": NoiseMap(True, (2, rows[1], columns[1]))},
            op=op,
        )

    def _formula(self, params: Params, flags: dict[str, Any], like: Tensor) -> MapFormula:
        nodes = params["nodes"].to(like)
        numbers = (params[name].to(like)[:, None] for name in ("scale", "rows", "columns"))
        rows = torch.cat([*numbers, nodes.flatten(1)], 1)
        return MapFormula("triangles", rows, (*nodes.shape[2:], self.absolute_scale))
