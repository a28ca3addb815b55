"""Warps of images by matrices and maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from torch import Tensor

from kvision import _check
from kvision._choices import Interpolation, Padding, PaddingOrFill
from kvision._dtype import floats
from kvision._modes import INTERPOLATION
from kvision.color.frames import Frames
from kvision.core.exceptions import ShapeError
from kvision.geometry._transform_points import transformed
from kvision.geometry.transform import sampling
from kvision.geometry.transform.antialiased.warp_antialiased import (
    check_antialias,
    remap_antialiased,
    warp_antialiased,
)
from kvision.geometry.transform.frames import check_frames, reading_of, warped_frames
from kvision.geometry.transform.lists.arguments import check_list
from kvision.geometry.transform.lists.warp_list import warped
from kvision.geometry.transform.nearest import as_values, of_values

__all__ = ["homography_warp", "remap", "warp_affine", "warp_grid", "warp_perspective"]

_PADDINGS = get_args(Padding)


def warp_perspective(
    src: Tensor | list[Tensor] | Frames,
    M: Tensor,
    dsize: tuple[int, int],
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
    fill_value: Tensor | Sequence[float] | float | None = None,
    antialias: bool = False,
) -> Tensor:
    """Warp images by homographies from their pixels to those of the result.

    The pixel (x, y) of the result is the image sampled at M^-1 (x, y, 1). A multiple of M is the same warp.
    Sampling coordinates are computed in float32, for float64 images in float64.

    Args:
        src: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them. A list of images (C, H, W) may have different sizes. Of video
            :class:`~kvision.color.Frames` 'bilinear' and 'nearest' with 'zeros' or 'border' read the planes; others convert
            them first.
        M: (B, 3, 3), or (1, 3, 3) for all images; one image also serves many matrices. Pixels are (x, y); the center of
            the first one is (0, 0).
        dsize: height and width of the result.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: values out of bounds: 'zeros', 'border' (replicates the outermost pixels), 'reflection', or 'fill'
            for `fill_value`.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Ignored by padding modes other
            than 'reflection'.
        fill_value: a number, (C,) for one per channel, or (B, C, 1, 1); None for 0.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers, as `resize` does with
            `antialias`; see :doc:`/conventions`. Only with 'bilinear'.

    Returns:
        (B, C, h, w), of the dtype of `src`; uint8 is rounded half to even and saturated.

    Raises:
        TypeError: `src` or `M` is not a tensor of real numbers; `dsize` is not two ints; `align_corners` or `antialias`
            is not a bool.
        ValueError: `src` is not (B, C, H, W), or a list without images or of different types, devices or numbers of
            channels; `M` is not (B, 3, 3) or (1, 3, 3); an entry of `dsize` is below 1; `mode`
            or `padding_mode` is unknown; `fill_value` has none of these shapes; `antialias` with another mode than
            'bilinear'; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(6.0).reshape(1, 1, 2, 3)
        >>> right = torch.tensor([[[1.0, 0, 1], [0, 1, 0], [0, 0, 1]]])
        >>> K.geometry.warp_perspective(image, right, (2, 3))
        tensor([[[[0., 0., 1.],
                  [0., 3., 4.]]]])
    """
    return _warp("warp_perspective", src, M, 3, dsize, mode, padding_mode, align_corners, fill_value, antialias)


def warp_affine(
    src: Tensor | list[Tensor] | Frames,
    M: Tensor,
    dsize: tuple[int, int],
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
    fill_value: Tensor | Sequence[float] | float | None = None,
    antialias: bool = False,
) -> Tensor:
    """Warp images by affine matrices from their pixels to those of the result.

    The pixel (x, y) of the result is the image sampled at M^-1 (x, y, 1), with (0, 0, 1) as third row of M.
    Sampling coordinates are computed in float32, for float64 images in float64.

    Args:
        src: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them. A list of images (C, H, W) may have different sizes. Of video
            :class:`~kvision.color.Frames` 'bilinear' and 'nearest' with 'zeros' or 'border' read the planes; others convert
            them first.
        M: (B, 2, 3), or (1, 2, 3) for all images; one image also serves many matrices. Pixels are (x, y); the center of
            the first one is (0, 0).
        dsize: height and width of the result.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: values out of bounds: 'zeros', 'border' (replicates the outermost pixels), 'reflection', or 'fill'
            for `fill_value`.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Ignored by padding modes other
            than 'reflection'.
        fill_value: a number, (C,) for one per channel, or (B, C, 1, 1); None for 0.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers, as `resize` does with
            `antialias`; see :doc:`/conventions`. Only with 'bilinear'.

    Returns:
        (B, C, h, w), of the dtype of `src`; uint8 is rounded half to even and saturated.

    Raises:
        TypeError: `src` or `M` is not a tensor of real numbers; `dsize` is not two ints; `align_corners` or `antialias`
            is not a bool.
        ValueError: `src` is not (B, C, H, W), or a list without images or of different types, devices or numbers of
            channels; `M` is not (B, 2, 3) or (1, 2, 3); an entry of `dsize` is below 1; `mode`
            or `padding_mode` is unknown; `fill_value` has none of these shapes; `antialias` with another mode than
            'bilinear'; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(6.0).reshape(1, 1, 2, 3)
        >>> half_right = torch.tensor([[[1.0, 0, 0.5], [0, 1, 0]]])
        >>> K.geometry.warp_affine(image, half_right, (2, 3), padding_mode="border")
        tensor([[[[0.0000, 0.5000, 1.5000],
                  [3.0000, 3.5000, 4.5000]]]])
    """
    return _warp("warp_affine", src, M, 2, dsize, mode, padding_mode, align_corners, fill_value, antialias)


def _warp(op, src, M, rows, dsize, mode, padding_mode, align_corners, fill_value, antialias):
    is_list, is_video = isinstance(src, list), isinstance(src, Frames)
    if is_list:
        src = check_list(op, "src", src)
    elif is_video:
        check_frames(op, "src", src)
    else:
        _check.images(op, "src", src)
    _check.shape(op, "M", M, "B", rows, 3)
    size = _check.ints(op, "dsize", dsize, 2)
    sampling.check_options(op, mode, padding_mode, align_corners)
    check_antialias(op, antialias, mode)
    if is_video:
        reading = reading_of(mode, padding_mode, fill_value, antialias, False)
        if reading is not None:
            return warped_frames(op, src, "M", M, size, reading)
        src = src.rgb()
    if is_list:
        options = (mode, padding_mode, align_corners, fill_value)
        return warped(op, src, "M", M, list(size), *options, inverse=True, antialias=antialias)
    image, samples = as_values(src, mode), sampling.count_samples(src, M)
    matrix = sampling.cast_to_image(op, image, "M", M, samples)
    padding, fill = sampling.padding_and_fill(op, src, padding_mode, fill_value, samples, mode)
    options = (padding, align_corners, True, False)
    if antialias:
        return of_values(warp_antialiased(image, matrix, fill, None, list(size), *options), src, mode)
    return of_values(sampling.warp(image, matrix, fill, None, list(size), INTERPOLATION[mode], *options), src, mode)


def homography_warp(
    patch_src: Tensor,
    src_homo_dst: Tensor,
    dsize: tuple[int, int],
    mode: Interpolation = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = False,
    normalized_coordinates: bool = True,
    normalized_homography: bool = True,
) -> Tensor:
    """Warp images by homographies from coordinates in the result to coordinates in the image, from -1 to 1.

    This is the inverse of the matrix that :func:`warp_perspective` takes.

    Args:
        patch_src: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        src_homo_dst: (B, 3, 3), or (1, 3, 3) for all images; one image also serves many matrices.
        dsize: height and width of the result.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        normalized_coordinates: coordinates are from -1 to 1; False: they are pixels.
        normalized_homography: False: coordinates are pixels, whatever `normalized_coordinates` is.

    Returns:
        (B, C, h, w), of the dtype of `patch_src`.

    Raises:
        TypeError: `patch_src` or `src_homo_dst` is not a tensor of real numbers; `dsize` is not two ints; `align_corners`,
            `normalized_coordinates` or `normalized_homography` is not a bool.
        ValueError: `patch_src` is not (B, C, H, W); `src_homo_dst` is not (B, 3, 3) or (1, 3, 3); an entry of `dsize`
            is below 1; `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(6.0).reshape(1, 1, 2, 3)
        >>> mirror = torch.diag(torch.tensor([-1.0, 1, 1]))[None]
        >>> K.geometry.homography_warp(image, mirror, (2, 3))
        tensor([[[[2., 1., 0.],
                  [5., 4., 3.]]]])
    """
    op = "homography_warp"
    _check.images(op, "patch_src", patch_src)
    _check.shape(op, "src_homo_dst", src_homo_dst, "B", 3, 3)
    size = _check.ints(op, "dsize", dsize, 2)
    sampling.check_options(op, mode, padding_mode, align_corners, _PADDINGS)
    _check.flag(op, "normalized_coordinates", normalized_coordinates)
    _check.flag(op, "normalized_homography", normalized_homography)
    image, samples = as_values(patch_src, mode), sampling.count_samples(patch_src, src_homo_dst)
    matrix = sampling.cast_to_image(op, image, "src_homo_dst", src_homo_dst, samples)
    normalized = normalized_coordinates and normalized_homography
    padding, _ = sampling.padding_and_fill(op, image, padding_mode, None)
    options = (INTERPOLATION[mode], padding, align_corners, False, normalized)
    return of_values(sampling.warp(image, matrix, None, None, list(size), *options), patch_src, mode)


def remap(
    image: Tensor,
    map_x: Tensor,
    map_y: Tensor,
    mode: Interpolation = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool | None = None,
    normalized_coordinates: bool = False,
    antialias: bool = False,
) -> Tensor:
    """Resample an image at the coordinates in map_x and map_y.

    Args:
        image: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        map_x: x of the sampling coordinates, (B, h, w), or (1, h, w) for all images; one image also serves many maps.
        map_y: y of the sampling coordinates, of the same shape.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: -1 and 1, and the lines at which 'reflection' mirrors, are the centers of the outermost pixels,
            not their outer edges. None is False.
        normalized_coordinates: the coordinates run from -1 to 1 over the image. Else they are pixels, and the center of
            the first one is (0, 0).
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers, which the
            differences of neighbors in the maps tell; see :doc:`/conventions`. Only with 'bilinear'.

    Returns:
        (B, C, h, w), of the dtype of `image`.

    Raises:
        TypeError: `image`, `map_x` or `map_y` is not a tensor of real numbers; `align_corners` is not a bool or None;
            `normalized_coordinates` or `antialias` is not a bool.
        ValueError: `image` is not (B, C, H, W); `map_x` is not (B, h, w) or (1, h, w), or h or w is 0; `map_y` does not
            have the shape of `map_x`; `mode` or `padding_mode` is unknown; `antialias` with another mode
            than 'bilinear'; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(6.0).reshape(1, 1, 2, 3)
        >>> x, y = torch.tensor([[[0.0, 1.5]]]), torch.tensor([[[1.0, 0.0]]])
        >>> K.geometry.remap(image, x, y)
        tensor([[[[3.0000, 1.5000]]]])
    """
    _check.images("remap", "image", image)
    _check.shape("remap", "map_x", map_x, "B", "H", "W")
    _check.shape("remap", "map_y", map_y, *map_x.shape)
    _check.same_device("remap", image=image, map_x=map_x, map_y=map_y)
    if 0 in map_x.shape[1:]:
        raise ShapeError(f"remap: expected map_x with H, W of at least 1, got {tuple(map_x.shape)}")
    align_corners = False if align_corners is None else align_corners
    sampling.check_options("remap", mode, padding_mode, align_corners, _PADDINGS)
    check_antialias("remap", antialias, mode)
    _check.flag("remap", "normalized_coordinates", normalized_coordinates)
    values, samples = as_values(image, mode), sampling.count_samples(image, map_x)
    map_x = sampling.cast_to_image("remap", values, "map_x", map_x, samples)
    map_y = sampling.cast_to_image("remap", values, "map_y", map_y, samples)
    padding, _ = sampling.padding_and_fill("remap", values, padding_mode, None)
    options = (padding, align_corners, normalized_coordinates, False)
    if antialias:
        return of_values(remap_antialiased(values, map_x, map_y, None, None, *options), image, mode)
    return of_values(sampling.remap(values, map_x, map_y, None, None, INTERPOLATION[mode], *options), image, mode)


def warp_grid(grid: Tensor, src_homo_dst: Tensor) -> Tensor:
    """Transform the points of a grid by homographies.

    Args:
        grid: points (x, y), (1, H, W, 2) or (B, H, W, 2). Integers are computed in float32.
        src_homo_dst: (B, 3, 3), or (1, 3, 3) for all grids.

    Returns:
        (B, H, W, 2), as :func:`transform_points` transforms points.

    Raises:
        TypeError: `grid` or `src_homo_dst` is not a tensor of real numbers.
        ValueError: `grid` is not (B, H, W, 2); `src_homo_dst` is not (B, 3, 3); the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.warp_grid(torch.ones(1, 1, 1, 2), torch.diag(torch.tensor([2.0, 3, 1]))[None])
        tensor([[[[2., 3.]]]])
    """
    _check.shape("warp_grid", "grid", grid, "B", "H", "W", 2)
    _check.shape("warp_grid", "src_homo_dst", src_homo_dst, "B", 3, 3)
    src_homo_dst = _check.to_device_of("warp_grid", grid, "src_homo_dst", src_homo_dst, of="grid")
    _check.broadcastable("warp_grid", grid=grid.shape[:1], src_homo_dst=src_homo_dst.shape[:1])
    return transformed_grid(floats(grid), src_homo_dst)


def transformed_grid(grid: Tensor, matrix: Tensor) -> Tensor:
    """Points (B or 1, *, n) transformed by homographies (B or 1, n + 1, n + 1)."""
    batch = grid.shape[0] if matrix.shape[0] == 1 else matrix.shape[0]
    return transformed(grid if grid.shape[0] == batch else grid.expand(batch, *grid.shape[1:]), matrix)


def transform_grid(grid: Tensor, matrix: Tensor) -> Tensor:
    """Points (B, *, n) transformed by homographies (B, n + 1, n + 1)."""
    m = matrix.to(grid.dtype)
    m = m.reshape(len(m), *(1,) * (grid.dim() - 2), *m.shape[1:])
    moved = (m[..., :-1] * grid[..., None, :]).sum(-1) + m[..., -1]
    return moved[..., :-1] / moved[..., -1:]
