"""A batch as one image."""

from __future__ import annotations

import math

import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError

__all__ = ["make_grid"]


def make_grid(tensor: Tensor, n_row: int | None = None, padding: int = 2) -> Tensor:
    """Arrange the images of a batch in a grid, row by row; cells without an image are black.

    Args:
        tensor: (B, C, H, W), any dtype.
        n_row: images in a row; as near to a square as possible by default.
        padding: black pixels between adjacent images. There are none around the grid.

    Returns:
        (C, R * (H + padding) - padding, n_row * (W + padding) - padding) for R rows; no rows for an empty batch.

    Raises:
        TypeCheckError: `tensor` is not a tensor, or `n_row` or `padding` not an int.
        ShapeError: `tensor` is not (B, C, H, W).
        ValueCheckError: `n_row` is less than 1, or `padding` negative.

    Example:
        >>> import torch, kvision as K
        >>> K.image.make_grid(torch.rand(5, 3, 10, 20), padding=1).shape
        torch.Size([3, 21, 62])
    """
    _check.is_tensor("make_grid", "tensor", tensor)
    if tensor.dim() != 4:
        raise ShapeError(
            f"make_grid: expected tensor of shape (B, C, H, W), got {tuple(tensor.shape)}", actual_shape=tensor.shape
        )
    b, c, h, w = tensor.shape
    if n_row is None:
        columns = max(math.ceil(b**0.5), 1)  # of a symbolic batch, too, which math.sqrt would fix
    else:
        (columns,) = _check.ints("make_grid", "n_row", n_row, 1)
    (padding,) = _check.ints("make_grid", "padding", padding, 1, minimum=0)
    rows = -(-b // columns)
    h, w = h + padding, w + padding
    cells = F.pad(tensor, (0, padding, 0, padding, 0, 0, 0, rows * columns - b))  # the last pair adds black images
    grid = cells.reshape(rows, columns, c, h, w).permute(2, 0, 3, 1, 4).reshape(c, rows * h, columns * w)
    return grid[:, : rows * h - padding if rows else 0, : columns * w - padding]
