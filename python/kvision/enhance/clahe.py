"""Contrast-limited adaptive histogram equalization."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._ops import register, with_kernel_casts
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.enhance.batch import as_batch, images, parameter, shaped
from kvision.enhance.equalize import LEVELS, level_counts, levels
from kvision.enhance.histogram import kernel_counts

_BANDWIDTH = 0.001  # of the smooth histogram; neighboring levels are 0.0039 apart


def _reference(
    x: Tensor, clip_limits: Tensor | None, clip_limit: float, rows: int, columns: int, opencv: bool
) -> Tensor:
    """Equalize every plane of (B, C, H, W) separately, with limits (B or 1, C or 1, 1), or one if these are None."""
    tile = _tile(x, rows, columns, opencv)
    tiles = _split(x.flatten(0, 1), rows, columns, tile)
    counts = level_counts(levels(tiles), ~tiles.isnan()).to(compute_dtype(x))
    limit = _limit_of_counts(x, clip_limits, clip_limit, rows * columns, tile[0] * tile[1])
    return _mapped(x, _tables(counts, limit, tile[0] * tile[1]).round(), rows, columns, tile, opencv)


_equalize_clahe = register(
    "equalize_clahe",
    _reference,
    gradients="input: equalize_backward(output=result, changed=None)",
    native_half=True,
    bytes=True,
    levels=255,
    clamps=True,
)


def _reference_smooth(x: Tensor, clip_limits: Tensor | None, clip_limit: float, rows: int, columns: int) -> Tensor:
    """Equalize from smooth histograms with tables that are not rounded, so that there is a gradient."""
    tile = _tile(x, rows, columns, False)
    counts = _smooth_counts(_split(x.flatten(0, 1), rows, columns, tile))
    limit = _limit_of_counts(x, clip_limits, clip_limit, rows * columns, tile[0] * tile[1])
    return _mapped(x, _tables(counts, limit, tile[0] * tile[1]), rows, columns, tile, False)


_equalize_clahe_smooth = with_kernel_casts(_reference_smooth, native_half=True, levels=255)


def _tile(x: Tensor, rows: int, columns: int, opencv: bool) -> tuple[int, int]:
    """The size of the tiles. If one axis is not a multiple of its tiles, OpenCV pads both axes."""
    h, w = x.shape[2:]
    if opencv and (h % rows or w % columns):
        return h // rows + 1, w // columns + 1
    return -(-h // rows), -(-w // columns)


def _mapped(x: Tensor, tables: Tensor, rows: int, columns: int, tile: tuple[int, int], opencv: bool) -> Tensor:
    """Map each pixel by the tables (B * C * tiles, 256) of the four tiles whose centers surround it."""
    planes = x.flatten(0, 1)
    n, h, w = planes.shape
    tables = tables.reshape(n, rows * columns * LEVELS)
    pixel_center = 0.0 if opencv else 0.5
    y0, y1, wy = _neighbors(h, rows, tile[0], pixel_center, tables)
    x0, x1, wx = _neighbors(w, columns, tile[1], pixel_center, tables)
    level = levels(planes)

    def mapped(ty: Tensor, tx: Tensor) -> Tensor:
        index = (ty[:, None] * columns + tx) * LEVELS + level
        return tables.gather(1, index.flatten(1)).reshape(n, h, w)

    top = mapped(y0, x0) * (1 - wx) + mapped(y0, x1) * wx
    bottom = mapped(y1, x0) * (1 - wx) + mapped(y1, x1) * wx
    wy = wy[:, None]
    mixed = top * (1 - wy) + bottom * wy  # OpenCV's order, which decides ties of rounding
    y = ((mixed.round() if opencv else mixed) / 255).to(x.dtype).reshape(x.shape)
    return torch.where(x.isnan(), x, y)


def _split(x: Tensor, rows: int, columns: int, tile: tuple[int, int]) -> Tensor:
    """Pad (N, H, W) by reflection and split it into (N * rows * columns, pixels of a tile)."""
    n, h, w = x.shape
    x = x[:, _reflected(h, rows * tile[0], x)][:, :, _reflected(w, columns * tile[1], x)]
    return x.reshape(n, rows, tile[0], columns, tile[1]).transpose(2, 3).reshape(n * rows * columns, tile[0] * tile[1])


def _reflected(size: int, padded: int, x: Tensor) -> Tensor:
    """Indices 0 to padded - 1, reflected at both ends of `size` pixels as often as necessary."""
    period = max(2 * (size - 1), 1)
    i = torch.arange(padded, device=x.device) % period
    return torch.minimum(i, period - i) if size > 1 else torch.zeros_like(i)


def _neighbors(size: int, count: int, tile: int, pixel_center: float, like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For every pixel of an axis: the tile before it, the tile after it, and the weight of the latter."""
    center = (torch.arange(size, device=like.device, dtype=like.dtype) + pixel_center) * (1 / tile) - 0.5
    before = center.floor()
    first, second = before.long().clamp(min=0), (before.long() + 1).clamp(max=count - 1)
    return first, second, center - before


