"""Normalization of points, which makes linear equations about them well conditioned."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision._limits import LINE_WIDTH, LINE_WIDTH_64
from kvision.geometry._precision import length
from kvision.geometry.solvers.correspondences import normalized_weights


def normalized(points: Tensor, weights: Tensor | None, eps: float = 1e-8) -> tuple[Tensor, Tensor]:
    """`normalize_points` of points (B, N, D) of any dimension: mean distance sqrt(D), and a matrix (B, D + 1, D + 1)."""
    fraction = normalized_weights(points, weights)
    mean = (fraction * points).sum(1, keepdim=True)
    centered = points - mean
    scale = math.sqrt(points.shape[-1]) / ((fraction * length(centered, keepdim=True)).sum(1, keepdim=True) + eps)
    eye = torch.eye(points.shape[-1], device=points.device, dtype=points.dtype)
    T = torch.cat([scale * eye, (-scale * mean).mT], -1)
    last = torch.zeros_like(T[:, :1])
    last[..., -1] = 1
    return scale * centered, torch.cat([T, last], 1)


def is_on_line(points: Tensor, used: Tensor) -> Tensor:
    """Whether the points (B, N, D) that are used, bool (B, N), are on one line but for rounding, bool (B,)."""
    width = LINE_WIDTH_64 if points.dtype == torch.float64 else LINE_WIDTH
    points = torch.where(used[..., None], points.detach().double(), 0)
    count = used.sum(1).clamp(min=1)[:, None, None]
    mean = points.sum(1)[..., None] / count
    squares = points.mT @ points / count
    spread = squares - mean @ mean.mT
    size, total = (M.diagonal(dim1=1, dim2=2).sum(-1) for M in (squares, spread))
    area = (total.square() - spread.square().sum((1, 2))) / 2  # the product of both largest variances
    return ~(area > total * width**2 * size)


def to_unit_last(M: Tensor, eps: float = 1e-12) -> Tensor:
    """Divided by the last entry unless that is 0: within `eps` of the largest; then by the largest."""
    largest = M.detach().abs().amax((-2, -1), keepdim=True)
    last = M[..., -1:, -1:]
    large = last.abs() > eps * largest
    return M / torch.where(large, last, torch.where(largest > 0, largest, 1))
