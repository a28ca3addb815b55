"""Points and weights as every function that fits a model to them takes them."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError


def check_correspondences(
    op: str,
    points1: Tensor,
    points2: Tensor,
    weights: Tensor | None,
    least: int,
    names: tuple[str, str] = ("points1", "points2"),
    axes: tuple[int, ...] = (2,),
) -> None:
    """Raise unless both are (B, N, *axes) of one shape and device with N of at least `least`, and weights (B, N)."""
    for name, x in zip(names, (points1, points2)):
        _check.shape(op, name, x, "B", "N", *axes)
        _check.floating(op, name, x)
    _check.same_shape(op, **dict(zip(names, (points1, points2))))
    _check.same_device(op, **dict(zip(names, (points1, points2))))
    if points1.shape[1] < least:
        raise ShapeError(
            f"{op}: expected {names[0]} of shape (B, N, ...) with N of at least {least}, got {tuple(points1.shape)}",
            actual_shape=points1.shape,
        )
    if weights is not None:
        _check.shape(op, "weights", weights, *points1.shape[:2])
        _check.same_device(op, **{names[0]: points1}, weights=weights)


def shares(points: Tensor, weights: Tensor | None) -> Tensor:
    """What each of the points (B, N, D) is of a mean, (B, N, 1) or a number; alike where all weights are 0."""
    if weights is None:
        return points.new_full((), 1 / max(1, points.shape[1]))
    w = torch.where(weights < 0, 0, weights)
    total = w.sum(-1, keepdim=True)
    none = total == 0  # NaN stays NaN
    w = torch.where(none, 1 / max(1, points.shape[1]), w / torch.where(none, 1, total))
    return w[..., None]
