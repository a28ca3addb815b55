"""Thin-plate splines: smooth maps that take given points to given others and bend as little as that allows."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, pixels
from kvision.geometry.transform import matrices, sampling

__all__ = ["get_tps_transform", "warp_image_tps", "warp_points_tps"]


def get_tps_transform(points_src: Tensor, points_dst: Tensor) -> tuple[Tensor, Tensor]:
    """The spline that takes points to others.

    Args:
        points_src: (B, N, 2), at least three and not all on a line. Best in [-1, 1].
        points_dst: where they go, (B, N, 2).

    Returns:
        Weights of the kernels around `points_src`, (B, N, 2), and of the affine part, (B, 3, 2). Solved in float64; where
        there is no solution they are NaN, inf or arbitrary.

    Raises:
        TypeError: no floating-point tensors.
        ValueError: other shapes, or not on one device.

    Source: F. Bookstein, "Principal warps: thin-plate splines and the decomposition of deformations" (1989).

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]])
        >>> weights, affine = K.geometry.get_tps_transform(points, 2 * points)
        >>> weights.abs().max() < 1e-6, affine.round(decimals=4)[0, 1]
        (tensor(True), tensor([2., 0.]))
    """
    op = "get_tps_transform"
    for name, points in (("points_src", points_src), ("points_dst", points_dst)):
        _check.shape(op, name, points, "B", "N", 2)
        _check.floating(op, name, points)
    _check.shape(op, "points_dst", points_dst, *points_src.shape)
    _check.same_device(op, points_src=points_src, points_dst=points_dst)
    p, q = matrices.wide(points_src), matrices.wide(points_dst)
    linear = torch.cat([torch.ones_like(p[..., :1]), p], -1)
    zero = p.new_zeros(len(p), 3, 3)
    system = torch.cat([torch.cat([_kernel(p, p), linear], -1), torch.cat([linear.mT, zero], -1)], -2)
    weights = torch.linalg.solve_ex(system, torch.cat([q, zero[..., :2]], 1))[0].to(points_src.dtype)
    return weights[:, :-3], weights[:, -3:]


def _kernel(p: Tensor, q: Tensor) -> Tensor:
    """r^2 log r for the distances r of points (B, N, 2) and (B, M, 2)."""
    square = (p[:, :, None] - q[:, None]).square().sum(-1)
    far = square > 0
    return torch.where(far, 0.5 * square * torch.where(far, square, 1).log(), 0)


def warp_points_tps(
    points_src: Tensor, kernel_centers: Tensor, kernel_weights: Tensor, affine_weights: Tensor
) -> Tensor:
    """Where a spline takes points.

    Args:
        points_src: (B, M, 2).
        kernel_centers: (B, N, 2), `points_src` of :func:`get_tps_transform`.
        kernel_weights: (B, N, 2) from there.
        affine_weights: (B, 3, 2) from there.

    Returns:
        (B, M, 2).

    Raises:
        TypeError: no tensors.
        ValueError: other shapes, or not on one device.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]])
        >>> weights = K.geometry.get_tps_transform(points, points + 1)
        >>> K.geometry.warp_points_tps(torch.zeros(1, 1, 2), points, *weights).round(decimals=4)
        tensor([[[1., 1.]]])
    """
    _check.shape("warp_points_tps", "points_src", points_src, "B", "M", 2)
    _check_spline("warp_points_tps", kernel_centers, kernel_weights, affine_weights)
    return _warp_points(points_src, kernel_centers, kernel_weights, affine_weights)


def _warp_points(points: Tensor, centers: Tensor, weights: Tensor, affine: Tensor) -> Tensor:
    return _kernel(points, centers) @ weights + points @ affine[:, 1:] + affine[:, :1]


def _check_spline(op: str, centers: Tensor, weights: Tensor, affine: Tensor) -> None:
    _check.shape(op, "kernel_centers", centers, "B", "N", 2)
    _check.shape(op, "kernel_weights", weights, *centers.shape)
    _check.shape(op, "affine_weights", affine, len(centers), 3, 2)
    _check.same_device(op, kernel_centers=centers, kernel_weights=weights, affine_weights=affine)


def warp_image_tps(
    image: Tensor,
    kernel_centers: Tensor,
    kernel_weights: Tensor,
    affine_weights: Tensor,
    align_corners: bool = False,
    padding_mode: str = "zeros",
) -> Tensor:
    """Show at every pixel the place of the image that a spline takes it to, in coordinates from -1 to 1.

    So the spline is the one from points of the result to points of the image.

    Args:
        image: images (B, C, H, W), floating point or uint8. Other integers are computed in float32.
        kernel_centers: (B, N, 2), `points_src` of :func:`get_tps_transform`.
        kernel_weights: (B, N, 2) from there.
        affine_weights: (B, 3, 2) from there.
        align_corners: -1 and 1 are the middles of the outermost pixels, not their outer edges.
        padding_mode: 'zeros', 'border' or 'reflection'.

    Returns:
        (B, C, H, W), of the type of `image`.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: a shape or name is not as above.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.rand(1, 3, 8, 8)
        >>> points = torch.tensor([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]])
        >>> still = K.geometry.warp_image_tps(image, points, *K.geometry.get_tps_transform(points, points))
        >>> torch.allclose(still, image, atol=1e-4)
        True
    """
    op = "warp_image_tps"
    _check.images(op, "image", image)
    _check_spline(op, kernel_centers, kernel_weights, affine_weights)
    sampling.check_how(op, "bilinear", padding_mode, align_corners)
    images = pixels(image)
    dtype = compute_dtype(images)
    spline = [sampling.for_images(op, images, "spline", x) for x in (kernel_centers, kernel_weights, affine_weights)]
    h, w = image.shape[2:]
    y, x = (_unit(n, align_corners, images, dtype) for n in (h, w))
    grid = torch.stack([x.expand(h, w), y[:, None].expand(h, w)], -1).reshape(1, -1, 2)
    places = _warp_points(grid, *spline).unflatten(1, (h, w))
    padding, _ = sampling.padding_and_fill(op, images, padding_mode, None)
    return sampling.remap(images, places[..., 0], places[..., 1], None, "bilinear", padding, align_corners, True, False)


def _unit(size: int, align_corners: bool, like: Tensor, dtype: torch.dtype) -> Tensor:
    """The pixels of an axis in [-1, 1]."""
    less = 1 if align_corners else 0
    middle = torch.arange(size, dtype=dtype, device=like.device) - (size - 1) / 2
    return middle * (2 / max(size - less, 1))
