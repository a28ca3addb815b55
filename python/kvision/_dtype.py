"""Number types: what an image operator takes, computes in and stores."""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch
from torch import Tensor

_COMPUTED_IN_FLOAT32 = (torch.float16, torch.bfloat16, torch.uint8)


def floats(x: Tensor) -> Tensor:
    """`x`, or its float32 copy where it holds integers."""
    return x if x.is_floating_point() else x.float()


def pixels(x: Tensor) -> Tensor:
    """`x` as an operator with uint8 results takes it: floating point or uint8, other integers as float32."""
    return x if x.dtype == torch.uint8 else floats(x)


def compute_dtype(x: Tensor) -> torch.dtype:
    """The type an operator on image `x` computes in: float64 for float64, otherwise float32."""
    return torch.float64 if x.dtype == torch.float64 else torch.float32


def store(y: Tensor, dtype: torch.dtype) -> Tensor:
    """A computed result as `dtype`; uint8 rounds half to even and saturates, as OpenCV does."""
    return y.round().clamp(0, 255).to(dtype) if dtype == torch.uint8 else y.to(dtype)


def widened(reference: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """`reference`, written for float32 and float64, extended to half types and uint8: compute in float32, then store.

    The result has the type of the first argument.
    """

    @functools.wraps(reference)
    def run(x: Tensor, *arguments: object) -> Tensor:
        def wide(value: object) -> object:
            return value.float() if isinstance(value, Tensor) and value.dtype in _COMPUTED_IN_FLOAT32 else value

        return store(reference(wide(x), *map(wide, arguments)), x.dtype)

    return run
