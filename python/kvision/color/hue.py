"""Hue, an angle on the color wheel: red 0, green 2 pi / 3, blue 4 pi / 3. HSV and HLS share it.

In units of 60 degrees, with the chroma c, the maximum minus the minimum of the channels:

    red is highest      (g - b) / c
    green is highest    (b - r) / c + 2
    blue is highest     (r - g) / c + 4
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

SIXTH = math.pi / 3


def quotient(a: Tensor, b: Tensor) -> Tensor:
    """a / b. Gradients stay finite: where b is near 0, they are those of a division by the smallest number allowed."""
    smallest = 2.0**-1020 if b.dtype == torch.float64 else 2.0**-124
    tiny = b.abs() < smallest
    y = (a / torch.where(b == 0, 1, b)).detach()
    of_tiny = y + ((a - a.detach()) - y * (b - b.detach())) / smallest
    return torch.where(tiny, of_tiny, a / torch.where(tiny, 1, b))


def hue(x: Tensor, eps: float = 0.0) -> Tensor:
    """Hue (B, H, W) in [0, 2 pi) of colors `x` (B, 3, H, W); `eps` adds to the chroma. Grays: 0, with gradient 0.

    It is smooth where two channels tie for the highest, so the gradient is that of the formula of the first of them.
    """
    r, g, b = x.unbind(1)
    red, green = (r >= g) & (r >= b), g >= b
    highest = torch.where(red, r, torch.where(green, g, b))
    chroma = highest - x.amin(1)
    gray = chroma == 0
    offset = torch.where(red, g - b, torch.where(green, b - r, r - g))
    sixths = quotient(offset, torch.where(gray, 1, chroma + eps))
    sixths = torch.where(red, sixths, torch.where(green, sixths + 2, sixths + 4))
    sixths = torch.where(sixths < 0, sixths + 6, sixths)
    sixths = torch.where(sixths >= 6, sixths - 6, sixths)  # values that round up to 360 degrees
    return torch.where(gray, 0, sixths * SIXTH)


def lack(h: Tensor) -> Tensor:
    """How much of the chroma each channel lacks at hue `h` (B, H, W): (B, 3, H, W) in [0, 1].

    1        ______
            /      \\              red, from hue 0 to 2 pi; green and blue are the same,
    0 _____/        \\_____        one and two thirds of a turn later
    """
    sixths = torch.stack([h / SIXTH + shift for shift in (5, 3, 1)], 1).remainder(6)
    inside = torch.minimum(sixths, 4 - sixths)
    return torch.minimum(torch.maximum(inside, torch.zeros_like(inside)), torch.ones_like(inside))  # corners are ties
