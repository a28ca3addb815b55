"""What a filter reads beyond the image; the one place where the references pad."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor


def same_pads(sizes: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """(front, back) for each kernel size, such that a kernel of these sizes keeps the size of an image."""
    return tuple(((size - 1) // 2, size // 2) for size in sizes)


def pad(x: Tensor, pads: Sequence[tuple[int, int]], border_type: str) -> Tensor:
    """`x` (B, C, *S) extended along S by `pads`, (front, back) of each axis, under the border rule.

    constant   0 0 | a b c d | 0 0
    reflect    c b | a b c d | c b
    replicate  a a | a b c d | d d
    circular   c d | a b c d | a b
    """
    last_axis_first = [pixels for front_back in reversed(pads) for pixels in front_back]
    images = x if x.numel() else x.reshape(0, 1, *x.shape[2:])  # torch pads 0 images, but not 0 channels
    y = F.pad(images, last_axis_first, mode=border_type)
    return y.reshape(*x.shape[:2], *y.shape[2:])


def windows(x: Tensor, ky: int, kx: int, border_type: str) -> Tensor:
    """(ky * kx, B, C, H, W): for each tap of a window its pixel of `x`, row by row."""
    h, w = x.shape[-2:]
    padded = pad(x, same_pads((ky, kx)), border_type)
    return torch.stack([padded[..., dy : dy + h, dx : dx + w] for dy in range(ky) for dx in range(kx)])
