"""Grids of the coordinates of pixels and voxels."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import TypeCheckError

__all__ = ["create_meshgrid", "create_meshgrid3d"]


def create_meshgrid(
    height: int,
    width: int,
    normalized_coordinates: bool = True,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
    align_corners: bool = True,
) -> Tensor:
    """The coordinates of all pixels of an image.

    Args:
        height: of the image, in pixels.
        width: of the image, in pixels.
        normalized_coordinates: from -1 to 1; else in pixels, from 0 on.
        device: of the result.
        dtype: of the result.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges. The only pixel of an axis
            is 0 either way.

    Returns:
        (1, H, W, 2) as (x, y).

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a size is below 1.

    Example:
        >>> import kvision as K
        >>> K.geometry.create_meshgrid(1, 3)
        tensor([[[[-1.,  0.],
                  [ 0.,  0.],
                  [ 1.,  0.]]]])
    """
    op = "create_meshgrid"
    _check.flag(op, "normalized_coordinates", normalized_coordinates)
    _check.flag(op, "align_corners", align_corners)
    sizes = {"height": height, "width": width}
    y, x = (_axis(op, name, n, normalized_coordinates, align_corners, device, dtype) for name, n in sizes.items())
    y, x = torch.broadcast_tensors(y[:, None], x)
    return torch.stack([x, y], -1)[None]


def create_meshgrid3d(
    depth: int,
    height: int,
    width: int,
    normalized_coordinates: bool = True,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """The coordinates of all voxels of a volume.

    Args:
        depth: of the volume, in voxels.
        height: of the volume, in voxels.
        width: of the volume, in voxels.
        normalized_coordinates: from -1 to 1, the centers of the outermost voxels; else in voxels, from 0 on.
        device: of the result.
        dtype: of the result.

    Returns:
        (1, D, H, W, 3) as (z, x, y), which is Kornia's order.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a size is below 1.

    Example:
        >>> import kvision as K
        >>> K.geometry.create_meshgrid3d(2, 3, 4, normalized_coordinates=False)[0, 1, 2, 3]
        tensor([1., 3., 2.])
    """
    op = "create_meshgrid3d"
    _check.flag(op, "normalized_coordinates", normalized_coordinates)
    sizes = {"depth": depth, "height": height, "width": width}
    z, y, x = (_axis(op, name, n, normalized_coordinates, True, device, dtype) for name, n in sizes.items())
    grid = torch.meshgrid(z, y, x, indexing="ij")
    return torch.stack([grid[0], grid[2], grid[1]], -1)[None]


def _axis(op, name, size, normalized, align_corners, device, dtype):
    (size,) = _check.ints(op, name, size, 1)
    device = _check.device(op, device)
    dtype = torch.get_default_dtype() if dtype is None else dtype
    if not isinstance(dtype, torch.dtype):
        raise TypeCheckError(f"{op}: expected dtype to be a torch.dtype, got {dtype!r}")
    # Half types represent integers exactly up to 2048 at most.
    i = torch.arange(size, device=device, dtype=torch.float64 if dtype == torch.float64 else torch.float32)
    if normalized:
        i = (2 * i - (size - 1)) / (max(size - 1, 1) if align_corners else size)
    return i.to(dtype)
