"""Grids of pixels between an image and a camera's frame."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError
from kvision.geometry.linalg import transform_points

__all__ = ["cam2pixel", "pixel2cam"]


def pixel2cam(depth: Tensor, intrinsics_inv: Tensor, pixel_coords: Tensor) -> Tensor:
    """Back-project pixels at a depth to points in the camera's frame.

    Args:
        depth: z, (B, 1, H, W).
        intrinsics_inv: inverse camera matrices (B, 4, 4), or (1, 4, 4) for all.
        pixel_coords: pixels as (x, y, 1), (B, H, W, 3).

    Returns:
        (B, H, W, 3).

    Raises:
        TypeError: `depth`, `intrinsics_inv` or `pixel_coords` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> pixels = torch.tensor([[[[4.0, 2.0, 1.0]]]])
        >>> K.geometry.pixel2cam(torch.full((1, 1, 1, 1), 2.0), torch.eye(4)[None], pixels)
        tensor([[[[8., 4., 2.]]]])
    """
    op = "pixel2cam"
    _check.shape(op, "depth", depth, "B", 1, "H", "W")
    intrinsics_inv = _check_grid(op, "pixel_coords", pixel_coords, "intrinsics_inv", intrinsics_inv)
    _check.shape(op, "pixel_coords", pixel_coords, depth.shape[0], *depth.shape[2:], 3)
    _check.same_device(op, depth=depth, pixel_coords=pixel_coords)
    rays = transform_points(intrinsics_inv, floats(pixel_coords))
    return rays * depth.movedim(1, -1).to(rays.dtype)


def cam2pixel(cam_coords_src: Tensor, dst_proj_src: Tensor, eps: float = 1e-12) -> Tensor:
    """Project points of one camera's frame to the pixels of another camera.

    Args:
        cam_coords_src: (B, H, W, 3).
        dst_proj_src: camera matrix times pose, (B, 4, 4), or (1, 4, 4) for all.
        eps: what is added to the depth that divides; a point of depth 0 lands far outside.

    Returns:
        Pixels (B, H, W, 2) as (x, y).

    Raises:
        TypeError: `cam_coords_src` or `dst_proj_src` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.cam2pixel(torch.tensor([[[[8.0, 4.0, 2.0]]]]), torch.eye(4)[None])
        tensor([[[[4., 2.]]]])
    """
    op = "cam2pixel"
    dst_proj_src = _check_grid(op, "cam_coords_src", cam_coords_src, "dst_proj_src", dst_proj_src)
    eps = _check.number(op, "eps", eps)
    return _divided(transform_points(dst_proj_src, floats(cam_coords_src)), eps)


def _check_grid(op: str, name: str, grid: Tensor, matrix_name: str, matrix: Tensor) -> Tensor:
    """The matrix on the device of the grid; raise unless these are a grid and its matrices."""
    _check.shape(op, name, grid, "B", "H", "W", 3)
    _check.shape(op, matrix_name, matrix, "B", 4, 4)
    if not _check.is_one_or(matrix.shape[0], grid.shape[0]):
        raise ShapeError(f"{op}: expected {matrix_name} with 1 or {grid.shape[0]} matrices, got {tuple(matrix.shape)}")
    return _check.to_device_of(op, grid, matrix_name, matrix, of=name)


@with_kernel_casts
def _divided(points: Tensor, eps: float) -> Tensor:
    return points[..., :2] / (points[..., 2:] + eps)
