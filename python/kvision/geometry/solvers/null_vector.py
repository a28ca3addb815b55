"""Null vectors: what a homogeneous system leaves open, in the sense of least squares."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry._precision import in_full_precision, wide
from kvision.geometry.linalg import adjugate

__all__ = ["null_vector_3x4"]


@in_full_precision
def null_vector_3x4(A: Tensor) -> Tensor:
    """The vector that three equations in four unknowns leave open, by cofactors.

    Args:
        A: matrices (*, 3, 4), floating point.

    Returns:
        (*, 4) with A v = 0, not of unit length: its entries are the 3 x 3 minors of A with alternating signs, so
        `[I | 0]` gives (0, 0, 0, -1) and a matrix of rank below 3 gives 0.

    Raises:
        TypeCheckError: `A` is no floating-point tensor.
        ShapeError: `A` is not (*, 3, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.null_vector_3x4(torch.eye(3, 4)[None])
        tensor([[ 0.,  0.,  0., -1.]])
    """
    _check.floating_ends("null_vector_3x4", "A", A, 3, 4)
    a, b, c = A[..., :3].unbind(-2)
    last = A[..., 3:]
    ab, bc, ca = torch.linalg.cross(a, b), torch.linalg.cross(b, c), torch.linalg.cross(c, a)
    head = last[..., 0, :] * bc + last[..., 1, :] * ca + last[..., 2, :] * ab
    return torch.cat([head, -(a * bc).sum(-1, keepdim=True)], -1) + 0  # no negative zeros


# --- the smallest singular vector -----------------------------------------------------------------------------------

# Below this share of a matrix's trace the gap between two eigenvalues is rounding: a direction in between is neither
# better nor worse, and carries no gradient.
_GAP = 1e-13


def _reference(rows: Tensor, weights: Tensor | None) -> Tensor:
    A = wide(rows)
    weighted = A if weights is None else A * wide(weights)[..., None]
    return smallest_eigenvector(weighted.mT @ A).to(rows.dtype)


def smallest_eigenvector(matrix: Tensor) -> Tensor:
    """The unit eigenvector (*, n) of symmetric matrices (*, n, n) for the smallest eigenvalue; NaN if not finite.

    The decomposition itself carries no gradient, since that of its other vectors may not exist. Two steps of Newton's
    method from its solution change nothing but add the first and the second derivative.
    """
    size = matrix.detach().diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    M = matrix / torch.where(size > 0, size, 1)
    finite = M.isfinite().all(-1, keepdim=True).all(-2, keepdim=True)
    M = torch.where(finite, M, 0)
    values, vectors = torch.linalg.eigh(M.detach())
    gap = values - values[..., :1]
    inverse = torch.where(gap > _GAP, 1 / torch.where(gap > _GAP, gap, 1), 0)
    pseudo_inverse = (vectors * inverse[..., None, :]) @ vectors.mT
    v = vectors[..., :1] * _sign(vectors[..., 0])[..., None, None]
    for _ in range(2):
        residual = M @ v - v * (v.mT @ M @ v)
        v = v - pseudo_inverse @ residual
        v = v / torch.linalg.vector_norm(v, dim=-2, keepdim=True)
    return torch.where(finite, v, torch.nan)[..., 0]


def _sign(v: Tensor) -> Tensor:
    """Which of v and -v is meant: a fixed mixture of the entries is positive."""
    mixture = (v * 0.7 ** torch.arange(v.shape[-1], device=v.device, dtype=v.dtype)).sum(-1)
    return torch.where(mixture < 0, -1.0, 1.0).to(v.dtype)


def null_vector(rows: Tensor, weights: Tensor | None = None) -> Tensor:
    """The unit vector v (*, n) with the least sum of weights * (rows @ v)^2, for rows (*, m, n) and weights (*, m).

    Where several are as good, one of them; NaN where rows or weights are not finite.
    """
    leading, (m, n) = rows.shape[:-2], rows.shape[-2:]
    flat = None if weights is None else weights.reshape(-1, m)
    return _reference(rows.reshape(-1, m, n), flat).reshape(*leading, n)


def null_vector_3x3(matrix: Tensor) -> Tensor:
    """`null_vector` of (*, 3, 3) by its cofactors, which keeps digits that squares of a badly scaled matrix lose."""
    cofactors = adjugate(matrix)
    largest = cofactors.detach().abs().amax((-2, -1), keepdim=True)
    cofactors = cofactors / torch.where(largest > 0, largest, 1)
    B = cofactors @ cofactors.mT
    eye = torch.eye(3, device=B.device, dtype=B.dtype)
    return smallest_eigenvector(B.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] * eye - B)


def null_space(rows: Tensor, count: int) -> Tensor:
    """`count` orthogonal vectors (*, n, count) that rows (*, m, n) take nearest to 0, the nearest one last.

    NaN where there are more of them.
    """
    A = wide(rows)
    M = A.mT @ A
    size = M.detach().diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    M = M / torch.where(size > 0, size, 1)
    finite = M.isfinite().all(-1, keepdim=True).all(-2, keepdim=True)
    M = torch.where(finite, M, 0)
    values, vectors = torch.linalg.eigh(M.detach())
    N, outside = vectors[..., :count].flip(-1), vectors[..., count:]
    gap = values[..., count:, None] - values[..., None, :count].flip(-1)
    clear = gap > _GAP
    for _ in range(2):
        residual = outside.mT @ (M @ N - N @ (N.mT @ M @ N))
        N = N - outside @ torch.where(clear, residual / torch.where(clear, gap, 1), 0)
    return torch.where(finite & clear.all(-1, keepdim=True).all(-2, keepdim=True), N, torch.nan).to(rows.dtype)
