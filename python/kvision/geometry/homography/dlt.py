"""Homographies from correspondences, by direct linear transformation: the least squares of linear equations.

Points are normalized first, in each image: to a mean of 0 and a mean distance of sqrt(2) from it.

Source: R. Hartley, "In defense of the eight-point algorithm" (1997); R. Hartley and A. Zisserman, "Multiple View
Geometry" (2003), section 4.1.
"""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision.geometry._normalization import normalized, to_unit_last
from kvision.geometry._precision import in_full_precision
from kvision.geometry.homography.errors import line_segment_transfer_error_one_way, symmetric_transfer_error
from kvision.geometry.solvers.correspondences import check_correspondences, register_fit
from kvision.geometry.solvers.null_vector import null_vector

__all__ = [
    "find_homography_dlt",
    "find_homography_dlt_iterated",
    "find_homography_lines_dlt",
    "find_homography_lines_dlt_iterated",
]

Solver: TypeAlias = Literal["lu", "svd"]
_SOLVERS = get_args(Solver)


@in_full_precision
def find_homography_dlt(
    points1: Tensor, points2: Tensor, weights: Tensor | None = None, solver: Solver = "lu"
) -> Tensor:
    """Estimate homographies from point correspondences, by direct linear transformation (DLT).

    Args:
        points1: (B, N, 2) as (x, y), floating point, at least four of them.
        points2: where they go, (B, N, 2).
        weights: of the squared errors, (B, N), at least 0; only their ratios matter.
        solver: "lu" or "svd": kept for those who name one. The result is the same.

    Returns:
        (B, 3, 3) whose last entry is 1 unless it is 0. NaN where points or weights are not finite; some homography
        that fits where the points leave several, with finite gradients.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args; there are fewer than four points.
        DeviceError: the tensors are on different devices.
        NotImplementedError: another solver; also a ValueCheckError.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[[0.0, 0], [8, 0], [8, 8], [0, 8], [3, 5]]])
        >>> K.geometry.find_homography_dlt(points, 2 * points + 1).round(decimals=3) + 0
        tensor([[[2., 0., 1.],
                 [0., 2., 1.],
                 [0., 0., 1.]]])
    """
    weights = check_correspondences("find_homography_dlt", points1, points2, weights, min_points=4)
    _check.choice("find_homography_dlt", "solver", solver, _SOLVERS, _check.UnknownChoiceError)
    return homography_of(points1, points2, weights)


def _reference(points1: Tensor, points2: Tensor, weights: Tensor | None) -> Tensor:
    w = None if weights is None else promoted(weights)
    x, T1 = normalized(promoted(points1), w)
    y, T2 = normalized(promoted(points2), w)
    p = torch.cat([x, torch.ones_like(x[..., :1])], -1)
    zero = torch.zeros_like(p)
    across = torch.cat([zero, -p, y[..., 1:] * p], -1)
    down = torch.cat([p, zero, -y[..., :1] * p], -1)
    return _homography(torch.cat([across, down], 1), None if w is None else w.repeat(1, 2), T1, T2, points1.dtype)


homography_of = register_fit("homography_dlt", _reference)


def _homography(rows: Tensor, weights: Tensor | None, T1: Tensor, T2: Tensor, dtype: torch.dtype) -> Tensor:
    """Convert a homography of normalized points to pixels."""
    H = null_vector(rows, weights).unflatten(-1, (3, 3)) @ T1
    # The inverse of T2 = [[s, 0, a], [0, s, b], [0, 0, 1]], up to its scale.
    s, shift = T2[:, :1, :1], T2[:, :2, 2:]
    return to_unit_last(torch.cat([H[:, :2] - shift * H[:, 2:], s * H[:, 2:]], 1)).to(dtype)


@in_full_precision
def find_homography_dlt_iterated(
    points1: Tensor, points2: Tensor, weights: Tensor, soft_inl_th: float = 3.0, n_iter: int = 5
) -> Tensor:
    """Find homographies by iteratively reweighted `find_homography_dlt`: large residuals get small weights.

    Args:
        points1: (B, N, 2) as (x, y), floating point, at least four of them.
        points2: where they go, (B, N, 2).
        weights: those of the first time, (B, N), at least 0.
        soft_inl_th: t in pixels: from the second time on a point weighs exp(-e^2 / (2 t^2)), e^2 being its
            `symmetric_transfer_error`.
        n_iter: how often, at least once.

    Returns:
        (B, 3, 3), as `find_homography_dlt`.

    Raises:
        TypeCheckError: an argument is neither a floating-point tensor nor a number.
        ShapeError: a shape is not as in Args; there are fewer than four points.
        ValueCheckError: soft_inl_th or n_iter too small.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[[0.0, 0], [80, 0], [80, 80], [0, 80], [30, 50], [60, 20], [10, 40]]])
        >>> moved = points + 5
        >>> moved[0, 6] += 2.0  # does not fit
        >>> H = K.geometry.find_homography_dlt_iterated(points, moved, torch.ones(1, 7), soft_inl_th=0.5)
        >>> (H[0, :2, 2] - 5).abs().max() < 0.1
        tensor(True)
    """
    op = "find_homography_dlt_iterated"
    first_weights = check_correspondences(op, points1, points2, weights, min_points=4)
    scale = 2 * _check_iterations(op, soft_inl_th, n_iter) ** 2
    H = homography_of(points1, points2, first_weights)
    for _ in range(n_iter - 1):
        error = symmetric_transfer_error(points1, points2, H)
        H = homography_of(points1, points2, torch.exp(-error / scale))
    return H


