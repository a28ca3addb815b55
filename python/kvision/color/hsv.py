"""Hue, saturation and value."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import floats
from kvision._leading import on_batch
from kvision._modules import FunctionModule
from kvision.color.hue import hue, lack
from kvision.color.program import step


def _reference(x: Tensor, eps: float) -> Tensor:
    value = x.amax(1)
    chroma = value - x.amin(1)
    saturation = chroma / torch.where(value == 0, 1, value + eps)
    return torch.stack([hue(x, value, chroma), saturation, value], 1)


def _inverse(x: Tensor) -> Tensor:
    h, saturation, value = x.unbind(1)
    return value[:, None] - (value * saturation)[:, None] * lack(h)


_rgb_to_hsv = step("rgb_to_hsv", _reference)
_hsv_to_rgb = step("hsv_to_rgb", _inverse)


def rgb_to_hsv(image: Tensor, eps: float = 1e-8) -> Tensor:
    """RGB to hue, saturation and value.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1]. Integers are computed in float32, unscaled.
        eps: added to the value where the chroma is divided by it.

    Returns:
        Images of the same shape: hue in radians in [0, 2 pi), saturation and value in [0, 1]. Greys have hue 0, black has
        saturation 0. Where channels tie for the highest, red counts before green and green before blue.

    Raises:
        TypeCheckError: image is no tensor, eps no number.
        ShapeError: image is not (*, 3, H, W).
        ValueCheckError: eps is negative.

    Source: A. R. Smith, "Color gamut transform pairs" (1978).

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_hsv(torch.tensor([0.0, 0.5, 0.25]).view(3, 1, 1)).flatten()
        tensor([2.6180, 1.0000, 0.5000])
    """
    _check.channels("rgb_to_hsv", "image", image, 3)
    eps = _check.number("rgb_to_hsv", "eps", eps, minimum=0)
    return on_batch(_rgb_to_hsv, floats(image), eps)


def hsv_to_rgb(image: Tensor) -> Tensor:
    """Hue, saturation and value to RGB.

    Args:
        image: HSV images (*, 3, H, W): hue in radians, taken modulo 2 pi, saturation and value in [0, 1]. Integers are
            computed in float32.

    Returns:
        RGB images of the same shape, in [0, 1].

    Raises:
        TypeCheckError: image is no tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: A. R. Smith, "Color gamut transform pairs" (1978).

    Example:
        >>> import math, torch, kvision as K
        >>> K.color.hsv_to_rgb(torch.tensor([math.pi, 1.0, 0.5]).view(3, 1, 1)).flatten()
        tensor([0.0000, 0.5000, 0.5000])
    """
    _check.channels("hsv_to_rgb", "image", image, 3)
    return on_batch(_hsv_to_rgb, floats(image))


class RgbToHsv(FunctionModule):
    """Module form of :func:`rgb_to_hsv`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToHsv()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, eps: float = 1e-8) -> None:
        super().__init__(eps=eps)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_hsv(image, self.eps)


class HsvToRgb(nn.Module):
    """Module form of :func:`hsv_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.HsvToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return hsv_to_rgb(image)
