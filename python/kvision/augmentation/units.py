"""Bytes in [0, 1] and back, for what is computed in floating point: a launch each way."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision.color.scale_shift import scale_shift
from kvision.enhance.batch import as_batch, shaped


def floats_of_bytes(x: Tensor) -> Tensor:
    """Images of bytes (..., C, H, W) in [0, 1], float32."""
    return shaped(scale_shift(as_batch(x), 1.0, 0.0, False, dtype=torch.float32), x)


def bytes_of_floats(y: Tensor) -> Tensor:
    """Images (..., C, H, W) in [0, 1], which they are clamped to, in bytes, without a gradient."""
    y = y.detach()
    return shaped(scale_shift(as_batch(y), 1.0, 0.0, True, dtype=torch.uint8), y)
