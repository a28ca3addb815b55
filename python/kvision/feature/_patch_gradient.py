"""Gradients of patches, as their operators take them: references and checks."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._limits import LARGEST_SHARED_PATCH
from kvision._shared_memory import fitting
from kvision.core.border import pad


def check_patches(op: str, name: str, x: Tensor, side: int) -> Tensor:
    """`x` as floating-point numbers; raise unless it holds patches (B, 1, side, side)."""
    _check.shape(op, name, x, "B", 1, side, side)
    return floats(x)


def too_large(patches: Tensor) -> str | None:
    """Why no kernel takes patches of this size: on CUDA a patch is in shared memory."""
    if patches.is_cuda and patches.shape[-1] > (largest := math.isqrt(fitting(patches, LARGEST_SHARED_PATCH**2))):
        return f"CUDA kernels take patches of at most {largest} pixels a side"
    return None


def patch_gradients(patches: Tensor, sobel: bool) -> tuple[Tensor, Tensor]:
    """The gradients along x and y of patches (B, 1, n, n), (B, n, n): Sobel / 8, or central differences / 2."""
    p = pad(patches, ((1, 1), (1, 1)), "replicate")[:, 0]
    dx, dy = p[..., 2:] - p[..., :-2], p[:, 2:] - p[:, :-2]
    if not sobel:
        return dx[:, 1:-1] / 2, dy[..., 1:-1] / 2
    gx = dx[:, :-2] + 2 * dx[:, 1:-1] + dx[:, 2:]
    gy = dy[..., :-2] + 2 * dy[..., 1:-1] + dy[..., 2:]
    return gx / 8, gy / 8


def to_polar(gx: Tensor, gy: Tensor, eps: float) -> tuple[Tensor, Tensor]:
    """sqrt(gx^2 + gy^2 + eps) and the angle from x to y; both are constants, 0, of gradients of 0, inf or NaN."""
    squared = (gx * gx + gy * gy).detach()
    directed = (squared > 0) & squared.isfinite()
    gx, gy = torch.where(directed, gx, 1), torch.where(directed, gy, 0)
    magnitude = (gx * gx + gy * gy + eps).sqrt()
    if gx.is_cpu:
        # torch computes arc tangents in vectors and those that are left over one by one, with another last bit, so that
        # they depend on the size of the batch. It computes all of them one by one if they are not adjacent in memory.
        gx, gy = torch.stack([gx, gy], -1).unbind(-1)
    return torch.where(directed, magnitude, 0), torch.where(directed, torch.atan2(gy, gx), 0)


def angular_votes(magnitude: Tensor, angle: Tensor, bins: int, offset: float = 0.0) -> Tensor:
    """The share of each magnitude (B, ...) in the bins around its angle, (B, bins, ...); bin `offset` is angle 0."""
    position = angle * (bins / (2 * math.pi)) + offset
    whole = position.detach().floor()
    t = position - whole
    first = whole.long() % bins
    number = torch.arange(bins, device=angle.device).reshape(1, bins, *[1] * (angle.dim() - 1))
    first, second = first[:, None], ((first + 1) % bins)[:, None]
    zero = torch.zeros_like(t)[:, None]
    votes = torch.where(number == first, (1 - t)[:, None], zero) + torch.where(number == second, t[:, None], zero)
    return magnitude[:, None] * votes


def centered_gaussian(n: int, sigma: float, like: Tensor) -> Tensor:
    """exp(-x^2 / (2 sigma^2)) at n pixels around their center, not normalized."""
    x = (torch.arange(n, dtype=like.dtype, device=like.device) - (n - 1) / 2) / sigma
    return (-x * x / 2).exp()
