"""Hue: colors rotated around the gray axis of HSV."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision.color.hue import hue, lack
from kvision.color.program import step
from kvision.enhance.batch import as_batch, colors, per_pixel, shaped

_TWO_PI = 2 * math.pi


def _reference(x: Tensor, angle: float | Tensor) -> Tensor:
    highest = x.amax(1)
    chroma = highest - x.amin(1)
    rotated = hue(x)[:, None] + angle
    return highest[:, None] - chroma[:, None] * lack(rotated[:, 0])


def _in_hsv(x: Tensor, angle: float | Tensor) -> Tensor:
    h, s, v = x.split(1, 1)
    rotated = torch.remainder(h + angle, _TWO_PI)
    # A tiny negative hue is rounded up to a full turn.
    rotated = torch.where(rotated < _TWO_PI, rotated, rotated - _TWO_PI)
    return torch.cat([rotated, s, v], 1)


_adjust_hue = step("hue", _reference)
_adjust_hue_raw = step("hue_raw", _in_hsv)


def adjust_hue(image: Tensor, factor: float | Tensor) -> Tensor:
    """Rotate the hue of an RGB image by an angle.

    Args:
        image: (*, 3, H, W), floating point, in [0, 1], or uint8.
        factor: angle in radians, 0 for no change, 2 pi / 3 from red to green: a number, or a tensor with the first axes
            of the image, such as (B,).

    Returns:
        The image with other hues and the same saturation and value, differentiable in image and factor.

    Raises:
        TypeCheckError: image is not a tensor of floats or uint8; factor is neither number nor tensor.
        ImageError: image is not (*, 3, H, W).
        ShapeError: factor has axes that the image has not, or differs between channels.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import math, torch, kvision as K
        >>> red = torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1)
        >>> K.enhance.adjust_hue(red, math.pi).flatten()
        tensor([0., 1., 1.])
    """
    colors("adjust_hue", "image", image)
    amount = per_pixel("adjust_hue", "factor", factor, image)
    return shaped(_adjust_hue(as_batch(image), amount), image)


def adjust_hue_raw(image: Tensor, factor: float | Tensor) -> Tensor:
    """Add an angle to the hue of an HSV image, wrapped to [0, 2 pi).

    Args:
        image: (*, 3, H, W), floating point: hue in radians, saturation, value.
        factor: angle in radians: a number, or a tensor with the first axes of the image, such as (B,).

    Returns:
        The HSV image with other hues, differentiable in image and factor.

    Raises:
        TypeCheckError, ImageError, ShapeError, DeviceError: as :func:`adjust_hue`.

    Example:
        >>> import math, torch, kvision as K
        >>> K.enhance.adjust_hue_raw(torch.tensor([6.0, 0.4, 0.6]).view(3, 1, 1), 1.0).flatten()
        tensor([0.7168, 0.4000, 0.6000])
    """
    colors("adjust_hue_raw", "image", image)
    _check.floating("adjust_hue_raw", "image", image)
    amount = per_pixel("adjust_hue_raw", "factor", factor, image)
    return shaped(_adjust_hue_raw(as_batch(image), amount), image)


class AdjustHue(FunctionModule):
    """Module form of :func:`adjust_hue`; a factor that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustHue(0.1)(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, hue_factor: float | Tensor) -> None:
        super().__init__(hue_factor=hue_factor)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_hue(input, self.hue_factor)
