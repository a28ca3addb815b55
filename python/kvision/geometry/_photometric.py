"""What losses that compare warped images share: distances and their slopes, what is seen, gradients from slopes."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

DISTANCES = ("l1", "l2", "charbonnier")


def distance_of(residual: Tensor, distance: str, eps: float) -> Tensor:
    if distance == "l1":
        return residual.abs()
    return residual * residual if distance == "l2" else (residual * residual + eps * eps).sqrt()


def slope_of(residual: Tensor, distance: str, eps: float) -> Tensor:
    """The derivative of :func:`distance_of`."""
    if distance == "l1":
        return residual.sign()
    return 2 * residual if distance == "l2" else residual / (residual * residual + eps * eps).sqrt()


def seen(places: Sequence[Tensor], image: Tensor) -> Tensor:
    """Which places (u, v), each (B, h, w), lie between four pixels of an image (B, C, H, W): (B, 1, h, w)."""
    height, width = image.shape[2:]
    u, v = (x.detach() for x in places)
    return ((u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1))[:, None]


def gradient_from(slopes: Tensor, grad: Tensor, tensor: Tensor) -> Tensor:
    """The gradient to `tensor`, (B, ...) or (1, ...) for all samples, from its slopes in each sample and what these weigh.

    One sample and no sum are the common case, in which each step of torch's costs as much as a kernel.
    """
    found = slopes * (grad if len(grad) == 1 else grad.view(-1, *[1] * (slopes.dim() - 1)))
    return found if found.shape == tensor.shape else found.sum_to_size(tensor.shape)
