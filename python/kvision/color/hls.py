"""Hue, lightness and saturation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import floats
from kvision._leading import apply_on_batch
from kvision.color.hue import hue, lack, quotient
from kvision.color.program import step


def _reference(x: Tensor, eps: float) -> Tensor:
    value, lowest = x.amax(1), x.amin(1)
    total = value + lowest
    room = torch.minimum(total, 2 - total)  # the largest chroma at this lightness
    saturation = quotient(value - lowest, torch.where(room == 0, 1, room + eps))
    return torch.stack([hue(x, eps), total / 2, saturation], 1)


def _inverse(x: Tensor) -> Tensor:
    h, lightness, saturation = x.unbind(1)
    half_chroma = saturation * torch.minimum(lightness, 1 - lightness)
    return (lightness + half_chroma)[:, None] - 2 * half_chroma[:, None] * lack(h)


_rgb_to_hls = step("rgb_to_hls", _reference)
_hls_to_rgb = step("hls_to_rgb", _inverse)


def rgb_to_hls(image: Tensor, eps: float = 1e-8) -> Tensor:
    """RGB to hue, lightness and saturation.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1]. Integers are computed in float32.
        eps: added to the divisors of hue and saturation that are not 0.

    Returns:
        Images of the same shape: hue in radians in [0, 2 pi), lightness and saturation in [0, 1]. Grays have hue and
        saturation 0. Where channels tie for the highest, red counts before green and green before blue.

    Raises:
        TypeCheckError: image is not a tensor, eps not a number.
        ShapeError: image is not (*, 3, H, W).
        ValueCheckError: eps is negative.

    Source: G. H. Joblove and D. Greenberg, "Color spaces for computer graphics" (1978).

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_hls(torch.tensor([0.0, 0.5, 0.25]).view(3, 1, 1)).flatten()
        tensor([2.6180, 0.2500, 1.0000])
    """
    _check.channels("rgb_to_hls", "image", image, 3)
    eps = _check.number("rgb_to_hls", "eps", eps, minimum=0)
    return apply_on_batch(_rgb_to_hls, floats(image), eps)


def hls_to_rgb(image: Tensor) -> Tensor:
    """Hue, lightness and saturation to RGB.

    Args:
        image: HLS images (*, 3, H, W): hue in radians, taken modulo 2 pi, lightness and saturation in [0, 1]. Integers
            are computed in float32.

    Returns:
        RGB images of the same shape, in [0, 1].

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: G. H. Joblove and D. Greenberg, "Color spaces for computer graphics" (1978).

    Example:
        >>> import math, torch, kvision as K
        >>> K.color.hls_to_rgb(torch.tensor([math.pi, 0.25, 1.0]).view(3, 1, 1)).flatten()
        tensor([0.0000, 0.5000, 0.5000])
    """
    _check.channels("hls_to_rgb", "image", image, 3)
    return apply_on_batch(_hls_to_rgb, floats(image))


class RgbToHls(nn.Module):
    """Module form of :func:`rgb_to_hls`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToHls()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_hls(image)


class HlsToRgb(nn.Module):
    """Module form of :func:`hls_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.HlsToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return hls_to_rgb(image)
