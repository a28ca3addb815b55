"""Camera matrices from focal lengths and principal points."""

from __future__ import annotations

import torch
from torch import Tensor


def camera_matrix_of(fx: Tensor, fy: Tensor, cx: Tensor, cy: Tensor) -> Tensor:
    """Camera matrices (*, 3, 3) without skew, of numbers (*)."""
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    return torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, one], -1).unflatten(-1, (3, 3))
