"""Null vectors: least-squares solutions of homogeneous systems."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision._ops import register
from kvision._torch_compat import carry_tangents
from kvision.geometry._precision import in_full_precision
from kvision.geometry.linalg import adjugate

__all__ = ["null_vector_3x4"]


@in_full_precision
def null_vector_3x4(A: Tensor) -> Tensor:
    """Compute the null vectors of 3 x 4 matrices, by cofactors.

    Args:
        A: matrices (*, 3, 4), floating point.

    Returns:
        (*, 4) with A v = 0, not of unit length: its entries are the 3 x 3 minors of A with alternating signs, so
        `[I | 0]` gives (0, 0, 0, -1) and a matrix of rank below 3 gives 0.

    Raises:
        TypeCheckError: `A` is not a floating-point tensor.
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

# A gap between two eigenvalues below this fraction of the trace is rounding. Directions between their eigenvectors are
# then equally good and get no gradient.
_GAP = 1e-13


# Takes symmetric matrices (B, n, n), n = 3, 4, 9 or 12. Returns ascending eigenvalues (B, n), eigenvectors as columns.
eigenvectors = register(
    "eigenvectors",
    lambda matrix: tuple(torch.linalg.eigh(matrix)),
    fake=lambda matrix: [matrix.shape[:2], matrix.shape],
    non_differentiable=(0, 1),
)


def _reference(rows: Tensor, weights: Tensor | None, computed: Tensor | None = None) -> Tensor:
    A = promoted(rows)
    weighted = A if weights is None else A * promoted(weights)[..., None]
    return _smallest_eigenvector(weighted.mT @ A, computed).to(rows.dtype)


def _smallest_eigenvector(matrix: Tensor, computed: Tensor | None) -> Tensor:
    """The unit eigenvector (*, n) of symmetric matrices (*, n, n) for the smallest eigenvalue; NaN if not finite.

    Where several are equally good, the result is `computed` if that is not None. The decomposition carries no gradient,
    because the gradient of the other eigenvectors may not exist. Two steps of Newton's method from the solution leave its
    value as it is and add the first and the second derivative.
    """
    size = matrix.detach().diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    M = matrix / torch.where(size > 0, size, 1)
    finite = M.isfinite().all(-1, keepdim=True).all(-2, keepdim=True)
    M = torch.where(finite, M, 0)
    values, vectors = eigenvectors(M.detach())
    gap = values - values[..., :1]
    inverse = torch.where(gap > _GAP, 1 / torch.where(gap > _GAP, gap, 1), 0)
    pseudo_inverse = (vectors * inverse[..., None, :]) @ vectors.mT
    v = (
        vectors[..., :1] * _sign(vectors[..., 0])[..., None, None]
        if computed is None
        else promoted(computed.detach())[..., None]
    )
    for _ in range(2):
        residual = M @ v - v * (v.mT @ M @ v)
        v = v - pseudo_inverse @ residual
        v = v / torch.linalg.vector_norm(v, dim=-2, keepdim=True)
    return torch.where(finite, v, torch.nan)[..., 0]


def _sign(v: Tensor) -> Tensor:
    """The sign that makes a fixed combination of the entries positive, which chooses between v and -v."""
    mixture = (v * 0.7 ** torch.arange(v.shape[-1], device=v.device, dtype=v.dtype)).sum(-1)
    return torch.where(mixture < 0, -1.0, 1.0).to(v.dtype)


def _backward_reference(grad: Tensor, vector: Tensor, rows: Tensor, weights: Tensor | None) -> tuple[Tensor, ...]:
    w = rows.new_ones(rows.shape[:2]) if weights is None else weights
    return torch.func.vjp(lambda rows, w: _reference(rows, w, vector), rows, w)[1](grad)


def _supports(*tensors: Tensor | None) -> str | None:
    """Forward mode is off: the kernel may choose another of several equally good vectors than the reference."""
    other = "forward mode differentiates the reference, which may choose another vector"
    return other if carry_tangents(*tensors) else None


_null_vector = register(
    "null_vector",
    _reference,
    fake=lambda rows, weights: (rows.shape[0], rows.shape[2]),
    gradients="rows, weights: null_vector_backward(vector=result)",
    supports=_supports,
)
register(
    "null_vector_backward",
    _backward_reference,
    fake=lambda grad, vector, rows, weights: [rows.shape, rows.shape[:2]],
)


def null_vector(rows: Tensor, weights: Tensor | None = None) -> Tensor:
    """The unit vector v (*, n) with the least sum of weights * (rows @ v)^2, for rows (*, m, n) and weights (*, m).

    n is 3, 4, 9 or 12. Where several are as good, one of them; NaN where rows or weights are not finite.
    """
    leading = rows.shape[:-2]
    if len(leading) == 1:
        return _null_vector(rows, weights)
    flat = None if weights is None else weights.reshape(-1, weights.shape[-1])
    return _null_vector(rows.reshape(-1, *rows.shape[-2:]), flat).reshape(*leading, rows.shape[-1])


def null_vector_3x3(matrix: Tensor) -> Tensor:
    """`null_vector` of (*, 3, 3) as the vector most parallel to its cofactors. Squares would lose digits."""
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
    for _ in range(count):  # earlier vectors are added as equations
        vectors.append(null_vector(torch.cat([rows, *(size * v[..., None, :] for v in vectors)], -2)))
    vector = torch.stack(vectors[::-1], -1)
    spare = null_vector(torch.cat([rows, *(size * v[..., None, :] for v in vectors)], -2).detach())
    left = torch.linalg.vector_norm(rows.detach() @ spare[..., None], dim=-2, keepdim=True)
    return torch.where(left > size * _GAP**0.5, vector, torch.nan)
