"""Maps that are linear between the nodes of a grid."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation import ranges
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

    def displacements(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        learned = self._range.tensor
        low, high = (self._range.low, self._range.high) if learned is None else learned.to(like).unbind()
        factors = 1 + low + (high - low) * params["steps"].to(like)[:, :, 0]  # of columns and of rows
        along_x, along_y = (self._along(f, n) for f, n in zip(factors.unbind(1), (shape[-1], shape[-2])))
        height, width = shape[-2:]
        return torch.stack([along_x[:, None].expand(-1, height, -1), along_y[:, :, None].expand(-1, -1, width)], 1)

    def _along(self, factors: Tensor, size: int) -> Tensor:
        """Displacements (B, size) of pixels along an axis whose cells are changed by factors (B, n)."""
        count = factors.shape[1]
        total = factors.sum(1, keepdim=True) if self.normalized else count
        sides = factors / total  # of what cells show, as fractions of the image
        first = sides.cumsum(1) - sides
        at = (torch.arange(size, dtype=factors.dtype, device=factors.device) + 0.5) * (count / size)
        cell = at.floor().long().clamp(max=count - 1)
        read = first[:, cell] + sides[:, cell] * (at - cell)
        return read * size - at * (size / count)


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

    def displacements(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        height, width = shape[-2:]
        unit = 1 if self.absolute_scale else min(height, width)
        moves = params["nodes"].to(like) * params["scale"].to(like)[:, None, None, None] * (unit / 3)
        at, corners, place = [], [], []
        for name, size in (("columns", width), ("rows", height)):
            count = params[name].to(like)[:, None]
            nodes = torch.arange(moves.shape[-1 if name == "columns" else -2], dtype=like.dtype, device=like.device)
            corners.append(nodes * (size - 1) / (count - 1))  # (B, n), beyond the image where there are fewer
            pixel = torch.arange(size, dtype=like.dtype, device=like.device) * ((count - 1) / max(size - 1, 1))
            cell = pixel.floor().minimum(count - 2)
            at.append(cell.long())
            place.append(pixel - cell)
        node_x, node_y = corners[0][:, None], corners[1][:, :, None]
        moved_x = (node_x + moves[:, 0]).clamp(0, width - 1) - node_x
        moved_y = (node_y + moves[:, 1]).clamp(0, height - 1) - node_y
        nodes = torch.stack([moved_x, moved_y], 1)  # (B, 2, R, C)
        u, v = place[0][:, None, None], place[1][:, None, :, None]
        a, b, c, d = (_nodes_at(nodes, at[1] + down, at[0] + right) for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)))
        upper = a + (b - a) * u + (c - a) * v  # of the triangle with a, to the left of the diagonal from b to c
        lower = d + (c - d) * (1 - u) + (b - d) * (1 - v)
        return torch.where(u + v <= 1, upper, lower)


def _nodes_at(nodes: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Values (B, 2, H, W) of nodes (B, 2, R, C) at rows (B, H) and columns (B, W)."""
    at = rows[:, :, None] * nodes.shape[3] + columns[:, None]
    return nodes.flatten(2).gather(2, at.flatten(1)[:, None].expand(-1, 2, -1)).unflatten(2, at.shape[1:])