@in_full_precision
def find_homography_lines_dlt(ls1: Tensor, ls2: Tensor, weights: Tensor | None = None) -> Tensor:
    """Estimate homographies from line segment correspondences, by direct linear transformation (DLT).

    Args:
        ls1: segments (B, N, 2, 2) or (N, 2, 2), two ends as (x, y), floating point, at least four of them.
        ls2: where they go, in the same shape; what is on the same line is the same.
        weights: of the squared errors, (B, N), at least 0; only their ratios matter.

    Returns:
        (B, 3, 3), as `find_homography_dlt`.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args; there are fewer than four segments.
        DeviceError: the tensors are on different devices.

    Source: J. Guerrero and C. Sagues, "From Lines to Homographies between Uncalibrated Images" (2001).

    Example:
        >>> import torch, kvision as K
        >>> segments = torch.tensor([[[0.0, 0], [8, 1]], [[8, 0], [7, 8]], [[8, 8], [1, 8]], [[0, 8], [1, 0]]])
        >>> K.geometry.find_homography_lines_dlt(segments, 2 * segments + 1).round(decimals=3) + 0
        tensor([[[2., 0., 1.],
                 [0., 2., 1.],
                 [0., 0., 1.]]])
    """
    ls1, ls2, weights = _batched("find_homography_lines_dlt", ls1, ls2, weights)
    return of_lines(ls1, ls2, weights)


def _lines_reference(ls1: Tensor, ls2: Tensor, weights: Tensor | None) -> Tensor:
    w = None if weights is None else promoted(weights)
    endpoint_weights = None if w is None else w.repeat_interleave(2, 1)
    x, T1 = normalized(promoted(ls1).flatten(1, 2), endpoint_weights)
    y, T2 = normalized(promoted(ls2).flatten(1, 2), endpoint_weights)
    endpoints = torch.cat([y, torch.ones_like(y[..., :1])], -1).unflatten(1, (-1, 2))
    line = torch.linalg.cross(*endpoints.unbind(2))
    p = torch.cat([x, torch.ones_like(x[..., :1])], -1)
    rows = (line.repeat_interleave(2, 1)[..., None] * p[..., None, :]).flatten(-2)
    return _homography(rows, endpoint_weights, T1, T2, ls1.dtype)


# Takes segments (B, N, 2, 2).
of_lines = register_fit("homography_lines_dlt", _lines_reference)


@in_full_precision
def find_homography_lines_dlt_iterated(
    ls1: Tensor, ls2: Tensor, weights: Tensor, soft_inl_th: float = 4.0, n_iter: int = 5
) -> Tensor:
    """Estimate homographies from line segments by iteratively reweighted :func:`find_homography_lines_dlt`.

    Args:
        ls1: segments (B, N, 2, 2) or (N, 2, 2), two ends as (x, y), floating point, at least four of them.
        ls2: where they go, in the same shape.
        weights: those of the first time, (B, N), at least 0.
        soft_inl_th: t in pixels: from the second time on a segment weighs exp(-e^2 / (2 t^2)), e being its
            `line_segment_transfer_error_one_way`; 0 for a segment of `ls2` without length.
        n_iter: how often, at least once.

    Returns:
        (B, 3, 3), as `find_homography_dlt`.

    Raises:
        TypeCheckError: an argument is neither a floating-point tensor nor a number.
        ShapeError: a shape is not as in Args; there are fewer than four segments.
        ValueCheckError: soft_inl_th or n_iter too small.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> segments = torch.tensor([[[[0.0, 0], [8, 1]], [[8, 0], [7, 8]], [[8, 8], [1, 8]], [[0, 8], [1, 0]]]])
        >>> H = K.geometry.find_homography_lines_dlt_iterated(segments, 2 * segments + 1, torch.ones(1, 4))
        >>> H.round(decimals=3) + 0
        tensor([[[2., 0., 1.],
                 [0., 2., 1.],
                 [0., 0., 1.]]])
    """
    op = "find_homography_lines_dlt_iterated"
    ls1, ls2, first_weights = _batched(op, ls1, ls2, weights)
    scale = 2 * _check_iterations(op, soft_inl_th, n_iter) ** 2
    H = of_lines(ls1, ls2, first_weights)
    some = (ls2[..., 0, :] != ls2[..., 1, :]).any(-1)
    for _ in range(n_iter - 1):
        error = line_segment_transfer_error_one_way(ls1, ls2, H, squared=True)
        H = of_lines(ls1, ls2, torch.where(some, torch.exp(-error / scale), 0))
    return H


def _batched(op: str, ls1: Tensor, ls2: Tensor, weights: Tensor | None) -> tuple[Tensor, Tensor, Tensor | None]:
    _check.numbers(op, "ls1", ls1)
    _check.numbers(op, "ls2", ls2)
    ls1, ls2 = (ls[None] if ls.dim() == 3 else ls for ls in (ls1, ls2))
    weights = check_correspondences(op, ls1, ls2, weights, min_points=4, names=("ls1", "ls2"), axes=(2, 2))
    return ls1, ls2, weights


def _check_iterations(op: str, soft_inl_th: float, n_iter: int) -> float:
    _check.ints(op, "n_iter", n_iter, 1)
    return _check.number(op, "soft_inl_th", soft_inl_th, minimum=1e-12)
