"""Normalization of points and matrices, which makes linear equations about them well conditioned."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype
from kvision._ops import register
from kvision.core.exceptions import ShapeError
from kvision.geometry._normalization import normalized
from kvision.geometry._precision import in_full_precision
from kvision.geometry.conversions.homogeneous import divisor

__all__ = ["normalize_points", "normalize_transformation"]


@in_full_precision
def normalize_points(points: Tensor, eps: float = 1e-8, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Move the mean of points to 0 and scale their mean distance from it to sqrt(2).

    Args:
        points: (B, N, 2) as (x, y), floating point.
        eps: added to the mean distance, for points that are all one.
        weights: of the points in both means, (B, N); those below 0 count as 0, and if all are 0 they count equally.

    Returns:
        The points, (B, N, 2), and the similarity (B, 3, 3) that maps the input to them.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: R. Hartley, "In defense of the eight-point algorithm" (1997).

    Example:
        >>> import torch, kvision as K
        >>> square = torch.tensor([[[0.0, 0], [2, 0], [2, 2], [0, 2]]])
        >>> points, T = K.geometry.normalize_points(square)
        >>> points[0, 0].round(decimals=4), T[0].round(decimals=4)
        (tensor([-1., -1.]), tensor([[ 1.,  0., -1.],
                [ 0.,  1., -1.],
                [ 0.,  0.,  1.]]))
    """
    _check.shape("normalize_points", "points", points, "B", "N", 2)
    _check.floating("normalize_points", "points", points)
    if weights is not None:
        _check.shape("normalize_points", "weights", weights, *points.shape[:2])
        _check.same_device("normalize_points", points=points, weights=weights)
    promoted_weights = None if weights is None else as_dtype(weights, points.dtype)
    result: tuple[Tensor, Tensor] = _normalize(points, promoted_weights, float(eps))
    return result


def _reference(points: Tensor, weights: Tensor | None, eps: float) -> tuple[Tensor, Tensor]:
    return normalized(points, weights, eps)


def _backward_reference(
    grad: Tensor, grad_matrix: Tensor, points: Tensor, weights: Tensor | None, eps: float
) -> tuple[Tensor, ...]:
    w = points.new_ones(points.shape[:2]) if weights is None else weights
    return torch.func.vjp(lambda x, w: normalized(x, w, eps), points, w)[1]((grad, grad_matrix))


_normalize = register(
    "normalize_points",
    _reference,
    fake=lambda points, *rest: [points.shape, (points.shape[0], 3, 3)],
    gradients="points, weights: normalize_points_backward",
)
register(
    "normalize_points_backward",
    _backward_reference,
    fake=lambda grad, grad_matrix, points, *rest: [points.shape, points.shape[:2]],
)


@in_full_precision
def normalize_transformation(M: Tensor, eps: float = 1e-8) -> Tensor:
    """Divide matrices by their last entry.

    Args:
        M: (*, m, n), at least 2 x 2, floating point.
        eps: a matrix whose last entry is not larger than that stays as it is.

    Returns:
        In the shape of `M`.

    Raises:
        TypeCheckError: `M` is not a floating-point tensor.
        ShapeError: `M` has fewer than two axes, or fewer than two rows or columns.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.normalize_transformation(2 * torch.eye(3))
        tensor([[1., 0., 0.],
                [0., 1., 0.],
                [0., 0., 1.]])
    """
    _check.floating_trailing_shape("normalize_transformation", "M", M, "m", "n")
    if M.shape[-2] < 2 or M.shape[-1] < 2:
        raise ShapeError(
            f"normalize_transformation: expected M of at least 2 x 2, got {tuple(M.shape)}", actual_shape=M.shape
        )
    return M / divisor(M[..., -1:, -1:], _check.number("normalize_transformation", "eps", eps))
