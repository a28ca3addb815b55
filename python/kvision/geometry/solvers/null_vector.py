"""Null vectors: what a homogeneous system leaves open, in the sense of least squares."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import register
from kvision._torch_compat import in_forward_ad
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
    _check.floating_trailing_shape("null_vector_3x4", "A", A, 3, 4)
    a, b, c = A[..., :3].unbind(-2)
    last = A[..., 3:]
    ab, bc, ca = torch.linalg.cross(a, b), torch.linalg.cross(b, c), torch.linalg.cross(c, a)
    head = last[..., 0, :] * bc + last[..., 1, :] * ca + last[..., 2, :] * ab
    return torch.cat([head, -(a * bc).sum(-1, keepdim=True)], -1) + 0  # no negative zeros


# --- the smallest singular vector -----------------------------------------------------------------------------------

# Below this share of a matrix's trace the gap between two eigenvalues is rounding: a direction in between is neither
# better nor worse, and carries no gradient.
_GAP = 1e-13


# Of symmetric matrices (B, n, n), n being 3, 4, 9 or 12: eigenvalues (B, n), ascending, and vectors as columns (B, n, n).
_eigenvectors = register(
    "eigenvectors",
    lambda matrix: tuple(torch.linalg.eigh(matrix)),
    fake=lambda matrix: [matrix.shape[:2], matrix.shape],
    non_differentiable=(0, 1),
)


def _reference(rows: Tensor, weights: Tensor | None, found: Tensor | None = None) -> Tensor:
    A = wide(rows)
    weighted = A if weights is None else A * wide(weights)[..., None]
    return _smallest_eigenvector(weighted.mT @ A, found).to(rows.dtype)


def _smallest_eigenvector(matrix: Tensor, found: Tensor | None) -> Tensor:
    """The unit eigenvector (*, n) of symmetric matrices (*, n, n) for the smallest eigenvalue; NaN if not finite.

    Where several are as good it is `found`, if that is given. The decomposition itself carries no gradient, since that of
    its other vectors may not exist. Two steps of Newton's method from its solution change nothing but add the first and
    the second derivative.
    """
    size = matrix.detach().diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    M = matrix / torch.where(size > 0, size, 1)
    finite = M.isfinite().all(-1, keepdim=True).all(-2, keepdim=True)
    M = torch.where(finite, M, 0)
    values, vectors = _eigenvectors(M.detach())
    gap = values - values[..., :1]
    inverse = torch.where(gap > _GAP, 1 / torch.where(gap > _GAP, gap, 1), 0)
    pseudo_inverse = (vectors * inverse[..., None, :]) @ vectors.mT
    v = vectors[..., :1] * _sign(vectors[..., 0])[..., None, None] if found is None else wide(found.detach())[..., None]
    for _ in range(2):
        residual = M @ v - v * (v.mT @ M @ v)
        v = v - pseudo_inverse @ residual
        v = v / torch.linalg.vector_norm(v, dim=-2, keepdim=True)
    return torch.where(finite, v, torch.nan)[..., 0]


def _sign(v: Tensor) -> Tensor:
    """Which of v and -v is meant: a fixed mixture of the entries is positive."""
    mixture = (v * 0.7 ** torch.arange(v.shape[-1], device=v.device, dtype=v.dtype)).sum(-1)
    return torch.where(mixture < 0, -1.0, 1.0).to(v.dtype)


def _backward_reference(grad: Tensor, vector: Tensor, rows: Tensor, weights: Tensor | None) -> tuple[Tensor, ...]:
    w = rows.new_ones(rows.shape[:2]) if weights is None else weights
    return torch.func.vjp(lambda rows, w: _reference(rows, w, vector), rows, w)[1](grad)


def _backward(
    needs: Sequence[bool], grad: Tensor, vector: Tensor, rows: Tensor, weights: Tensor | None
) -> tuple[Tensor, Tensor | None]:
    grad_rows, grad_weights = _null_vector_backward(grad, vector, rows, weights)
    return grad_rows, None if weights is None else grad_weights


_null_vector = register(
    "null_vector",
    _reference,
    fake=lambda rows, weights: (rows.shape[0], rows.shape[2]),
    backward=_backward,
    saves_results=True,
)
_null_vector_backward = register(
    "null_vector_backward",
    _backward_reference,
    fake=lambda grad, vector, rows, weights: [rows.shape, rows.shape[:2]],
)


def null_vector(rows: Tensor, weights: Tensor | None = None) -> Tensor:
    """The unit vector v (*, n) with the least sum of weights * (rows @ v)^2, for rows (*, m, n) and weights (*, m).

    n is 3, 4, 9 or 12. Where several are as good, one of them; NaN where rows or weights are not finite.
    """
    # Forward mode has no use for a kernel's result: of several as good it may be another one than the reference's tangent's.
    call = _reference if in_forward_ad() else _null_vector
    leading = rows.shape[:-2]
    if len(leading) == 1:
        return call(rows, weights)
    flat = None if weights is None else weights.reshape(-1, weights.shape[-1])
    return call(rows.reshape(-1, *rows.shape[-2:]), flat).reshape(*leading, rows.shape[-1])


def null_vector_3x3(matrix: Tensor) -> Tensor:
    """`null_vector` of (*, 3, 3) as what is most parallel to its cofactors: squares lose digits of a badly scaled matrix."""
    cofactors = adjugate(matrix).mT
    largest = cofactors.detach().abs().amax((-2, -1), keepdim=True)
    cofactors = cofactors / torch.where(largest > 0, largest, 1)
    x, y, z = cofactors.unbind(-1)
    zero = torch.zeros_like(x)
    return null_vector(torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3)).flatten(-3, -2))


def null_space(rows: Tensor, count: int) -> Tensor:
    """`count` orthogonal vectors (*, n, count) that rows (*, m, n) take nearest to 0, the nearest one last.

    NaN where there are more of them.
    """
    size = torch.linalg.vector_norm(rows.detach(), dim=(-2, -1), keepdim=True)
    vectors: list[Tensor] = []
    for _ in range(count):  # what was found before counts as a further equation
        vectors.append(null_vector(torch.cat([rows, *(size * v[..., None, :] for v in vectors)], -2)))
    found = torch.stack(vectors[::-1], -1)
    spare = null_vector(torch.cat([rows, *(size * v[..., None, :] for v in vectors)], -2).detach())
    left = torch.linalg.vector_norm(rows.detach() @ spare[..., None], dim=-2, keepdim=True)
    return torch.where(left > size * _GAP**0.5, found, torch.nan)
