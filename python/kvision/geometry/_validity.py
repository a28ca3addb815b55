"""Projections with a mask of the points that have one, and without gradients of the others."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from kvision._ops import wants_derivative

NEAREST = 1e-8  # a point in front of a camera has a depth above


def with_validity(
    function: Callable[..., Tensor], points: Tensor, valid: Tensor, *others: Tensor | float, axes: int = 1
) -> tuple[Tensor, Tensor]:
    """`function(points, *others)` and `valid`, the points that have a result; the last `axes` axes are a point's.

    Results of other points keep their values but have no gradient, to `points` as to the `others`, be they infinite.
    """
    values = function(points, *others)
    where = valid.expand(values.shape[: values.dim() - axes])
    if wants_derivative(points, *(x for x in others if isinstance(x, Tensor))):
        mask = valid[..., None] if axes else valid
        values = torch.where(mask, function(torch.where(mask, points, 1), *others), values.detach())
    return values, where
