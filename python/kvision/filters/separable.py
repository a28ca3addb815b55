"""Filtering with a kernel that is the product of a row and a column."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check as check
from kvision._dtype import pixels, widened

from .border import pad, same_pads
from .filter2d import check_padding, correlate, prepare_kernel


@widened
def _reference(x: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: str, same: bool) -> Tensor:
    for kernel in (kernel_x[:, None, :], kernel_y[:, :, None]):
        if same:
            x = pad(x, same_pads(kernel.shape[1:]), border)
        x = correlate(x, kernel)
    return x
