"""Sets rectangles of images to a value."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision._ops import match_layout, register, saturate_to_byte


def is_erased(images: Tensor, boxes: Tensor) -> Tensor:
    """Which pixels (B, 1, H, W) lie in one of the boxes (B, N, 4) of their sample: x, y, width, height."""
    height, width = images.shape[-2:]
    x, y, w, h = boxes.double().unbind(2)

    def reaches(first: Tensor, side: Tensor, size: int) -> Tensor:
        at = torch.arange(size, device=images.device)
        return ((at >= first[..., None]) & (at < (first + side)[..., None])).float()

    # How many boxes there are at a pixel: one product of matrices for any number of boxes.
    return (reaches(y, h, height).mT @ reaches(x, w, width) > 0)[:, None]


def _reference(images: Tensor, boxes: Tensor, values: Tensor) -> Tensor:
    """Values (B, C), or (B, 1) for all channels, are in the units of the images."""
    if images.dtype == torch.uint8:
        values = saturate_to_byte(values)
    filled = torch.where(is_erased(images, boxes), values.to(images.dtype)[:, :, None, None], images)
    return match_layout(filled, images)


def _backward(
    needs: Sequence[bool], grad: Tensor, images: Tensor, boxes: Tensor, values: Tensor
) -> list[Tensor | None]:
    kept = erase_rectangles(grad, boxes, torch.zeros_like(values))
    if not needs[2]:
        return [kept, None, None]
    return [kept, None, (grad - kept).to(values.dtype).sum((2, 3)).sum_to_size(values.shape)]


erase_rectangles = register("erase_rectangles", _reference, backward=_backward, bytes=True, casts_outputs=True)
