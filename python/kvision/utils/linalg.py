"""Batched linear algebra that marks singular matrices instead of failing on them."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError

__all__ = ["safe_inverse_with_mask", "safe_solve_with_mask"]


def safe_solve_with_mask(B: Tensor, A: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Solve A X = B for each matrix of a batch, and say which of them could be solved.

    A singular system is solved with the identity in place of A, so that neither values nor gradients of the others
    suffer. Singular means that a pivot is within rounding of 0 after rows and columns were scaled to a maximum of 1,
    or that A or X is not finite. Half types are computed in float32.

    Args:
        B: right-hand sides, (*, N, K) or (*, N).
        A: (*, N, N).

    Returns:
        X, (*, N, K) (K = 1 for right-hand sides (*, N)); the LU factors of the solved matrices, (*, N, N); and the
        mask, (*), True where A X = B was solved.

    Raises:
        TypeCheckError: `A` or `B` is not a tensor.
        ShapeError: the shapes do not fit.

    Example:
        >>> import torch, kvision as K
        >>> A = torch.stack([2 * torch.eye(2), torch.ones(2, 2)])
        >>> X, _, solved = K.utils.safe_solve_with_mask(torch.ones(2, 2, 1), A)
        >>> X[0].flatten(), solved
        (tensor([0.5000, 0.5000]), tensor([ True, False]))
    """
    _check.numbers("safe_solve_with_mask", "B", B)
    _check_square("safe_solve_with_mask", A)
    _check.same_device("safe_solve_with_mask", B=B, A=A)
    if B.dim() == A.dim() - 1:
        B = B[..., None]
    if B.shape[:-1] != A.shape[:-1]:
        raise ShapeError(
            f"safe_solve_with_mask: expected B of shape {(*A.shape[:-1], 'K')}, got {tuple(B.shape)}",
            actual_shape=B.shape,
        )
    dtype = _solvable_dtype(B)
    a, b = A.to(dtype), B.to(dtype)
    mask = _is_regular(a) & torch.linalg.solve_ex(a.detach(), b.detach())[0].to(B.dtype).isfinite().all(-1).all(-1)
    lu, pivots, _ = torch.linalg.lu_factor_ex(_with_identity(a, mask))
    return torch.linalg.lu_solve(lu, pivots, b).to(B.dtype), lu.to(A.dtype), mask


def safe_inverse_with_mask(A: Tensor) -> tuple[Tensor, Tensor]:
    """Invert each matrix of a batch, and say which of them could be inverted; the others give the identity.

    Singular means what it means in `safe_solve_with_mask`; gradients stay finite likewise.

    Args:
        A: (*, N, N).

    Returns:
        The inverses, (*, N, N), and the mask, (*), True where the inverse exists.

    Raises:
        TypeCheckError: `A` is not a tensor.
        ShapeError: `A` is not (*, N, N).

    Example:
        >>> import torch, kvision as K
        >>> inverse, valid = K.utils.safe_inverse_with_mask(torch.stack([2 * torch.eye(2), torch.ones(2, 2)]))
        >>> inverse[0], valid
        (tensor([[0.5000, 0.0000],
                [0.0000, 0.5000]]), tensor([ True, False]))
    """
    _check_square("safe_inverse_with_mask", A)
    a = A.to(_solvable_dtype(A))
    mask = _is_regular(a) & torch.linalg.inv_ex(a.detach())[0].to(A.dtype).isfinite().all(-1).all(-1)
    return torch.linalg.inv_ex(_with_identity(a, mask))[0].to(A.dtype), mask


def _check_square(op: str, A: Tensor) -> None:
    _check.numbers(op, "A", A)
    if A.dim() < 2 or A.shape[-1] != A.shape[-2]:
        raise ShapeError(f"{op}: expected A of shape (*, N, N), got {tuple(A.shape)}", actual_shape=A.shape)


def _solvable_dtype(x: Tensor) -> torch.dtype:
    return x.dtype if x.dtype in (torch.float32, torch.float64) else torch.float32


def _is_regular(a: Tensor) -> Tensor:
    """Whether each matrix, rows and columns scaled to a maximum of 1, has pivots larger than their rounding error."""
    a = a.detach()
    a = a / a.abs().amax(-1, keepdim=True).clamp_min(torch.finfo(a.dtype).tiny)
    a = a / a.abs().amax(-2, keepdim=True).clamp_min(torch.finfo(a.dtype).tiny)
    pivots = torch.linalg.lu_factor_ex(a)[0].diagonal(dim1=-2, dim2=-1)
    return (pivots.abs() > 8 * a.shape[-1] * torch.finfo(a.dtype).eps).all(-1)


def _with_identity(a: Tensor, mask: Tensor) -> Tensor:
    return torch.where(mask[..., None, None], a, torch.eye(a.shape[-1], device=a.device, dtype=a.dtype))
