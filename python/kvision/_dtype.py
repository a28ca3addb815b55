"""The number types an operator on images takes and computes in; _ops.with_kernel_casts has how it stores its result."""

from __future__ import annotations

import torch
from torch import Tensor


def floats(x: Tensor) -> Tensor:
    """`x`, or its float32 copy where it holds integers."""
    return x if x.is_floating_point() else x.float()


def pixels(x: Tensor) -> Tensor:
    """`x` as an operator with uint8 results takes it: floating point or uint8, other integers as float32."""
    return x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()


def compute_dtype(x: Tensor) -> torch.dtype:
    """The type an operator on images `x` computes in: float64 for float64, otherwise float32."""
    return torch.float64 if x.dtype == torch.float64 else torch.float32


def as_dtype(x: Tensor, dtype: torch.dtype) -> Tensor:
    """`x` in this type; where it has that, no call of torch's finds it out."""
    return x if x.dtype == dtype else x.to(dtype)
