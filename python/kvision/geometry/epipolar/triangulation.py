"""Triangulation: points in space from their projections in two images."""

from __future__ import annotations

import math
from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision._leading import broadcast_shapes
from kvision._ops import register
from kvision.core.exceptions import ShapeError
from kvision.geometry._precision import in_full_precision
from kvision.geometry.solvers.null_vector import null_vector, null_vector_3x4

__all__ = ["triangulate_points"]

Solver: TypeAlias = Literal["eigh", "svd", "cofactor"]
_SOLVERS = get_args(Solver)


@in_full_precision
def triangulate_points(
    P1: Tensor, P2: Tensor, points1: Tensor, points2: Tensor, solver: Solver = "eigh", homogeneous: bool = False
) -> Tensor:
    """Triangulate points from their projections in two images, by direct linear transformation (DLT).

    Args:
        P1: projections of the first image, (*, 3, 4), floating point.
        P2: those of the second image, (*, 3, 4).
        points1: (*, N, 2) as (x, y), in the coordinates of `P1`. Leading axes and N broadcast.
        points2: the same points in the second image, (*, N, 2).
        solver: "eigh", "svd" or "cofactor": kept for those who name one. The result is the same.
        homogeneous: return points (x, y, z, w), of which those at infinity have w = 0.

    Returns:
        (*, N, 3). NaN, without a gradient, for points at infinity. With `homogeneous` (*, N, 4) of length 1, with the sign with
        which they are in front of the first camera, and so w is negative for points behind it. NaN if both cameras have the
        same center, from which no distance can be told.

    Raises:
        TypeCheckError: a tensor is not a floating-point tensor; `homogeneous` is not a bool.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.
        NotImplementedError: another solver; also a ValueCheckError.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), section 12.2.

    Example:
        >>> import torch, kvision as K
        >>> P1, P2 = torch.eye(3, 4), torch.eye(3, 4)
        >>> P2[0, 3] = -1.0  # moved by 1 along x
        >>> x1, x2 = torch.tensor([[0.5, 0.25]]), torch.tensor([[0.25, 0.25]])
        >>> K.geometry.triangulate_points(P1, P2, x1, x2).round(decimals=3)
        tensor([[2., 1., 4.]])
        >>> X = K.geometry.triangulate_points(P1, P2, x1, x1, homogeneous=True)  # parallel rays
        >>> (X / X[..., 2:3]).round(decimals=3) + 0
        tensor([[0.5000, 0.2500, 1.0000, 0.0000]])
    """
    op = "triangulate_points"
    for name, x in (("P1", P1), ("P2", P2)):
        _check.floating_trailing_shape(op, name, x, 3, 4)
    for name, x in (("points1", points1), ("points2", points2)):
        _check.floating_trailing_shape(op, name, x, "N", 2)
    _check.same_device(op, P1=P1, P2=P2, points1=points1, points2=points2)
    _check.choice(op, "solver", solver, _SOLVERS, _check.UnknownChoiceError)
    _check.flag(op, "homogeneous", homogeneous)
    try:
        leading = broadcast_shapes(P1.shape[:-2], P2.shape[:-2], points1.shape[:-2], points2.shape[:-2])
        count = broadcast_shapes(points1.shape[-2:], points2.shape[-2:])
    except RuntimeError:
        got = ", ".join(str(tuple(x.shape)) for x in (P1, P2, points1, points2))
        raise ShapeError(f"{op}: expected shapes that broadcast, got {got}") from None
    batch = math.prod(leading)
    x1, x2 = (x.expand(*leading, *count).reshape(batch, *count) for x in (points1, points2))
    P1, P2 = (P.expand(*leading, 3, 4).reshape(batch, 3, 4) for P in (P1, P2))
    if homogeneous:
        X = _homogeneous(x1, x2, P1, P2)
        depth = (X.detach() * P1.detach()[:, None, 2]).sum(-1, keepdim=True)
        signed = torch.where(depth < 0, -X, X).to(x1.dtype)
        return torch.where(_has_baseline(P1, P2), signed, torch.nan).reshape(*leading, count[0], 4)
    return triangulated(x1, x2, P1, P2).reshape(*leading, count[0], 3)


def _homogeneous(x1: Tensor, x2: Tensor, P1: Tensor, P2: Tensor) -> Tensor:
    """Homogeneous points (B, N, 4) of either sign from image points (B, N, 2) and projections (B, 3, 4)."""
    rows = [
        promoted(x)[..., None] * promoted(P)[:, None, 2:] - promoted(P)[:, None, :2] for x, P in ((x1, P1), (x2, P2))
    ]
    return null_vector(torch.cat(rows, -2))


def _smallest(dtype: torch.dtype) -> float:
    """What counts as 0, of numbers around 1."""
    return 1e-13 + 4 * torch.finfo(dtype).eps


def _has_baseline(P1: Tensor, P2: Tensor) -> Tensor:
    """Whether the second cameras of projections (B, 3, 4) project the centers of the first, (B, 1, 1)."""
    terms = promoted(P2.detach()) * null_vector_3x4(promoted(P1.detach()))[..., None, :]
    is_seen = terms.sum(-1).abs() > _smallest(P1.dtype) * terms.abs().sum(-1)
    return is_seen.any(-1)[:, None, None]


def _reference(x1: Tensor, x2: Tensor, P1: Tensor, P2: Tensor) -> Tensor:
    """Points in space (B, N, 3) from image points (B, N, 2) and projections (B, 3, 4)."""
    X = _homogeneous(x1, x2, P1, P2)
    w = X[..., 3:]
    is_undefined = (w.detach().abs() <= _smallest(x1.dtype)) | ~_has_baseline(P1, P2)
    return torch.where(is_undefined, torch.nan, X[..., :3] / torch.where(is_undefined, 1, w)).to(x1.dtype)


def _backward_reference(grad: Tensor, *arguments: Tensor) -> tuple[Tensor, ...]:
    return torch.func.vjp(_reference, *arguments)[1](grad)


triangulated = register(
    "triangulate",
    _reference,
    fake=lambda x1, x2, P1, P2: (*x1.shape[:2], 3),
    gradients="points1, points2, projections1, projections2: triangulate_backward",
)
triangulated_backward = register(
    "triangulate_backward", _backward_reference, fake=lambda grad, *arguments: [x.shape for x in arguments]
)
