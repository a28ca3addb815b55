"""Cameras, motions and depth maps for the tests of geometry.depth: functions of images, with one entry for each."""

from __future__ import annotations

import torch
from torch import Tensor


def camera(x: Tensor) -> Tensor:
    k = torch.tensor([[11.0, 0, 6.3], [0, 12.5, 4.1], [0, 0, 1]], dtype=torch.float64)
    return k + 0.1 * torch.arange(len(x))[:, None, None] * (k > 1)


def motion(x: Tensor) -> Tensor:
    m = torch.tensor(
        [[0.998, -0.041, 0.052, 0.137], [0.043, 0.999, -0.031, -0.093], [-0.051, 0.033, 0.998, 0.071], [0, 0, 0, 1]],
        dtype=torch.float64,
    )
    return m + 0.0031 * torch.arange(len(x))[:, None, None] * (m < 1)


def depth(x: Tensor) -> Tensor:
    """Of images like x, smooth and in front of the camera."""
    rows = torch.linspace(1.13, 1.91, x.shape[2], dtype=torch.float64)[:, None]
    columns = torch.linspace(0, 0.37, x.shape[3], dtype=torch.float64)
    return (rows + columns**2 + 0.05 * torch.arange(len(x))[:, None, None]).unsqueeze(1)
