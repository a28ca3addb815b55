"""Sets rectangles of images to a value."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision._ops import match_layout, register, saturate_to_byte


def is_erased(images: Tensor, boxes: Tensor) -> Tensor:
    """Which pixels (B, 1, H, W) lie in the box of their sample."""
    height, width = images.shape[-2:]
    x, y, w, h = boxes.double().unbind(1)

    def lies_in(first: Tensor, side: Tensor, size: int) -> Tensor:
        at = torch.arange(size, device=images.device)
        return (at >= first[:, None]) & (at < (first + side)[:, None])

    return (lies_in(y, h, height)[:, :, None] & lies_in(x, w, width)[:, None])[:, None]


def _reference(images: Tensor, boxes: Tensor, values: Tensor) -> Tensor:
    """Boxes are (B, 4): x, y, width, height; values (B,) are in the units of the images."""
    if images.dtype == torch.uint8:
        values = saturate_to_byte(values)
    filled = torch.where(is_erased(images, boxes), values.to(images.dtype)[:, None, None, None], images)
    return match_layout(filled, images)


def _backward(
    needs: Sequence[bool], grad: Tensor, images: Tensor, boxes: Tensor, values: Tensor
) -> list[Tensor | None]:
    kept = erase_rectangles(grad, boxes, torch.zeros_like(values))
    if not needs[2]:
        return [kept, None, None]
    return [kept, None, (grad - kept).to(values.dtype).sum((1, 2, 3)).sum_to_size(values.shape)]


erase_rectangles = register("erase_rectangles", _reference, backward=_backward, bytes=True, casts_outputs=True)
