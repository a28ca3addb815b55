"""The windows of images that matrices map to results: csrc/core/window.h."""

from __future__ import annotations

import torch
from torch import Tensor


def windows_of(matrix: Tensor, axis: int, source: int, result: int, align_corners: bool) -> tuple[Tensor, ...]:
    """First pixel, size and whether it is mirrored, of the windows along an axis (0: x, 1: y), (B,) each.

    A window is what a matrix, from pixels of the image to those of the result, maps to the result, in whole pixels.
    """
    matrix = matrix.detach().double()
    scale, offset = matrix[:, axis, axis], matrix[:, axis, 2]
    mirrored = scale < 0
    margin = 0.0 if align_corners else 0.5
    corner = torch.where(mirrored, result - 1 + margin, -margin)
    first = _round((corner - offset) / scale + margin).clamp(0, source - 1)
    size = result / scale.abs() if not align_corners else 1 + (result - 1) / scale.abs()
    size = _round(size).clamp(min=1) if result > 1 or not align_corners else torch.ones_like(scale)
    return first.long(), torch.minimum(size, source - first).long(), mirrored


def _round(x: Tensor) -> Tensor:
    return (x.nan_to_num(0.0, 1e9, -1e9) + 0.5).floor()
