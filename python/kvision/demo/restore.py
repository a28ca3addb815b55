"""An example of gradients: a blurred photo is sharpened by gradient descent through the blur itself."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision.filters import gaussian_blur2d


@dataclass(frozen=True)
class Restoration:
    """Images (B, 3, H, W), the loss before each step and at the end, and the signal-to-noise ratios in decibels."""

    blurred: Tensor
    restored: Tensor
    losses: list[float]
    blurred_psnr: float
    restored_psnr: float


def blur(photos: Tensor) -> Tensor:
    return gaussian_blur2d(photos, (19, 19), (3.0, 3.0))


def restore(photos: Tensor, steps: Iterable[int]) -> Restoration:
    """Blur the photos, then find images that, when blurred, look the same: one descent step for each of `steps`.

    The loss is the squared difference between the two blurred images. Its gradient reaches the sharp one through
    gaussian_blur2d; momentum carries it along the fine structure, where the blur leaves next to no gradient.
    """
    blurred = blur(photos)
    estimate = blurred.clone().requires_grad_()
    descent = torch.optim.SGD([estimate], lr=1.0, momentum=0.9)
    losses = []
    for _ in steps:
        descent.zero_grad()
        loss = F.mse_loss(blur(estimate), blurred, reduction="sum")
        loss.backward()
        descent.step()
        losses.append(loss.detach())
    restored = estimate.detach()
    losses.append(F.mse_loss(blur(restored), blurred, reduction="sum"))
    return Restoration(
        blurred,
        restored.clamp(0, 1),
        (torch.stack(losses) / photos.numel()).tolist(),
        psnr(blurred, photos),
        psnr(restored.clamp(0, 1), photos),
    )


def psnr(picture: Tensor, truth: Tensor) -> float:
    error = F.mse_loss(picture, truth).item()
    return -10 * math.log10(error) if error > 0 else math.inf
