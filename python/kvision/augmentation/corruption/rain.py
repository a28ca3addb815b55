"""Lines of rain."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._ops import register


def _largest(size: Sequence[int]) -> Sequence[int]:
    """The largest of heights and widths."""
    return size if len(size) == 2 else [max(size[::2]), max(size[1::2])]


def _reference(drops: Tensor, positions: Tensor, size: Sequence[int], longest: int) -> Tensor:
    """1 where drops of rain are, bytes (B, 1, H, W).

    Drops (B, 3) int64 are their number, their height and their width, below 0 where they lean to the left; positions (B, N, 2)
    are down and to the right, as fractions of where drops may begin. A drop has at most `longest` pixels. The size is H and W,
    or height and width of each sample: then the result is as large as the largest.
    """
    if len(size) > 2:
        tall, wide = _largest(size)
        each = []
        for b in range(len(drops)):
            height, width = own = size[2 * b : 2 * b + 2]
            wet = _reference(drops[b : b + 1], positions[b : b + 1], own, longest)
            each.append(F.pad(wet, (0, wide - width, 0, tall - height)))
        return torch.cat(each)
    (height, width), (count, drop_height, drop_width) = size, drops[:, :, None].unbind(1)
    # Extents from the first pixel of a drop to its last one; all of a drop is in the image.
    down, right = drop_height - 1, drop_width - drop_width.sign()
    steps = torch.maximum(drop_height, drop_width.abs()).clamp(max=longest) - 1
    rows, columns = height - down, width - right.abs()
    first_row = torch.minimum((positions[..., 0] * rows).long(), rows - 1)
    first_column = torch.minimum((positions[..., 1] * columns).long(), columns - 1) + (-right).clamp(min=0)
    falls = torch.arange(positions.shape[1], device=drops.device) < count
    wet = torch.zeros(len(drops), height * width, dtype=torch.int32, device=drops.device)
    for step in range(longest):
        k = steps.clamp(max=step)  # shorter drops repeat their last pixel
        row = first_row + k * down // steps.clamp(min=1)
        column = first_column + right.sign() * (k * right.abs() // steps.clamp(min=1))
        wet = wet.scatter_add(1, row * width + column, falls.int())
    return (wet > 0).to(torch.uint8).view(-1, 1, height, width)


rain_mask = register(
    "rain_mask",
    _reference,
    fake=lambda drops, positions, size, longest: drops.new_empty(
        (drops.shape[0], 1, *_largest(size)), dtype=torch.uint8
    ),
    non_differentiable=(0,),
    labels=True,
    casts_outputs=True,
)
