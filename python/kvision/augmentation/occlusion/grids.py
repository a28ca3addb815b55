"""Regular patterns that are dropped from images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant, on_device
from kvision.augmentation import ranges
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.erase import erase_grid
from kvision.augmentation.lists.pixels import given_maps
from kvision.augmentation.maps import as_batch
from kvision.augmentation.occlusion.dropout_base import ErasingDropout
from kvision.augmentation.occlusion.holes import HoleDropout
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.random_generator.occlusion import GridDropoutGenerator, Units, fill_maps, units_along
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.sample_rows import index_of
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
        like = torch.empty(0, device=device)
        units = _in_grid(
            *(
                constant(self._units(*axis), like, torch.float32)
                for axis in zip(shape[-2:], self._param_generator.counts(shape), reversed(self.shift_xy))
            )
        )
        if (unit_range := self._param_generator.unit_size_range) is not None:
            units = units[params["unit_size"].to(device).long() - unit_range[0]]
        return _boxes(units, params["offsets"].to(device) if "offsets" in params else None)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        """Images with fewer units than others have no holes in those at the end."""
        shapes = [(1, *x.shape) for x in images]
        counts = [self._param_generator.counts(shape) for shape in shapes]
        axes = []
        for axis, shift in zip((0, 1), reversed(self.shift_xy)):
            most, tables = max(max(own[axis]) for own in counts), []
            for shape, own in zip(shapes, counts):
                none = (0,) * (most - max(own[axis]))
                units = self._units(shape[axis - 2], own[axis], shift)
                tables.append([[[*row, *none] for row in unit] for unit in units])
            axes.append(on_device(torch.tensor(tables, dtype=torch.float32, device="cpu"), like.device))
        params = self._drawn_params(like, execution)
        if (unit_range := self._param_generator.unit_size_range) is None or "unit_size" not in params:
            axes = [units[:, 0] for units in axes]
        else:
            drawn = params["unit_size"]
            at = drawn.to(like.device).long() - unit_range[0]
            axes = [units[torch.arange(len(at), device=at.device), at] for units in axes]
        offsets = None
        if self._param_generator.random_offset:
            offsets = self._offsets_of_list(counts, execution, like.device)
        return self._erasing(_boxes(_in_grid(*axes), offsets), like, {})

    def _offsets_of_list(self, counts: list[Any], execution: Execution, device: torch.device) -> Tensor:
        whole, rows = execution.whole or (execution, None)
        if whole.params is not None:
            offsets = as_batch(given_maps(whole.params["offsets"], device, torch.float32))
            return offsets if rows is None else offsets.index_select(0, index_of(rows, offsets))
        noise = self._pixel_noise(whole, whole.redraw, device)
        if rows is None:
            return self._param_generator.offsets_of_list(noise, counts)
        offsets = self._param_generator.offsets_of_list(noise, [counts[rows.index(b)] for b in range(whole.shape[0])])
        return offsets.index_select(0, index_of(rows, offsets))

    def _units(self, size: int, counts: tuple[int, ...], shift: int) -> tuple[Units, ...]:
        """The units along an axis, for each of the numbers of them that there may be."""
        return units_along(size, counts, self.ratio, None if self._param_generator.random_offset else shift)


def _in_grid(down: Tensor, across: Tensor) -> Tensor:
    """Units (A, 4, R) and (A, 4, C) along both axes as tables (A, 4, 2, R, C)."""
    return torch.stack(torch.broadcast_tensors(down[..., None], across[..., None, :]), 2)


def _boxes(units: Tensor, offsets: Tensor | None) -> Tensor:
    """The holes (B, R C, 4) of units (B or 1, 4, 2, R, C), at offsets (B, 2, R, C) in [0, 1); None for the first position."""
    first, hole, free, places = units.unbind(1)
    if offsets is not None:
        first = first + (offsets * places).floor().minimum(free)
    (y, x), (tall, wide) = first.unbind(1), hole.unbind(1)
    return torch.stack(torch.broadcast_tensors(x, y, wide, tall), -1).flatten(1, 2)


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
