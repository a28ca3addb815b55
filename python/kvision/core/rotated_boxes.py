"""What rotated boxes have in common, for metrics and for the suppression of boxes."""

from __future__ import annotations

import torch
from torch import Tensor


def rotated_overlap(a: Tensor, b: Tensor) -> Tensor:
    """The intersection over union (*) of boxes (*, 5), cx, cy, w, h and degrees; NaN where a width or height is not positive."""
    areas = [torch.where((x[..., 2:4] > 0).all(-1), x[..., 2] * x[..., 3], torch.nan) for x in (a, b)]
    # In the axes of the smaller one, to whose area rounding is relative. What is left of sums that cancel is no overlap.
    first_is_smaller, smaller = (areas[0] < areas[1])[..., None], torch.minimum(*areas)
    both = _intersection(torch.where(first_is_smaller, b, a), torch.where(first_is_smaller, a, b))
    both = torch.where(both > 8 * torch.finfo(both.dtype).eps * smaller, torch.minimum(both, smaller), 0)
    return both / (areas[0] + areas[1] - both)


def _intersection(a: Tensor, b: Tensor) -> Tensor:
    """The area (*) that boxes (*, 5) have in common.

    In the axes of `b` it is an integral along the edges of `a`: of their y, clamped to the height of `b`, over their x, clamped
    to the width of `b`. No vertex of the intersection is computed, so that none can be missed or doubled.
    """
    turn = torch.deg2rad(a[..., 4] - b[..., 4])
    angle = torch.deg2rad(b[..., 4])
    (dx, dy), cos, sin = (a[..., :2] - b[..., :2]).unbind(-1), angle.cos(), angle.sin()
    middle = torch.stack([dx * cos - dy * sin, dx * sin + dy * cos], -1)  # y points down
    right = torch.stack([turn.cos(), -turn.sin()], -1) * a[..., 2:3] / 2
    down = torch.stack([turn.sin(), turn.cos()], -1) * a[..., 3:4] / 2
    corners = torch.stack([s * right + t * down for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))], -2)
    x0, y0 = (middle[..., None, :] + corners).unbind(-1)
    x1, y1 = x0.roll(-1, -1), y0.roll(-1, -1)
    half_width, half_height = (b[..., 2:4, None] / 2).unbind(-2)
    u0, u1 = _clamped(x0, half_width), _clamped(x1, half_width)
    is_vertical = x0 == x1
    slope = torch.where(is_vertical, 0, (y1 - y0) / torch.where(is_vertical, 1, x1 - x0))
    mean = _mean_clamped(y0 + (u0 - x0) * slope, y1 + (u1 - x1) * slope, half_height)
    return ((u0 - u1) * mean).sum(-1)  # the corners go clockwise


def _clamped(x: Tensor, limit: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(x, -limit), limit)


def _mean_clamped(a: Tensor, b: Tensor, limit: Tensor) -> Tensor:
    """The mean of a number clamped to [-limit, limit] while it goes from `a` to `b`."""
    low, high = torch.minimum(a, b), torch.maximum(a, b)
    below = torch.minimum(high, -limit) - torch.minimum(low, -limit)
    above = torch.maximum(high, limit) - torch.maximum(low, limit)
    first, last = _clamped(low, limit), _clamped(high, limit)
    integral = limit * (above - below) + (last - first) * (last + first) / 2
    is_short = high - low <= 1e-7 * limit  # the gradient of the quotient would lose its digits
    return torch.where(is_short, (first + last) / 2, integral / torch.where(is_short, 1, high - low))
