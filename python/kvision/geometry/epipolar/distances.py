"""Epipolar distances of correspondences under fundamental matrices."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision.geometry._correspondence_errors import check_correspondence_shapes, correspondence_errors
from kvision.geometry._precision import in_full_precision
from kvision.geometry.epipolar.fundamental import check_points

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
    """Compute the Sampson distance of correspondences from the epipolar constraint, a first-order geometric error.

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
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), equation 11.9.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.sampson_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([2.])
    """
    _check_relation("sampson_epipolar_distance", pts1, pts2, Fm)
    return correspondence_errors(
        pts1, pts2, Fm, "sampson", _check.switch("sampson_epipolar_distance", "squared", squared)
    )


@in_full_precision
def symmetrical_epipolar_distance(
    pts1: Tensor, pts2: Tensor, Fm: Tensor, squared: bool = True, eps: float = 1e-8
) -> Tensor:
    """Compute the symmetric epipolar distance: from points of both images to the epipolar lines of their correspondences.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) with a last number of 1, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second, of any scale.
        squared: the sum of both squared distances instead of its root.
        eps: of no effect, since nothing has to be kept from 0.

    Returns:
        (*, N) in pixels; inf, without a gradient, where a point has no line.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.symmetrical_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([8.])
    """
    _check_relation("symmetrical_epipolar_distance", pts1, pts2, Fm)
    return correspondence_errors(
        pts1, pts2, Fm, "symmetrical", _check.switch("symmetrical_epipolar_distance", "squared", squared)
    )


@in_full_precision
def left_to_right_epipolar_distance(pts1: Tensor, pts2: Tensor, Fm: Tensor) -> Tensor:
    """Compute the distance of points of the second image from the epipolar lines of their correspondences.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) with a last number of 1, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second, of any scale.

    Returns:
        (*, N) in pixels; inf, without a gradient, where there is no line.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.left_to_right_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([2.])
    """
    _check_relation("left_to_right_epipolar_distance", pts1, pts2, Fm)
    return correspondence_errors(pts1, pts2, Fm, "right", False)


@in_full_precision
def right_to_left_epipolar_distance(pts1: Tensor, pts2: Tensor, Fm: Tensor) -> Tensor:
    """Compute the distance of points of the first image from the epipolar lines of their correspondences.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) with a last number of 1, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second, of any scale.

    Returns:
        (*, N) in pixels; inf, without a gradient, where there is no line.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.right_to_left_epipolar_distance(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 9.0]]), F)
        tensor([2.])
    """
    _check_relation("right_to_left_epipolar_distance", pts1, pts2, Fm)
    return correspondence_errors(pts1, pts2, Fm, "left", False)


def _check_relation(op: str, pts1: Tensor, pts2: Tensor, Fm: Tensor) -> None:
    check_points(op, "pts1", pts1)
    check_points(op, "pts2", pts2)
    _check.floating_trailing_shape(op, "Fm", Fm, 3, 3)
    _check.same_device(op, pts1=pts1, pts2=pts2, Fm=Fm)
    check_correspondence_shapes(op, pts1=pts1, pts2=pts2, Fm=Fm)
