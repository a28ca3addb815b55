"""Affine maps from points."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._dtype import promoted
from kvision.geometry._precision import in_full_precision, length
from kvision.geometry.solvers.correspondences import check_correspondences, normalized_weights, register_fit

__all__ = ["find_affine"]


@in_full_precision
def find_affine(points1: Tensor, points2: Tensor, weights: Tensor | None = None) -> Tensor:
    """Estimate affine transforms from point correspondences, by weighted least squares.

    Args:
        points1: (B, N, 2) as (x, y), floating point, at least three of them.
        points2: where they go, (B, N, 2).
        weights: of the squared distances, (B, N), at least 0; only their ratios matter.

    Returns:
        (B, 3, 3), last row (0, 0, 1). NaN where the points with a weight are on one line.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args; there are fewer than three points.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> triangle = torch.tensor([[[0.0, 0], [1, 0], [0, 1]]])
        >>> K.geometry.find_affine(triangle, 2 * triangle + 1).round(decimals=4) + 0
        tensor([[[2., 0., 1.],
                 [0., 2., 1.],
                 [0., 0., 1.]]])
    """
    weights = check_correspondences("find_affine", points1, points2, weights, min_points=3)
    return affine_of(points1, points2, weights)


def _reference(points1: Tensor, points2: Tensor, weights: Tensor | None) -> Tensor:
    x, y = promoted(points1), promoted(points2)
    w = normalized_weights(x, None if weights is None else promoted(weights))
    x_mean, y_mean = (w * x).sum(-2, keepdim=True), (w * y).sum(-2, keepdim=True)
    x, y = x - x_mean, y - y_mean
    size = (w * length(x.detach(), keepdim=True)).sum(-2, keepdim=True)
    x = x / torch.where(size > 0, size, 1)
    normal, moved = (w * x).mT @ x, (w * x).mT @ y
    a, b, c = normal[..., 0, 0], normal[..., 0, 1], normal[..., 1, 1]
    area = a * c - b * b
    flat = ~(area > 1e-12 * (a + c) ** 2)
    inverse = torch.stack([torch.stack([c, -b], -1), torch.stack([-b, a], -1)], -2)
    inverse = inverse / torch.where(flat, 1, area)[..., None, None]
    linear = (inverse @ moved).mT / torch.where(size > 0, size, 1)
    result = torch.cat([linear, y_mean.mT - linear @ x_mean.mT], -1)
    result = torch.where(flat[..., None, None], torch.nan, result)
    last = result.new_zeros(*result.shape[:-2], 1, 3)
    last[..., 2] = 1
    return torch.cat([result, last], -2).to(points1.dtype)


affine_of = register_fit("affine_fit", _reference)
