"""How far correspondences are from fundamental matrices."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry._precision import in_full_precision, quotient
from kvision.geometry.epipolar.fundamental import check_points
from kvision.geometry.linalg import root

__all__ = [
    "left_to_right_epipolar_distance",
    "right_to_left_epipolar_distance",
    "sampson_epipolar_distance",
    "symmetrical_epipolar_distance",
]


@in_full_precision
def sampson_epipolar_distance(
    pts1: Tensor,
    pts2: Tensor,
    Fm: Tensor,
    squared: bool = True,
    eps: float = 1e-8,
    use_matmul_at_less_than_points: int = 10000,
) -> Tensor:
    """Compute how far points of both images have to move to fit a fundamental matrix, to first order.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) with a last number of 1, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second, of any scale.
        squared: the squared distance instead of the distance.
        eps: of no effect, since nothing has to be kept from 0.
        use_matmul_at_less_than_points: of no effect: there is one way to compute it.

    Returns:
        (*, N) in pixels; inf, without a gradient, where both points have no line.

    Raises:
        TypeCheckError: no floating-point tensors.
        ShapeError: other shapes.
        DeviceError: tensors on different devices.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), equation 11.9.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.sampson_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([2.])
    """
    right, left, residual = _lines("sampson_epipolar_distance", pts1, pts2, Fm)
    distance = quotient(residual.square(), right + left, torch.inf)
    return distance if squared else root(distance)


@in_full_precision
def symmetrical_epipolar_distance(
    pts1: Tensor, pts2: Tensor, Fm: Tensor, squared: bool = True, eps: float = 1e-8
) -> Tensor:
    """Compute how far points of both images are from the lines of the other image's.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) with a last number of 1, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second, of any scale.
        squared: the sum of both squared distances instead of its root.
        eps: of no effect, since nothing has to be kept from 0.

    Returns:
        (*, N) in pixels; inf, without a gradient, where a point has no line.

    Raises:
        TypeCheckError: no floating-point tensors.
        ShapeError: other shapes.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.symmetrical_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([8.])
    """
    right, left, residual = _lines("symmetrical_epipolar_distance", pts1, pts2, Fm)
    square = residual.square()
    distance = quotient(square, right, torch.inf) + quotient(square, left, torch.inf)
    return distance if squared else root(distance)


@in_full_precision
def left_to_right_epipolar_distance(pts1: Tensor, pts2: Tensor, Fm: Tensor) -> Tensor:
    """Compute how far points of the second image are from the lines of those of the first.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) with a last number of 1, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second, of any scale.

    Returns:
        (*, N) in pixels; inf, without a gradient, where there is no line.

    Raises:
        TypeCheckError: no floating-point tensors.
        ShapeError: other shapes.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.left_to_right_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([2.])
    """
    right, _, residual = _lines("left_to_right_epipolar_distance", pts1, pts2, Fm)
    return quotient(residual.abs(), root(right), torch.inf)


@in_full_precision
def right_to_left_epipolar_distance(pts1: Tensor, pts2: Tensor, Fm: Tensor) -> Tensor:
    """Compute how far points of the first image are from the lines of those of the second.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) with a last number of 1, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second, of any scale.

    Returns:
        (*, N) in pixels; inf, without a gradient, where there is no line.

    Raises:
        TypeCheckError: no floating-point tensors.
        ShapeError: other shapes.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.right_to_left_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([2.])
    """
    _, left, residual = _lines("right_to_left_epipolar_distance", pts1, pts2, Fm)
    return quotient(residual.abs(), root(left), torch.inf)


def _lines(op: str, pts1: Tensor, pts2: Tensor, Fm: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """a^2 + b^2 of the lines in the second and in the first image, and x2^T F x1."""
    check_points(op, "pts1", pts1)
    check_points(op, "pts2", pts2)
    _check.floating_ends(op, "Fm", Fm, 3, 3)
    _check.same_device(op, pts1=pts1, pts2=pts2, Fm=Fm)
    right, left = _across(Fm, pts1), _across(Fm.mT, pts2)
    x, y = pts2[..., 0], pts2[..., 1]
    last = right[2] if pts2.shape[-1] == 2 else right[2] * pts2[..., 2]
    residual = right[0] * x + right[1] * y + last
    return right[0].square() + right[1].square(), left[0].square() + left[1].square(), residual


def _across(F: Tensor, points: Tensor) -> tuple[Tensor, ...]:
    """F x of points (*, N, 2 or 3), number by number: rows of N are what a CPU adds fast."""
    if points.shape[-1] == 3:
        return (F @ points.mT).unbind(-2)
    return (F[..., :2] @ points.mT + F[..., 2:]).unbind(-2)
