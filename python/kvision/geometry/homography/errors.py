"""Transfer errors of correspondences under homographies."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError
from kvision.geometry._correspondence_errors import check_correspondence_shapes, correspondence_errors
from kvision.geometry._precision import in_full_precision

__all__ = [
    "line_segment_transfer_error_one_way",
    "oneway_transfer_error",
    "sample_is_valid_for_homography",
    "sampson_homography_distance",
    "symmetric_transfer_error",
]


@in_full_precision
def oneway_transfer_error(pts1: Tensor, pts2: Tensor, H: Tensor, squared: bool = True, eps: float = 1e-8) -> Tensor:
    """Compute the transfer error of homographies: the distance of mapped points from their correspondences in the second image.

    Args:
        pts1: (B, N, 2) as (x, y), or (B, N, 3) homogeneous, floating point.
        pts2: their correspondences in the second image, likewise.
        H: (B, 3, 3), from the first image to the second, of any scale. B of 1 serves all.
        squared: the squared distance instead of the distance.
        eps: of no effect, since nothing has to be kept from 0.

    Returns:
        (B, N) in pixels, inf for points that go to infinity. Gradients are finite: 0 at a distance of 0 and at inf.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 5, 2)
        >>> moved = points + torch.tensor([3.0, 4.0])
        >>> K.geometry.oneway_transfer_error(points, moved, torch.eye(3)[None], squared=False).round()
        tensor([[5., 5., 5., 5., 5.]])
    """
    _check_relation("oneway_transfer_error", pts1, pts2, H)
    squared = _check.switch("oneway_transfer_error", "squared", squared)
    return correspondence_errors(pts1, pts2, H, "transfer", squared)


@in_full_precision
def symmetric_transfer_error(pts1: Tensor, pts2: Tensor, H: Tensor, squared: bool = True, eps: float = 1e-8) -> Tensor:
    """Compute the symmetric transfer error of homographies: of points mapped forward and of correspondences mapped back.

    Args:
        pts1: (B, N, 2) as (x, y), or (B, N, 3) homogeneous, floating point.
        pts2: their correspondences in the second image, likewise.
        H: (B, 3, 3), from the first image to the second, of any scale. B of 1 serves all.
        squared: the sum of both squared distances instead of its root.
        eps: of no effect, since nothing has to be kept from 0.

    Returns:
        (B, N) in pixels; the largest number of the type, without a gradient, where `H` has no inverse.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 5, 2)
        >>> K.geometry.symmetric_transfer_error(points, points + 1, torch.eye(3)[None]).round()
        tensor([[4., 4., 4., 4., 4.]])
    """
    _check_relation("symmetric_transfer_error", pts1, pts2, H)
    return correspondence_errors(
        pts1, pts2, H, "symmetric_transfer", _check.switch("symmetric_transfer_error", "squared", squared)
    )


@in_full_precision
def sampson_homography_distance(pts1: Tensor, pts2: Tensor, H: Tensor, squared: bool = True) -> Tensor:
    """Compute the Sampson error of homographies: the distance by which points of both images miss it, to first order.

    With p, q, w = H (x, y, 1) and r = (v w - q, p - u w), J being the derivative of r for (x, y, u, v): r (J J^T)^-1 r.

    Args:
        pts1: (x, y), (B, N, 2), or (B, N, 3) homogeneous, floating point.
        pts2: (u, v), their correspondences in the second image, likewise.
        H: (B, 3, 3), from the first image to the second, of any scale. B of 1 serves all.
        squared: the squared distance instead of the distance.

    Returns:
        (B, N) in pixels, exact for affine maps; inf, without a gradient, where J J^T has no inverse.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), section 4.2.6.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 5, 2)
        >>> K.geometry.sampson_homography_distance(points, points + 1, torch.eye(3)[None]).round()
        tensor([[1., 1., 1., 1., 1.]])
    """
    _check_relation("sampson_homography_distance", pts1, pts2, H)
    return correspondence_errors(
        pts1, pts2, H, "sampson_transfer", _check.switch("sampson_homography_distance", "squared", squared)
    )


@in_full_precision
def line_segment_transfer_error_one_way(ls1: Tensor, ls2: Tensor, H: Tensor, squared: bool = False) -> Tensor:
    """Compute the transfer error of homographies for line segments: the distances of mapped end points from the other lines.

    Args:
        ls1: segments (B, N, 2, 2), two ends as (x, y), floating point.
        ls2: their correspondences in the second image, likewise.
        H: (B, 3, 3), from the first image to the second, of any scale. B of 1 serves all.
        squared: the square of the error.

    Returns:
        (B, N): the mean distance of both ends in pixels. 0 for a segment of `ls2` without length, which has no line.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> segment = torch.tensor([[[[0.0, 0], [4, 0]]]])
        >>> K.geometry.line_segment_transfer_error_one_way(segment, segment + 2, torch.eye(3)[None])
        tensor([[2.]])
    """
    op = "line_segment_transfer_error_one_way"
    for name, x in (("ls1", ls1), ("ls2", ls2)):
        _check.floating_trailing_shape(op, name, x, "B", "N", 2, 2)
    _check.floating_trailing_shape(op, "H", H, "B", 3, 3)
    _check.same_device(op, ls1=ls1, ls2=ls2, H=H)
    check_correspondence_shapes(op, ls1=ls1[..., 0], ls2=ls2[..., 0], H=H)
    return correspondence_errors(
        ls1, ls2, H, "segments", _check.switch("line_segment_transfer_error_one_way", "squared", squared)
    )


def sample_is_valid_for_homography(points1: Tensor, points2: Tensor) -> Tensor:
    """Tell whether every three of four points have the same orientation in both images, as homographies of real views keep it.

    Args:
        points1: (B, 4, 2) as (x, y), floating point; of more points the first four count.
        points2: their correspondences in the second image, in the same shape.

    Returns:
        (B,) bool: every three of them have the same orientation in both images.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args; there are fewer than four points.
        DeviceError: the tensors are on different devices.

    Source: P. Marquez-Neila et al., "Speeding-up homography estimation in mobile devices" (2015).

    Example:
        >>> import torch, kvision as K
        >>> square = torch.tensor([[[0.0, 0], [1, 0], [1, 1], [0, 1]]])
        >>> mirrored = square * torch.tensor([-1.0, 1.0])
        >>> K.geometry.sample_is_valid_for_homography(square, mirrored)
        tensor([False])
    """
    op = "sample_is_valid_for_homography"
    for name, x in (("points1", points1), ("points2", points2)):
        _check.shape(op, name, x, "B", "N", 2)
        _check.floating(op, name, x)
    _check.same_shape(op, points1=points1, points2=points2)
    _check.same_device(op, points1=points1, points2=points2)
    if points1.shape[1] < 4:
        raise ShapeError(f"{op}: expected points1 of at least four points, got {tuple(points1.shape)}")
    return (_orientations(points1) == _orientations(points2)).all(-1)


def _orientations(points: Tensor) -> Tensor:
    """The orientation, -1, 0 or 1, of the four triangles of points (B, 4, 2): (B, 4)."""
    a, b, c, d = points[:, :4].unbind(1)
    p, q, r = torch.stack((a, a, a, b), 1), torch.stack((b, b, c, c), 1), torch.stack((c, d, d, d), 1)
    (x, y), (u, v) = (q - p).unbind(-1), (r - p).unbind(-1)
    return (x * v - y * u).sign()


def _check_relation(op: str, pts1: Tensor, pts2: Tensor, H: Tensor) -> None:
    for name, x in (("pts1", pts1), ("pts2", pts2)):
        _check.floating_trailing_shape(op, name, x, "B", "N", "2 or 3")
        if x.shape[-1] not in (2, 3):
            raise ShapeError(
                f"{op}: expected {name} of shape (B, N, 2 or 3), got {tuple(x.shape)}", actual_shape=x.shape
            )
    _check.floating_trailing_shape(op, "H", H, "B", 3, 3)
    _check.same_device(op, pts1=pts1, pts2=pts2, H=H)
    check_correspondence_shapes(op, pts1=pts1, pts2=pts2, H=H)
