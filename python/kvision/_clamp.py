"""Clamping with one gradient at the bounds, whichever version of torch: some pass it there, some do not."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._ops import wants_derivative


def clamp(x: Tensor, low: float | Tensor | None = None, high: float | Tensor | None = None) -> Tensor:
    """`x` within the bounds; NaN stays. The gradient of x is 1 at a bound, as inside."""
    if not wants_derivative(x):
        return x.clamp(low, high)  # type: ignore[arg-type]  # each is a number or a tensor
    if low is not None:
        x = torch.where(x < low, low, x)
    return x if high is None else torch.where(x > high, high, x)
