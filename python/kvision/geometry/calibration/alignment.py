"""Alignment of corresponding points in space by rigid motions and similarities."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry.liegroup import Se3, Sim3, So3
from kvision.geometry.optim import least_squares

__all__ = ["kabsch", "umeyama"]

_SQUARINGS = 30  # tell eigenvalues apart whose relative difference is 1e-7


def kabsch(points1: Tensor, points2: Tensor, weights: Tensor | None = None) -> tuple[Se3, Tensor]:
    """Find the rigid motions with the least squared distances between moved and corresponding points.

    Args:
        points1: points that are moved (B, N, 3), float32 or float64.
        points2: where they should be, (B, N, 3).
        weights: of the squares, at least 0, (B, N). Points of weight 0 do not count.

    Returns:
        The motions (B,), proper rotations whatever the points, and a mask (B,) of those that the points determine; others, such as
        of points on one line, are NaN. Gradients are those of the minimum, by the implicit function theorem.

    Raises:
        TypeError: points or weights are not floating-point tensors.
        ValueError: a shape is not as in Args.

    Source: B. K. P. Horn, "Closed-form solution of absolute orientation using unit quaternions" (1987).

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 5, 3)
        >>> motion, valid = K.geometry.kabsch(points, points + 2)
        >>> motion.t.round(), valid
        (tensor([[2., 2., 2.]]), tensor([True]))
    """
    return _aligned("kabsch", Se3, points1, points2, weights)


def umeyama(points1: Tensor, points2: Tensor, weights: Tensor | None = None) -> tuple[Sim3, Tensor]:
    """Find the similarities with the least squared distances between moved and corresponding points.

    Args:
        points1: points that are moved (B, N, 3), float32 or float64.
        points2: where they should be, (B, N, 3).
        weights: of the squares, at least 0, (B, N). Points of weight 0 do not count.

    Returns:
        The similarities (B,), proper rotations whatever the points, and a mask (B,) of those that the points determine; others,
        such as of points on one line, are NaN. Gradients are those of the minimum, by the implicit function theorem.

    Raises:
        TypeError: points or weights are not floating-point tensors.
        ValueError: a shape is not as in Args.

    Source: S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (1991).

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 5, 3)
        >>> similarity, valid = K.geometry.umeyama(points, 3 * points + 2)
        >>> similarity.scale.round(), valid
        (tensor([3.]), tensor([True]))
    """
    return _aligned("umeyama", Sim3, points1, points2, weights)


def check_pairs(op: str, points1: Tensor, points2: Tensor) -> None:
    """Raise unless the arguments are corresponding points in space."""
    for name, x in (("points1", points1), ("points2", points2)):
        _check.floating_trailing_shape(op, name, x, "B", "N", 3)
    _check.same_shape(op, points1=points1, points2=points2)
    _check.same_device(op, points1=points1, points2=points2)


def _aligned(op: str, group: Any, points1: Tensor, points2: Tensor, weights: Tensor | None) -> tuple[Any, Tensor]:
    check_pairs(op, points1, points2)
    if weights is not None:
        _check.floating_trailing_shape(op, "weights", weights)
        _check.shape(op, "weights", weights, *points1.shape[:2])
    with torch.no_grad():
        start, is_unique = _closed_form(group, points1, points2, weights)

    def distances(variables: dict[str, Any]) -> Tensor:
        result: Tensor = variables["pose"][:, None] * points1 - points2
        return result

    # One step removes what rounding left; the gradient is that of the solver.
    fit = least_squares(distances, {"pose": start}, weights, max_iterations=1)
    pose = fit.variables["pose"]
    is_valid = is_unique & fit.cost.isfinite()
    q, *rest = (
        torch.where(is_valid.reshape(-1, *(1,) * (x.dim() - 1)), x, torch.nan)
        for x in (pose.quaternion.data, pose.t, *((pose.scale,) if group is Sim3 else ()))
    )
    result = group(So3.from_wxyz(q), *rest)
    return result if q.requires_grad else result.requires_grad_(False), is_valid


def _closed_form(group: Any, points1: Tensor, points2: Tensor, weights: Tensor | None) -> tuple[Any, Tensor]:
    """The solution by the dominant eigenvector of Horn's matrix, in float64, and whether it is the only one."""
    w = torch.ones_like(points1[..., 0]) if weights is None else weights
    is_used = (w > 0)[..., None]
    w = w.double()[..., None]
    x, y = (torch.where(is_used, p, 0).double() for p in (points1, points2))
    total = w.sum(1, keepdim=True)
    center1, center2 = ((w * p).sum(1, keepdim=True) / total for p in (x, y))
    x, y = torch.where(is_used, x - center1, 0), torch.where(is_used, y - center2, 0)
    S = (w * x).mT @ y
    N = _horn_matrix(S)
    size = torch.linalg.vector_norm(N, dim=(1, 2)).clamp(min=torch.finfo(N.dtype).tiny)
    N = N / size[:, None, None] + torch.eye(4, dtype=N.dtype, device=N.device)  # eigenvalues from 0 to 2
    q, largest = _dominant(N)
    second = _dominant(N - largest[:, None, None] * q[:, :, None] * q[:, None, :])[1]
    is_unique = largest - second > 1e-12
    rotation = So3.from_wxyz(torch.where(is_unique[:, None], q, q.new_tensor([1.0, 0, 0, 0])))
    scale = torch.ones_like(largest)
    if group is Sim3:
        scale = (w * (rotation[:, None] * x) * y).sum((1, 2)) / (w * x * x).sum((1, 2))
    t = (center2 - scale[:, None, None] * (rotation[:, None] * center1))[:, 0]
    is_unique = is_unique & (scale > 0)
    rest = (t, torch.where(is_unique, scale, 1)) if group is Sim3 else (t,)
    start = group(So3.from_wxyz(rotation.q.data.to(points1.dtype)), *(v.to(points1.dtype) for v in rest))
    return start, is_unique


def _dominant(M: Tensor) -> tuple[Tensor, Tensor]:
    """The eigenvectors (B, 4) of the largest eigenvalues (B,) of positive semidefinite matrices, by repeated squaring."""
    P = M
    for _ in range(_SQUARINGS):
        P = P @ P
        P = P / torch.linalg.vector_norm(P, dim=(1, 2), keepdim=True).clamp(min=torch.finfo(P.dtype).tiny)
    column = P.diagonal(dim1=1, dim2=2).argmax(-1)
    v = torch.nn.functional.normalize(P[torch.arange(len(P), device=P.device), column], dim=-1)
    return v, (v[:, None] @ M @ v[..., None])[:, 0, 0]


def _horn_matrix(S: Tensor) -> Tensor:
    """The matrix (B, 4, 4) of a quadratic form of quaternions, the sum of y^T R(q) x, from the sums S of x y^T."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = S.flatten(1).unbind(-1)
    rows = (
        (xx + yy + zz, yz - zy, zx - xz, xy - yx),
        (yz - zy, xx - yy - zz, xy + yx, zx + xz),
        (zx - xz, xy + yx, yy - xx - zz, yz + zy),
        (xy - yx, zx + xz, yz + zy, zz - xx - yy),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], 1)
