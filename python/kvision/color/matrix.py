"""Linear colour transforms: every pixel's channels times a 3 x 3 matrix."""

from __future__ import annotations

import torch
from torch import Tensor

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def mixed(x: Tensor, matrix: Matrix) -> Tensor:
    """The channels of `x` (B, 3, H, W) weighted by the rows of `matrix`."""
    r, g, b = x.unbind(1)
    return torch.stack([wr * r + wg * g + wb * b for wr, wg, wb in matrix], 1)


def inverse(m: Matrix) -> Matrix:
    """The inverse, by cofactors."""

    def cofactor(i: int, j: int) -> float:
        a, b = (i + 1) % 3, (i + 2) % 3
        c, d = (j + 1) % 3, (j + 2) % 3
        return m[a][c] * m[b][d] - m[a][d] * m[b][c]

    determinant = sum(m[0][j] * cofactor(0, j) for j in range(3))
    rows = (tuple(cofactor(j, i) / determinant for j in range(3)) for i in range(3))
    return tuple(rows)  # type: ignore[return-value]  # three rows of three by construction
