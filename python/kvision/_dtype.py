"""The types that operators on images take and compute in; _ops.with_kernel_casts casts the results."""

from __future__ import annotations

import torch
from torch import Tensor


def floats(x: Tensor) -> Tensor:
    """`x`, or its float32 copy where it holds integers."""
    return x if x.is_floating_point() else x.float()


def pixels(x: Tensor) -> Tensor:
    """`x`, or its float32 copy where it holds integers other than uint8: the input of operators whose kernels take it."""
    return x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()


def compute_dtype(x: Tensor) -> torch.dtype:
    """The type in which operators on images `x` compute: float64 for float64, otherwise float32."""
    return torch.float64 if x.dtype == torch.float64 else torch.float32


def promoted(x: Tensor) -> Tensor:
    """In double, where the device has it."""
    return x if x.device.type == "mps" else x.double()


def is_autocast_on(x: Tensor) -> bool:
    """Whether autocast is on for the device of `x`."""
    device = x.device.type
    return device != "meta" and torch.is_autocast_enabled(device)  # torch has no answer for meta


# Types that torch neither flips nor subtracts, and those of the same bits that it does.
SIGNED = {torch.uint16: torch.int16, torch.uint32: torch.int32, torch.uint64: torch.int64}


def as_dtype(x: Tensor, dtype: torch.dtype) -> Tensor:
    """`x.to(dtype)`, without a call of torch where `x` has this type."""
    return x if x.dtype == dtype else x.to(dtype)
