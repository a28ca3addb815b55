"""Functions of the losses that compare warped images: distances, their derivatives, masks and weighted gradients."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from torch import Tensor

from kvision._choices import Distance

DISTANCES = get_args(Distance)


def distance_of(residual: Tensor, distance: Distance, eps: float) -> Tensor:
    if distance == "l1":
        return residual.abs()
    return residual * residual if distance == "l2" else (residual * residual + eps * eps).sqrt()


def distance_derivative(residual: Tensor, distance: Distance, eps: float) -> Tensor:
    """The derivative of :func:`distance_of`."""
    if distance == "l1":
        return residual.sign()
    return 2 * residual if distance == "l2" else residual / (residual * residual + eps * eps).sqrt()


def in_bounds_mask(coords: Sequence[Tensor], image: Tensor) -> Tensor:
    """Mask (B, 1, h, w) of the coordinates (u, v), (B, h, w) each, that lie between four pixels of an image (B, C, H, W)."""
    height, width = image.shape[2:]
    u, v = (x.detach() for x in coords)
    return ((u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1))[:, None]


def weighted_gradient(derivatives: Tensor, grad: Tensor, tensor: Tensor) -> Tensor:
    """The gradient of `tensor`, (B, ...) or (1, ...) for all samples, from its derivatives in each sample times their weights.

    One sample without a sum is the common case, in which each torch operation costs as much as a kernel.
    """
    weighted = derivatives * (grad if grad.shape[0] == 1 else grad.view(-1, *[1] * (derivatives.dim() - 1)))
    return weighted if weighted.shape == tensor.shape else weighted.sum_to_size(tensor.shape)