def _limit_of_counts(
    x: Tensor, clip_limits: Tensor | None, clip_limit: float, tiles: int, pixels: int
) -> float | Tensor | None:
    """The limit of the counts of tiles of so many pixels: a number, None for none, or (T, 1) with infinity for none."""
    if clip_limits is None:
        return max(clip_limit * pixels // LEVELS, 1) if clip_limit > 0 else None
    clip = clip_limits.detach().double().expand(*x.shape[:2], 1).reshape(-1, 1)
    limit = torch.where(clip > 0, (clip * pixels / LEVELS).floor().clamp(min=1), torch.inf)
    return limit.repeat_interleave(tiles, 0).to(compute_dtype(x))


def _tables(counts: Tensor, limit: float | Tensor | None, pixels: int) -> Tensor:
    """Tables from level to level: counts (T, 256) above the limit are redistributed, then accumulated."""
    if limit is not None:
        excess = (counts - limit).relu().sum(1, keepdim=True)
        rest = excess % LEVELS
        # OpenCV adds an equal amount to every level, and the remainder one by one to levels at equal distances.
        distance = torch.div(LEVELS, rest.detach().clamp(min=1), rounding_mode="floor").clamp(min=1)
        level = torch.arange(LEVELS, device=counts.device)
        spared = (level % distance == 0) & (torch.div(level, distance, rounding_mode="floor") < rest)
        counts = counts.clamp(max=limit) + torch.div(excess - rest, LEVELS) + spared.to(counts.dtype)
    return clamp(counts.cumsum(1) * (255 / pixels), 0, 255)


def _smooth_counts(tiles: Tensor) -> Tensor:
    bins = torch.linspace(0, 1, LEVELS, device=tiles.device, dtype=compute_dtype(tiles))
    counts = (
        kernel_counts(tiles.to(bins.dtype), bins, torch.full_like(bins[0], _BANDWIDTH), "gaussian") / tiles.shape[1]
    )
    return counts / (counts.sum(1, keepdim=True) + 1e-10) * tiles.shape[1]


def equalize_clahe(
    input: Tensor,
    clip_limit: float | Tensor = 40.0,
    grid_size: tuple[int, int] = (8, 8),
    slow_and_differentiable: bool = False,
    opencv: bool = False,
) -> Tensor:
    """Equalize the histogram of every image plane tile by tile, with a limit on the contrast (CLAHE).

    The plane, continued by reflection, is covered by a grid of tiles of equal size. A pixel is mapped by the tables of
    the four nearest tiles, mixed by its distance from their centers.

    Args:
        input: (*, C, H, W), floating point, in [0, 1], or uint8. A value x has the level floor(255 x); values outside
            count as 0 or 1, and NaN does not count.
        clip_limit: maximum count of a level in a tile, as a multiple of the mean count; 0 for no limit. A number, or a
            tensor with the first axes of the image, (B,) or (B, C), which gets no gradient.
        grid_size: tiles along (y, x). Any grid fits any image.
        slow_and_differentiable: count with a smooth kernel, so that the tables have a gradient.
        opencv: return the result of `cv2.createCLAHE` for the bytes 255 x, divided by 255: the centers of tiles are
            half a pixel later, both axes are padded if one is not a multiple of its tiles, and the result is rounded
            to a level. Not with slow_and_differentiable.

    Returns:
        The equalized image, in [0, 1]; in [0, 255], rounded half to even, of uint8.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8; clip_limit neither number nor tensor; grid_size is not of
            ints.
        ShapeError: input is not (*, C, H, W), or has no pixels; clip_limit has axes that the image has not, or one a pixel.
        ValueCheckError: a number clip_limit below 0; grid_size below 1; opencv with slow_and_differentiable.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: K. Zuiderveld, "Contrast limited adaptive histogram equalization" (1994).

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.equalize_clahe(torch.rand(2, 3, 40, 60), 4.0, (4, 4)).shape
        torch.Size([2, 3, 40, 60])
    """
    images("equalize_clahe", "input", input)
    limit = parameter("equalize_clahe", "clip_limit", clip_limit, input, minimum=0)
    if isinstance(limit, Tensor) and limit.dim() != 3:
        raise ShapeError(
            f"equalize_clahe: expected one clip_limit for all pixels of a channel, got {tuple(limit.shape)}",
            actual_shape=limit.shape,
        )
    if not isinstance(grid_size, (tuple, list)):
        raise TypeCheckError(f"equalize_clahe: expected grid_size to be (y, x), got {grid_size!r}")
    rows, columns = _check.pair("equalize_clahe", "grid_size", tuple(grid_size), maximum=_check.LARGEST_INT)
    _check.flag("equalize_clahe", "slow_and_differentiable", slow_and_differentiable)
    _check.flag("equalize_clahe", "opencv", opencv)
    x = as_batch(input)
    limits = (limit.to(compute_dtype(x)), 0.0) if isinstance(limit, Tensor) else (None, limit)
    if not slow_and_differentiable:
        return shaped(_equalize_clahe(x, *limits, rows, columns, opencv), input)
    if opencv:
        raise ValueCheckError("equalize_clahe: expected opencv without slow_and_differentiable, got both")
    return shaped(_equalize_clahe_smooth(x, *limits, rows, columns), input)
