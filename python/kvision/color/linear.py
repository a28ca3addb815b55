"""The transfer function of sRGB: from gamma-encoded values to linear light and back."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._clamp import clamp
from kvision.color.codes import of_rgb
from kvision.color.program import step

# The clamps keep the gradients of the root and the power finite where `where` selects the other branch.


def decoded(x: Tensor) -> Tensor:
    """sRGB values to linear light."""
    bright = ((clamp(x, 0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(x > 0.04045, bright, x / 12.92)


def encoded(x: Tensor) -> Tensor:
    """Linear light to sRGB values."""
    bright = 1.055 * clamp(x, 0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(x > 0.0031308, bright, 12.92 * x)


_rgb_to_linear_rgb = step("rgb_to_linear_rgb", decoded)
_linear_rgb_to_rgb = step("linear_rgb_to_rgb", encoded)


def rgb_to_linear_rgb(image: Tensor) -> Tensor:
    """sRGB to linear light: x / 12.92 up to 0.04045, ((x + 0.055) / 1.055)^2.4 above.

    Args:
        image: sRGB images (*, 3, H, W) in [0, 1]; bytes are 255ths, other integers computed in float32, unscaled.

    Returns:
        Images of the same shape, of linear light in [0, 1].

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_linear_rgb(torch.tensor([0.0, 0.5, 1.0]).view(3, 1, 1)).flatten()
        tensor([0.0000, 0.2140, 1.0000])
    """
    _check.channels("rgb_to_linear_rgb", "image", image, 3)
    return of_rgb(_rgb_to_linear_rgb, image)


def linear_rgb_to_rgb(image: Tensor) -> Tensor:
    """Linear light to sRGB: 12.92 x up to 0.0031308, 1.055 x^(1 / 2.4) - 0.055 above.

    Args:
        image: images (*, 3, H, W) of linear light in [0, 1]; bytes are 255ths, other integers computed in float32.

    Returns:
        sRGB images of the same shape, not clamped.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.linear_rgb_to_rgb(torch.tensor([0.0, 0.2140, 1.0]).view(3, 1, 1)).flatten()
        tensor([0.0000, 0.5000, 1.0000])
    """
    _check.channels("linear_rgb_to_rgb", "image", image, 3)
    return of_rgb(_linear_rgb_to_rgb, image)


class RgbToLinearRgb(nn.Module):
    """Module form of :func:`rgb_to_linear_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToLinearRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_linear_rgb(image)


class LinearRgbToRgb(nn.Module):
    """Module form of :func:`linear_rgb_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.LinearRgbToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return linear_rgb_to_rgb(image)
