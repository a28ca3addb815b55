"""Points and affine maps in homogeneous coordinates."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError

__all__ = [
    "convert_affinematrix_to_homography",
    "convert_affinematrix_to_homography3d",
    "convert_points_from_homogeneous",
    "convert_points_to_homogeneous",
]


def convert_points_to_homogeneous(points: Tensor) -> Tensor:
    """Append a coordinate 1 to points.

    Args:
        points: points of shape (*, D).

    Returns:
        Homogeneous points of shape (*, D + 1), of the type of `points`.

    Raises:
        TypeError: `points` is not a tensor of real numbers.
        ValueError: `points` has no axis of coordinates.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.convert_points_to_homogeneous(torch.tensor([[2.0, 3.0]]))
        tensor([[2., 3., 1.]])
    """
    _check.numbers("convert_points_to_homogeneous", "points", points)
    if points.dim() == 0:
        raise ShapeError("convert_points_to_homogeneous: expected points of shape (*, D), got ()")
    return F.pad(points, (0, 1), value=1)


def convert_points_from_homogeneous(points: Tensor, eps: float = 1e-8) -> Tensor:
    """Divide points by their last coordinate and drop it.

    Args:
        points: homogeneous points of shape (*, D), D at least 2. Integers give float32.
        eps: a point whose last coordinate has at most this magnitude is not divided.

    Returns:
        Points of shape (*, D - 1).

    Raises:
        TypeError: `points` is not a tensor of real numbers.
        ValueError: `points` is not of shape (*, D) with D of at least 2, or `eps` is negative.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.convert_points_from_homogeneous(torch.tensor([[4.0, 6.0, 2.0], [1.0, 2.0, 0.0]]))
        tensor([[2., 3.],
                [1., 2.]])
    """
    op = "convert_points_from_homogeneous"
    _check.numbers(op, "points", points)
    if points.dim() == 0 or points.shape[-1] < 2:
        raise ShapeError(f"{op}: expected points of shape (*, D) with D of at least 2, got {tuple(points.shape)}")
    return _divided(floats(points), _check.number(op, "eps", eps, 0))


@with_kernel_casts
def _divided(points: Tensor, eps: float) -> Tensor:
    return points[..., :-1] / divisor(points[..., -1:], eps)


def divisor(z: Tensor, eps: float = 1e-8) -> Tensor:
    """The divisor of homogeneous points: `z`, or 1 where |z| is at most `eps`, with gradient 0 there."""
    return torch.where(z.abs() > eps, z, 1)


def convert_affinematrix_to_homography(A: Tensor) -> Tensor:
    """Append the row 0 0 1 to affine matrices of the plane.

    Args:
        A: affine matrices of shape (*, 2, 3).

    Returns:
        Homographies of shape (*, 3, 3), of the type of `A`.

    Raises:
        TypeError: `A` is not a tensor of real numbers.
        ValueError: `A` is not of shape (*, 2, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.convert_affinematrix_to_homography(torch.ones(1, 2, 3))
        tensor([[[1., 1., 1.],
                 [1., 1., 1.],
                 [0., 0., 1.]]])
    """
    _check.trailing_shape("convert_affinematrix_to_homography", "A", A, 2, 3)
    return homogeneous(A)


def convert_affinematrix_to_homography3d(A: Tensor) -> Tensor:
    """Append the row 0 0 0 1 to affine matrices of space.

    Args:
        A: affine matrices of shape (*, 3, 4).

    Returns:
        Homographies of shape (*, 4, 4), of the type of `A`.

    Raises:
        TypeError: `A` is not a tensor of real numbers.
        ValueError: `A` is not of shape (*, 3, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.convert_affinematrix_to_homography3d(torch.ones(1, 3, 4))[0, 3]
        tensor([0., 0., 0., 1.])
    """
    _check.trailing_shape("convert_affinematrix_to_homography3d", "A", A, 3, 4)
    return homogeneous(A)


def homogeneous(matrix: Tensor) -> Tensor:
    """Append the row 0 ... 0 1 to matrices (*, n, n + 1)."""
    last = matrix.new_zeros(*matrix.shape[:-2], 1, matrix.shape[-1])
    last.select(-1, -1).fill_(1)
    return torch.cat([matrix, last], -2)
