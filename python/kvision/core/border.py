"""Padding by the border rules, for all references."""

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
    if border_type == "constant":
        return F.pad(x, [pixels for front_back in reversed(pads) for pixels in front_back])
    for axis, (front, back) in enumerate(pads, 2):  # torch's other modes sum their gradients in any order on CUDA
        n = x.shape[axis]
        if border_type == "reflect":
            parts = [x.narrow(axis, 1, front).flip(axis), x, x.narrow(axis, n - 1 - back, back).flip(axis)]
        elif border_type == "replicate":
            parts = [x.narrow(axis, 0, 1)] * front + [x] + [x.narrow(axis, n - 1, 1)] * back
        else:
            parts = [x.narrow(axis, n - front, front), x, x.narrow(axis, 0, back)]
        x = torch.cat(parts, axis)
    return x


def windows(x: Tensor, ky: int, kx: int, border_type: str) -> Tensor:
    """(ky * kx, B, C, H, W): for each tap of a window its pixel of `x`, row by row."""
    h, w = x.shape[-2:]
    padded = pad(x, same_pads((ky, kx)), border_type)
    return torch.stack([padded[..., dy : dy + h, dx : dx + w] for dy in range(ky) for dx in range(kx)])
