"""Maps: where the pixels of a result read an image.

A map is stored as displacements (B, 2, H, W), x and y in pixels: pixel p of the result reads the image at p + displacement.
Between pixels displacements are interpolated bilinearly, and out of bounds they have the replicate border. So a map is
defined everywhere, and `composed_warp` resamples an image by a chain of maps and matrices at once. Coordinates (B, h, w, 2) are
the sampling coordinates of the pixels of a result of any size. Matrices are read by warps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._constants import constant
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import INTERPOLATION, PADDING
from kvision.augmentation.warp_and_color import Resampling, fill_of_images
from kvision.geometry.transform import sampling
from kvision.geometry.transform.antialiased.warp_antialiased import remap_antialiased, warp_antialiased
from kvision.geometry.transform.composed.composed_warp import composed_coords, composed_warp, link_arguments
from kvision.geometry.transform.composed.link_coords_list import composed_coords_list
from kvision.geometry.transform.lists.arguments import images_of, largest_shape, like_batch
from kvision.geometry.transform.lists.remap_list import remap_list
from kvision.geometry.transform.lists.resize_windows_list import resize_windows_list
from kvision.geometry.transform.lists.warp_antialiased_list import warp_antialiased_list
from kvision.geometry.transform.lists.warp_list import warp_list
from kvision.geometry.transform.resize_windows import resized_windows

_STEPS, _GUESSES = 20, 32  # of Newton's method, which begins at the best of 32 x 32 pixels
IDENTITY = (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),)
_BETWEEN = INTERPOLATION["bilinear"], PADDING["border"], True  # how displacements are read

# --- reading images -------------------------------------------------------------------------------------------------


def read_displaced(x: Tensor, displacements: Tensor, resampling: Resampling) -> Tensor:
    """Images (B, C, H, W) read by a map of their size."""
    return _read(x, displacements.unbind(1), resampling, fill_of_images(x, resampling.fill), displaces=True)


def read_displaced_list(
    images: Sequence[Tensor], displacements: Tensor, resampling: Resampling, by_channel: bool = False
) -> list[Tensor]:
    """Images (C, H, W) of different sizes read by maps, of each or of each of their channels, as `remap_list` takes them."""
    return _read_list(images, displacements, resampling, fill_of_images(images[0], resampling.fill), (), by_channel)


def read_labels_displaced_list(masks: Sequence[Tensor], displacements: Tensor, resampling: Resampling) -> list[Tensor]:
    """Masks (N, H, W) of any type and of different sizes read by a map of each."""
    moved = _read_list(exact_each(masks), displacements, resampling, resampling.fill)
    return as_type_of_each(moved, masks[0].dtype)


def _read_list(
    images: Sequence[Tensor],
    maps: Tensor,
    resampling: Resampling,
    fill: object,
    sizes: Sequence[int] = (),
    by_channel: bool = False,
) -> list[Tensor]:
    """Images (C, H, W) read by displacements or, with height and width of each result, at the coordinates of these."""
    like = like_batch(images)
    padding, fill_values = sampling.padding_and_fill("augmentation", like, resampling.padding, fill)
    options = (list(sizes), INTERPOLATION[resampling.mode], padding, resampling.align_corners, by_channel)
    return list(remap_list(list(images), maps.to(compute_dtype(like)), fill_values, *options))


def as_batch(layers: Sequence[Tensor]) -> Tensor:
    """Layers (C, H, W) of different sizes as one tensor (B, C, H, W) of the largest sides, 0 beyond each."""
    identity = constant(IDENTITY, layers[0], compute_dtype(layers[0]))
    options = (INTERPOLATION["nearest"], PADDING["fill"], True, False, False)
    return warp_list(list(layers), identity, None, list(largest_shape(layers)[2:]), *options)[0]


def read(x: Tensor, coordinates: Tensor, resampling: Resampling, antialias: bool = False) -> Tensor:
    """Images (B, C, H, W) at coordinates (B, h, w, 2); with `antialias` means of what pixels cover, as `remap` has them."""
    return _read(x, coordinates.unbind(-1), resampling, fill_of_images(x, resampling.fill), antialias=antialias)


def read_labels(masks: Tensor, coordinates: Tensor, resampling: Resampling) -> Tensor:
    """Masks (B, C, H, W) of any type at coordinates (B, h, w, 2)."""
    return _read(exact(masks), coordinates.unbind(-1), resampling, resampling.fill).to(masks.dtype)


def read_labels_displaced(masks: Tensor, displacements: Tensor, resampling: Resampling) -> Tensor:
    """Masks (B, C, H, W) of any type read by a map of their size."""
    moved = _read(exact(masks), displacements.unbind(1), resampling, resampling.fill, displaces=True)
    return moved.to(masks.dtype)


def read_composed(
    x: Tensor, links: Sequence[Tensor], size: Sequence[int], resampling: Resampling, antialias: bool = False
) -> Tensor:
    """Resample images (B, C, H, W) by a chain of links, the first one first; `antialias` as in `read`."""
    if not antialias:
        return _read_composed(x, links, size, resampling, fill_of_images(x, resampling.fill))
    coordinates = composed_coords(*link_arguments(links, size), list(size)).movedim(1, -1)
    return read(x, coordinates, resampling, antialias)


def read_composed_list(
    images: Sequence[Tensor],
    links: Sequence[tuple[Tensor, Sequence[int]]],
    sizes: Sequence[int],
    resampling: Resampling,
) -> list[Tensor]:
    """Images (C, H, W) of a list read by a chain of links, as `composed_coords_list` takes them, for the size of each result."""
    fill = fill_of_images(images[0], resampling.fill)
    return _read_list(images, composed_coords_list(links, sizes), resampling, fill, sizes)


def read_labels_composed_list(
    masks: Sequence[Tensor],
    links: Sequence[tuple[Tensor, Sequence[int]]],
    sizes: Sequence[int],
    resampling: Resampling,
) -> list[Tensor]:
    """The same of masks (N, H, W) of any type."""
    coordinates = composed_coords_list(links, sizes)
    return as_type_of_each(
        _read_list(exact_each(masks), coordinates, resampling, resampling.fill, sizes), masks[0].dtype
    )


def warp_covered(x: Tensor, matrix: Tensor, size: Sequence[int], resampling: Resampling) -> Tensor:
    """Resample images by matrices from their pixels to those of the result, with the antialiasing of `warp_perspective`."""
    padding, fill = sampling.padding_and_fill("augmentation", x, resampling.padding, fill_of_images(x, resampling.fill))
    matrix = matrix.to(compute_dtype(x))
    y: Tensor = warp_antialiased(x, matrix, fill, None, list(size), padding, resampling.align_corners, True, False)
    return y


def warp_covered_each(
    images: Sequence[Tensor], matrix: Tensor, size: Sequence[int], resampling: Resampling
) -> Sequence[Tensor]:
    """`warp_covered` of a list of images (C, H, W), with the results of `warp_each`."""
    like = like_batch(images)
    fill = fill_of_images(like, resampling.fill)
    padding, fill_values = sampling.padding_and_fill("augmentation", like, resampling.padding, fill)
    options = (padding, resampling.align_corners, True, False)
    matrix = matrix.to(like.device, compute_dtype(like))
    return warp_antialiased_list(list(images), matrix, fill_values, list(size), *options)


def read_labels_composed(masks: Tensor, links: Sequence[Tensor], size: Sequence[int], resampling: Resampling) -> Tensor:
    """Resample masks (B, C, H, W) of any type by a chain of links."""
    values = exact(masks)
    if links[0].dtype != compute_dtype(values):  # to convert coordinates takes less memory than to convert links
        return read_labels(masks, composed_coords(*link_arguments(links, size), list(size)).movedim(1, -1), resampling)
    return as_dtype(_read_composed(values, links, size, resampling, resampling.fill), masks.dtype)


def exact(masks: Tensor) -> Tensor:
    """Masks in a type that warps read and that holds all their values: float64 holds all integers up to 2^53."""
    return as_dtype(masks, _exact_type(masks.dtype))


def exact_each(masks: Sequence[Tensor]) -> list[Tensor]:
    """The same of a list of one type, by the launches of one conversion."""
    return as_type_of_each(masks, _exact_type(masks[0].dtype))


def as_type_of_each(masks: Sequence[Tensor], dtype: torch.dtype) -> list[Tensor]:
    """Masks of a list of one type in another one."""
    if masks[0].dtype == dtype:
        return list(masks)
    values = torch.cat([mask.flatten() for mask in masks]).to(dtype)
    return [own.view(mask.shape) for own, mask in zip(values.split([mask.numel() for mask in masks]), masks)]


def _exact_type(dtype: torch.dtype) -> torch.dtype:
    if dtype.is_floating_point or dtype == torch.uint8:
        return dtype
    return torch.float32 if dtype in (torch.bool, torch.int8, torch.int16) else torch.float64


def _read(
    x: Tensor,
    coordinates: Sequence[Tensor],
    resampling: Resampling,
    fill: object,
    displaces: bool = False,
    antialias: bool = False,
) -> Tensor:
    padding, fill_values = sampling.padding_and_fill("augmentation", x, resampling.padding, fill)
    map_x, map_y = (along.to(compute_dtype(x)) for along in coordinates)
    options: tuple[Any, ...] = (padding, resampling.align_corners, False, displaces)
    remap: Any = remap_antialiased
    if not antialias:
        remap, options = sampling.remap, (INTERPOLATION[resampling.mode], *options)
    y: Tensor = remap(x, map_x, map_y, fill_values, None, *options)
    return y


def _read_composed(
    x: Tensor, links: Sequence[Tensor], size: Sequence[int], resampling: Resampling, fill: object
) -> Tensor:
    padding, fill_values = sampling.padding_and_fill("augmentation", x, resampling.padding, fill)
    options = (INTERPOLATION[resampling.mode], padding, resampling.align_corners)
    y: Tensor = composed_warp(x, *link_arguments(links, size), fill_values, list(size), *options)
    return y


# --- positions ------------------------------------------------------------------------------------------------------


def vector(like: Tensor, *values: float) -> Tensor:
    """A vector that is filled on its device, without a copy from the host."""
    return torch.stack([like.new_full((), value) for value in values])


def pixel_positions(height: int, width: int, like: Tensor) -> Tensor:
    """(1, H W, 2): x and y of the pixels, row by row."""
    y, x = (torch.arange(n, dtype=like.dtype, device=like.device) for n in (height, width))
    return torch.stack([x.expand(height, width), y[:, None].expand(height, width)], -1).reshape(1, -1, 2)


def read_positions(displacements: Tensor, points: Tensor) -> Tensor:
    """Where a map reads the image for points (B, N, 2) or (B, h, w, 2) of its result."""
    x, y = (points if points.dim() == 4 else points[:, None]).unbind(-1)
    moved = sampling.remap(displacements.to(points), x, y, None, None, *_BETWEEN, False, False)
    return points + moved.movedim(1, -1).reshape(points.shape)


# --- the inverse ----------------------------------------------------------------------------------------------------


def find_positions(displacements: Tensor, points: Tensor) -> Tensor:
    """Where the pixels of a result are that read an image at `points` (B, N, 2), by Newton's method.

    Where the map folds, one of several positions is found; for points that no pixel reads, the nearest that the method comes
    to.
    """
    h, w = displacements.shape[-2:]
    rows, columns = _coarse(h, w, points)
    pixels = torch.stack([columns.expand(len(rows), -1), rows[:, None].expand(-1, len(columns))], -1)
    known = displacements[:, :, rows][..., columns].flatten(2).mT.to(points) + pixels.flatten(0, 1)  # (B, G, 2)
    best = torch.cdist(points, known).argmin(-1)
    at = torch.stack([columns[best % len(columns)], rows[best // len(columns)]], -1).to(points)
    return _newton(displacements, points, at)


def find_everywhere(displacements: Tensor, coordinates: Tensor) -> tuple[Tensor, Tensor]:
    """Where the pixels of a result are that read an image at coordinates (B, h, w, 2), and which are there, bool (B, h, w).

    A coarse grid of coordinates is searched for, and the method begins between these for all.
    """
    h, w = coordinates.shape[1:3]
    rows, columns = _coarse(h, w, coordinates)
    positions = find_positions(displacements, coordinates[:, rows][:, :, columns].flatten(1, 2))
    coarse = positions.mT.unflatten(2, (len(rows), len(columns)))
    start = F.interpolate(coarse, (h, w), mode="bilinear", align_corners=True).movedim(1, -1)
    at = _newton(displacements, coordinates, start)
    return at, (read_positions(displacements, at) - coordinates).abs().amax(-1) < 0.5


def _coarse(height: int, width: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """Rows and columns of a coarse grid of pixels."""
    rows, columns = (
        torch.linspace(0, n - 1, min(n, _GUESSES), device=like.device).round().long() for n in (height, width)
    )
    return rows, columns


def _newton(displacements: Tensor, points: Tensor, at: Tensor) -> Tensor:
    """Where the map reads points (B, N, 2) or (B, h, w, 2), by steps that begin at positions `at` near them."""
    h, w = displacements.shape[-2:]
    step_x, step_y = vector(at, 0.5, 0.0), vector(at, 0.0, 0.5)
    for _ in range(_STEPS):
        miss = points - read_positions(displacements, at)
        along, down = (
            read_positions(displacements, at + step) - read_positions(displacements, at - step)
            for step in (step_x, step_y)
        )
        determinant = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
        determinant = torch.where(determinant.abs() < 1e-3, 1e-3, determinant)
        move = (
            torch.stack(
                [
                    miss[..., 0] * down[..., 1] - miss[..., 1] * down[..., 0],
                    miss[..., 1] * along[..., 0] - miss[..., 0] * along[..., 1],
                ],
                -1,
            )
            / determinant[..., None]
        )
        at = at + move.clamp(-max(h, w) / 8, max(h, w) / 8)
    return at


# --- by matrices ----------------------------------------------------------------------------------------------------


def warp(x: Tensor, matrix: Tensor, size: Sequence[int], resampling: Resampling, inverse: bool = True) -> Tensor:
    """Resample images by matrices from their pixels to those of the result, or the other way for `inverse` = False."""
    padding, fill = sampling.padding_and_fill("augmentation", x, resampling.padding, fill_of_images(x, resampling.fill))
    return _warp(x, matrix, size, resampling, padding, fill, inverse)


def _warp(
    x: Tensor,
    matrix: Tensor,
    size: Sequence[int],
    resampling: Resampling,
    padding: int,
    fill: Tensor | None,
    inverse: bool,
) -> Tensor:
    mode, _, align_corners, *_ = resampling
    matrix = matrix.to(compute_dtype(x))
    if resampling.antialias:
        resized: Tensor = resized_windows(x, matrix, list(size), INTERPOLATION[mode], align_corners)
        return resized
    options = (INTERPOLATION[mode], padding, align_corners, inverse, False)
    y: Tensor = sampling.warp(x, matrix, fill, None, list(size), *options)
    return y


def warp_labels(
    masks: Tensor, matrix: Tensor, size: Sequence[int], resampling: Resampling, inverse: bool = True
) -> Tensor:
    """The same for masks of any type, whose values pass unchanged: float64 holds all integers up to 2^53."""
    values = exact(masks)
    padding, fill = sampling.padding_and_fill("augmentation", values, resampling.padding, resampling.fill)
    return _warp(values, matrix, size, resampling, padding, fill, inverse).to(masks.dtype)


def warp_each(
    images: list[Tensor], matrix: Tensor, size: Sequence[int], resampling: Resampling, inverse: bool = True
) -> Sequence[Tensor]:
    """`warp` of a list of images (C, H, W): one tensor (B, C, h, w), or, with the size of each, one of each image."""
    like = like_batch(images)
    matrix, mode = matrix.to(like.device, compute_dtype(like)), INTERPOLATION[resampling.mode]
    if resampling.antialias:
        return resize_windows_list(images, matrix, list(size), mode, resampling.align_corners)
    padding, fill = sampling.padding_and_fill("augmentation", like, resampling.padding, resampling.fill)
    return warp_list(images, matrix, fill, list(size), mode, padding, resampling.align_corners, inverse, False)


def warp_to_sizes(
    images: list[Tensor], matrix: Tensor, sizes: Sequence[int], resampling: Resampling, inverse: bool = True
) -> list[Tensor]:
    """`warp_each` for the height and width of each: an image (C, h, w) of each, also of one by itself."""
    return images_of(warp_each(images, matrix, sizes, resampling, inverse))
