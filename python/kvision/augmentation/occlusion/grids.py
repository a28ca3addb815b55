"""Regular patterns that are dropped from images."""

from __future__ import annotations

import math
from typing import Any, Literal

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation import ranges
from kvision.augmentation.engine import Params
from kvision.augmentation.occlusion.dropout_base import DropoutBase
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.random_generator.occlusion import GridDropoutGenerator, fill_maps
from kvision.augmentation.ranges import Numbers


class GridDropout(DropoutBase, keeps_contract=True):
    """Fill a hole in each unit of a grid with a value.

    Args:
        ratio: side of a hole as a fraction of its unit's, above 0 and at most 1. A hole leaves one pixel of its unit at least.
        random_offset: each hole has a random position in its unit.
        unit_size_range: pair of the lowest and the highest side of units in pixels, of at least 2.
        holes_number_xy: numbers of units across and down, instead; default: units of a tenth of the image.
        shift_xy: without `random_offset`, how far holes are from the upper left corners of their units; they stay in the image.
        fill: the fill value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.
        fill_mask: the value of masks in holes; None leaves masks as they are.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args, or is out of bounds; in a call, units larger than the
            image.

    Example:
        >>> import torch, kvision as K
        >>> drop = K.augmentation.GridDropout(0.5, holes_number_xy=(2, 2), p=1.0)
        >>> drop(torch.ones(1, 1, 8, 8)).sum()
        tensor(48.)
    """

    _param_generator: GridDropoutGenerator

    def __init__(
        self,
        ratio: float = 0.5,
        random_offset: bool = True,
        unit_size_range: tuple[int, int] | None = None,
        holes_number_xy: tuple[int, int] | None = None,
        shift_xy: tuple[int, int] = (0, 0),
        fill: Numbers | Literal["random"] = 0.0,
        fill_mask: float | None = 0.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(fill, fill_mask, p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "GridDropout"
        self.ratio = ranges.parse(op, "ratio", (ratio, ratio), bounds=(1e-6, 1.0)).low
        self.shift_xy = _check.ints(op, "shift_xy", shift_xy, 2, minimum=0)
        if unit_size_range is not None:
            unit_size_range = ranges.parse_integers(op, "unit_size_range", unit_size_range, 2)
        if holes_number_xy is not None:
            holes_number_xy = _check.pair(op, "holes_number_xy", holes_number_xy)
        is_random = _check.switch(op, "random_offset", random_offset)
        self._param_generator = GridDropoutGenerator(unit_size_range, holes_number_xy, is_random, self.fill)

    def is_dropped(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        size, most = shape[-2:], self._param_generator.counts(shape)
        if "unit_size" in params:
            unit = params["unit_size"].to(device).long()[:, None]
            counts = [n // unit for n in size]
        else:
            counts = [torch.full((shape[0], 1), n, device=device) for n in most]
        if "offsets" not in params:
            shifts = reversed(self.shift_xy)
            is_row, is_column = (self._in_holes(*along) for along in zip(size, counts, most, shifts))
            return (is_row[:, :, None] & is_column[:, None])[:, None]
        down, across = (self._along(n, count) for n, count in zip(size, counts))
        return self._at_offsets(params["offsets"].to(device), down, across)[:, None]

    def _unit(self, unit: Tensor, size: int, count: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Where units of a number begin along an axis, their length and that of their holes."""
        first = unit * size // count
        side = (unit + 1) * size // count - first
        return first, side, (side * self.ratio).long().clamp(min=1).minimum(side - 1)

    def _in_holes(self, size: int, count: Tensor, most: int, shift: int) -> Tensor:
        """Which pixels (B, size) along an axis are in the holes of `count` (B, 1) units, all moved by a shift."""
        unit, at = torch.arange(most, device=count.device), torch.arange(size, device=count.device)
        first, _, hole = self._unit(unit, size, count)
        first = (first + shift).minimum(size - hole)[..., None]
        is_in_hole = (at >= first) & (at < first + hole[..., None]) & (unit < count)[..., None]
        return is_in_hole.any(1)

    def _along(self, size: int, count: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of pixels along an axis with `count` (B, 1) units: how far it is in its unit, the unit, what a hole leaves, the hole."""
        at = torch.arange(size, device=count.device)
        unit = ((at + 1) * count - 1) // size
        first, side, hole = self._unit(unit, size, count)
        return at - first, unit, side - hole, hole

    @staticmethod
    def _at_offsets(offsets: Tensor, down: tuple[Tensor, ...], across: tuple[Tensor, ...]) -> Tensor:
        """Which pixels (B, H, W) are in holes, whose offsets (B, 2, R, C) are fractions of the free pixels of their units."""
        (y, row, free_y, tall), (x, column, free_x, wide) = down, across
        cells = row[:, :, None] * offsets.shape[3] + column[:, None]  # (B, H, W)
        u_y, u_x = (
            offsets.flatten(2)
            .gather(2, cells.flatten(1)[:, None].expand(-1, 2, -1))
            .unflatten(2, cells.shape[1:])
            .unbind(1)
        )
        y, x = (
            y[:, :, None] - (u_y * (free_y[:, :, None] + 1)).floor().minimum(free_y[:, :, None]),
            x[:, None] - (u_x * (free_x[:, None] + 1)).floor().minimum(free_x[:, None]),
        )
        return (y >= 0) & (y < tall[:, :, None]) & (x >= 0) & (x < wide[:, None])


class GridMask(DropoutBase, keeps_contract=True):
    """Fill the lines of a grid, at a random position and angle, with a value.

    Source: Chen and others, GridMask data augmentation, 2020, with the parameters of Albumentations.

    Args:
        num_grid_range: pair of the lowest and the highest number of cells along the shorter side, of at least 1.
        line_width_range: pair of the lowest and the highest width of lines, as fractions of a cell.
        rotation_range: pair of the lowest and the highest angle in radians, counter-clockwise.
        fill: the fill value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.
        fill_mask: the value of masks in lines; None leaves masks as they are.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> drop = K.augmentation.GridMask((2, 2), (0.25, 0.25), p=1.0)
        >>> drop(torch.ones(1, 1, 8, 8)).sum()
        tensor(36.)
    """

    def __init__(
        self,
        num_grid_range: tuple[int, int] = (3, 7),
        line_width_range: Numbers = (0.2, 0.5),
        rotation_range: Numbers = (0.0, 0.0),
        fill: Numbers | Literal["random"] = 0.0,
        fill_mask: float | None = 0.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(fill, fill_mask, p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "GridMask"
        self._param_generator = MappedGenerator(
            (line_width_range, "line_width", None, (0.0, 1.0)),
            (rotation_range, "rotation", None, (-2 * math.pi, 2 * math.pi)),
            ((0.0, 1.0), "offset_x", None, None),
            ((0.0, 1.0), "offset_y", None, None),
            integers={"num_grid": ranges.parse_integers(op, "num_grid_range", num_grid_range, 1)},
            maps=fill_maps(self.fill),
            op=op,
        )

    def is_dropped(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        height, width = shape[-2:]
        width_of_line, angle, offset_x, offset_y, number = (
            params[name].to(device).double()[:, None, None]
            for name in ("line_width", "rotation", "offset_x", "offset_y", "num_grid")
        )
        cell = (min(height, width) / number).floor().clamp(min=2)
        line = (cell * width_of_line).floor().clamp(min=1)
        center_y, center_x = (height - 1) / 2, (width - 1) / 2
        y = torch.arange(height, device=device)[:, None] - center_y
        x = torch.arange(width, device=device) - center_x
        cos, sin = angle.cos(), angle.sin()
        along_x = (cos * x - sin * y + center_x).round() - (offset_x * cell).floor()
        along_y = (sin * x + cos * y + center_y).round() - (offset_y * cell).floor()
        return ((along_x.remainder(cell) < line) | (along_y.remainder(cell) < line))[:, None]
