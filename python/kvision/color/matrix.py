"""Linear color transforms: every pixel's channels times a 3 x 3 matrix."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision.color.program import step

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


def _affine(x: Tensor, *numbers: float) -> Tensor:
    a, b, c, d, e, f, g, h, i, *offset, clip = numbers
    y = mixed(x, ((a, b, c), (d, e, f), (g, h, i))) + x.new_tensor(offset)[:, None, None]
    return clamp(y, 0, 1) if clip else y


_step = step("affine", _affine)


def affine(matrix: Matrix, offset: tuple[float, float, float] = (0, 0, 0), clip: bool = False) -> Callable[..., Tensor]:
    """The function that mixes channels by `matrix`, adds `offset`, and may clip to [0, 1]; called as a step."""
    numbers = affine_numbers(matrix, offset, clip)
    return lambda x, dtype=None: _step(x, *numbers, dtype=dtype)


def affine_numbers(matrix: Matrix, offset: tuple[float, float, float] = (0, 0, 0), clip: bool = False) -> list[float]:
    """The parameters of the step `affine`."""
    return [float(number) for numbers in (*matrix, offset, (clip,)) for number in numbers]
