"""Regular patterns that are dropped from images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision.augmentation import ranges
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.erase import erase_grid
from kvision.augmentation.occlusion.dropout_base import ErasingDropout
from kvision.augmentation.occlusion.holes import HoleDropout
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.random_generator.occlusion import GridDropoutGenerator, fill_maps, units_along
from kvision.augmentation.ranges import Numbers
from kvision.geometry.transform.lists.kept_sizes import Operation


class GridDropout(HoleDropout, keeps_contract=True):
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

    def _parts(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        counts, at = self._param_generator.counts(shape), None
        if (unit_range := self._param_generator.unit_size_range) is not None:
            at = params["unit_size"].to(device).long() - unit_range[0]
        offsets = params["offsets"].to(device).unbind(1) if "offsets" in params else (None, None)
        (y, tall), (x, wide) = (
            self._along(*axis, at, device)
            for axis in zip(shape[-2:], counts, offsets, reversed(self.shift_xy), (-1, -2))
        )
        return torch.stack(torch.broadcast_tensors(x, y, wide, tall), -1).flatten(1, 2)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        shapes = [(1, *x.shape) for x in images]
        counts, at = [self._param_generator.counts(shape) for shape in shapes], None
        if (unit_range := self._param_generator.unit_size_range) is not None and execution.columns is not None:
            drawn = self._named(execution.columns.values, execution)["unit_size"]
            at = drawn.to(like.device).long() - unit_range[0]
        offsets: Sequence[Tensor | None] = (None, None)
        if self._param_generator.random_offset:
            noise = self._pixel_noise(execution, execution.redraw, like.device)
            offsets = self._param_generator.offsets_of_list(noise, counts).unbind(1)
        (y, tall), (x, wide) = (
            self._along_list(
                [shape[axis] for shape in shapes], [own[axis] for own in counts], u, shift, -3 - axis, at, like
            )
            for axis, u, shift in zip((-2, -1), offsets, reversed(self.shift_xy))
        )
        boxes = torch.stack(torch.broadcast_tensors(x, y, wide, tall), -1).flatten(1, 2)
        return self._erasing(boxes, like, {})

    def _along_list(
        self,
        sizes: Sequence[int],
        counts: Sequence[tuple[int, ...]],
        u: Tensor | None,
        shift: int,
        axis: int,
        at: Tensor | None,
        like: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """As `_along`, of images with sizes and numbers of units of their own, those with fewer without holes at the end."""
        most, tables = max(map(max, counts)), []
        for size, own_counts in zip(sizes, counts):
            none = (0,) * (most - max(own_counts))
            tables.append([[[*row, *none] for row in units] for units in units_along(size, own_counts, self.ratio)])
        own = torch.tensor(tables, dtype=torch.float32, device="cpu").to(like.device, non_blocking=True)
        own = own[:, 0] if at is None else own[torch.arange(len(own), device=own.device), at]
        ends = torch.tensor(sizes, dtype=torch.float32, device="cpu").to(like.device, non_blocking=True)
        return _placed(own, ends[:, None, None], u, shift, axis)

    def _along(
        self,
        size: int,
        counts: tuple[int, ...],
        u: Tensor | None,
        shift: int,
        axis: int,
        at: Tensor | None,
        device: Any,
    ) -> tuple[Tensor, Tensor]:
        """Where holes begin along an axis, and how long they are, as tables (B, R, C) by the units of the grid.

        Args:
            size: pixels.
            counts: numbers of units; `at` (B,) says which of them a sample has.
            u: the offsets (B, R, C) of holes, as fractions of the free pixels of their units; None for a shift.
            axis: the axis of the table along which there is nothing to tell.
        """
        table = constant(units_along(size, counts, self.ratio), torch.empty(0, device=device), torch.float32)
        return _placed(table if at is None else table[at], size, u, shift, axis)


def _placed(units: Tensor, size: int | Tensor, u: Tensor | None, shift: int, axis: int) -> tuple[Tensor, Tensor]:
    """Where holes begin along an axis of images of a size, and how long they are, for the numbers (B, 3, units) of units."""
    first, hole, free = units.unsqueeze(axis).unbind(1)
    if u is None:
        return (first + shift).minimum(size - hole), hole
    return first + (u * (free + 1)).floor().minimum(free), hole


class GridMask(ErasingDropout, keeps_contract=True):
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

    eraser = erase_grid

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

    def _parts(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        names = ("line_width", "rotation", "offset_x", "offset_y", "num_grid")
        return torch.stack([params[name].to(device, torch.float32) for name in names], 1)
