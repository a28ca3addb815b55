"""Sobel edge magnitude."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import pixels
from kvision._ops import register, vjp
from kvision.core.border import pad

__all__ = ["Sobel", "sobel"]


def _reference(x: Tensor, normalized: bool, eps: float) -> Tensor:
    p = pad(x, ((1, 1), (1, 1)), "replicate")
    dx = p[..., 2:] - p[..., :-2]
    dy = p[..., 2:, :] - p[..., :-2, :]
    gx = dx[..., :-2, :] + 2 * dx[..., 1:-1, :] + dx[..., 2:, :]
    gy = dy[..., :-2] + 2 * dy[..., 1:-1] + dy[..., 2:]
    scale = 1 / 8 if normalized else 1
    return root((gx * scale) ** 2 + (gy * scale) ** 2 + eps)


def root(x: Tensor) -> Tensor:
    """The square root, with gradient 0 at 0."""
    zero = x == 0
    return torch.where(zero, 0, torch.where(zero, 1, x).sqrt())


_sobel = register("sobel", _reference, gradients="input: sobel_backward", bytes=True, float_results=True)
_sobel_backward = register("sobel_backward", vjp(_reference), layout_of=1)


def sobel(input: Tensor, normalized: bool = True, eps: float = 1e-6) -> Tensor:
    r"""Magnitude of the Sobel gradient, channel by channel: :math:`\sqrt{g_x^2 + g_y^2 + \epsilon}`.

    The border is replicated.

    Args:
        input: images of shape (B, C, H, W). Integers are computed in float32.
        normalized: divide the gradients by 8, so that a ramp of slope 1 has magnitude 1.
        eps: added under the root, which keeps the gradient finite on flat images. A flat image gives sqrt(eps).

    Returns:
        Magnitudes of shape (B, C, H, W).

    Raises:
        TypeError: `input` is not a tensor of real numbers, `normalized` not a bool, `eps` not a number.
        ValueError: `input` is not of shape (B, C, H, W), `eps` is negative.

    Source: I. Sobel and G. Feldman, "A 3x3 isotropic gradient operator for image processing" (1968).

    Example:
        >>> import torch, kvision as K
        >>> ramp = torch.arange(4.0).expand(1, 1, 3, 4)
        >>> K.filters.sobel(ramp)[0, 0, 1]
        tensor([0.5000, 1.0000, 1.0000, 0.5000])
    """
    _check.images("sobel", "input", input)
    _check.flag("sobel", "normalized", normalized)
    eps = _check.number("sobel", "eps", eps, minimum=0)
    return _sobel(pixels(input), normalized, eps)


class Sobel(nn.Module):
    """Module form of :func:`sobel`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.Sobel()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, normalized: bool = True, eps: float = 1e-6) -> None:
        super().__init__()
        self.normalized = normalized
        self.eps = eps

    def __repr__(self) -> str:
        return f"{type(self).__name__}(normalized={self.normalized}, eps={self.eps})"

    def forward(self, input: Tensor) -> Tensor:
        return sobel(input, self.normalized, self.eps)
