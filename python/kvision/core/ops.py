"""Constant tensors that take batch size, device and dtype from another tensor."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError

__all__ = ["eye_like", "vec_like"]


def eye_like(n: int, input: Tensor, shared_memory: bool = False) -> Tensor:
    """Identity matrices, one for each sample of `input`.

    Args:
        n: rows and columns of a matrix, at least 1.
        input: any tensor of shape (B, ...); gives batch size, device and dtype.
        shared_memory: all matrices share one block of memory. Saves memory; the result must then not be written to.

    Returns:
        (B, n, n).

    Raises:
        TypeCheckError: `n` is not an int or `input` not a tensor.
        ValueCheckError: `n` is less than 1.
        ShapeError: `input` has no axis.

    Example:
        >>> import torch, kvision as K
        >>> K.core.eye_like(2, torch.zeros(3, 5)).shape
        torch.Size([3, 2, 2])
    """
    n = _check_batch("eye_like", n, "input", input)
    matrices = torch.eye(n, dtype=input.dtype, device=input.device).expand(input.shape[0], n, n)
    shared_memory = _check.switch("eye_like", "shared_memory", shared_memory)
    return matrices if shared_memory else matrices.clone(memory_format=torch.contiguous_format)


def vec_like(n: int, tensor: Tensor, shared_memory: bool = False) -> Tensor:
    """Zero column vectors, one for each sample of `tensor`.

    Args:
        n: rows of a vector, at least 1.
        tensor: any tensor of shape (B, ...); gives batch size, device and dtype.
        shared_memory: all vectors share one block of memory. Saves memory; the result must then not be written to.

    Returns:
        (B, n, 1).

    Raises:
        TypeCheckError: `n` is not an int or `tensor` not a tensor.
        ValueCheckError: `n` is less than 1.
        ShapeError: `tensor` has no axis.

    Example:
        >>> import torch, kvision as K
        >>> K.core.vec_like(3, torch.zeros(2, 5)).shape
        torch.Size([2, 3, 1])
    """
    n = _check_batch("vec_like", n, "tensor", tensor)
    shared_memory = _check.switch("vec_like", "shared_memory", shared_memory)
    return tensor.new_zeros(1 if shared_memory else tensor.shape[0], n, 1).expand(tensor.shape[0], n, 1)


def _check_batch(op: str, n: int, name: str, x: Tensor) -> int:
    _check.numbers(op, name, x)
    if x.dim() == 0:
        raise ShapeError(f"{op}: expected {name} of shape (B, ...), got ()", actual_shape=x.shape)
    return _check.ints(op, "n", n, 1)[0]
