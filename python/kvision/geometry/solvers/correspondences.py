"""Checks and shapes of points and weights, for every function that fits a model to them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype
from kvision._ops import Operator, register
from kvision.core.exceptions import ShapeError


def check_correspondences(
    op: str,
    points1: Tensor,
    points2: Tensor,
    weights: Tensor | None,
    min_points: int,
    names: tuple[str, str] = ("points1", "points2"),
    axes: tuple[int, ...] = (2,),
) -> Tensor | None:
    """The weights in the type of the points, which may be a mask of inliers.

    Raise unless both points are (B, N, *axes) of one shape and device with N of at least `min_points`, and weights (B, N).
    """
    for name, x in zip(names, (points1, points2)):
        _check.shape(op, name, x, "B", "N", *axes)
        _check.floating(op, name, x)
    _check.same_shape(op, **dict(zip(names, (points1, points2))))
    _check.same_device(op, **dict(zip(names, (points1, points2))))
    if points1.shape[1] < min_points:
        raise ShapeError(
            f"{op}: expected {names[0]} of shape (B, N, ...) with N of at least {min_points}, "
            f"got {tuple(points1.shape)}",
            actual_shape=points1.shape,
        )
    if weights is None:
        return None
    _check.shape(op, "weights", weights, *points1.shape[:2])
    _check.same_device(op, **{names[0]: points1}, weights=weights)
    return as_dtype(weights, points1.dtype)


def normalized_weights(points: Tensor, weights: Tensor | None) -> Tensor:
    """The weight of each point (B, N, D) in a mean, (B, N, 1) or a number. Equal weights where all `weights` are 0."""
    if weights is None:
        return points.new_full((), 1 / max(1, points.shape[1]))
    w = torch.where(weights < 0, 0, weights)
    total = w.sum(-1, keepdim=True)
    none = total == 0  # NaN stays NaN
    w = torch.where(none, 1 / max(1, points.shape[1]), w / torch.where(none, 1, total))
    return w[..., None]


def register_fit(name: str, reference: Callable[..., Tensor]) -> Operator:
    """An operator of points (B, N, 2) in both images and weights (B, N), or None, that gives matrices (B, 3, 3).

    Where there is no gradient, one set of points serves all weights.
    """

    def backward_reference(
        grad: Tensor, points1: Tensor, points2: Tensor, weights: Tensor | None
    ) -> tuple[Tensor, ...]:
        w = points1.new_ones(points1.shape[:2]) if weights is None else weights
        return torch.func.vjp(reference, points1, points2, w)[1](grad)

    register(
        f"{name}_backward",
        backward_reference,
        fake=lambda grad, points1, points2, weights: [points1.shape, points1.shape, points1.shape[:2]],
    )
    return register(
        name,
        reference,
        fake=lambda points1, points2, weights: ((points1 if weights is None else weights).shape[0], 3, 3),
        gradients=f"points1, points2, weights: {name}_backward",
    )
