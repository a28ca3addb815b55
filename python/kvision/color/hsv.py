"""Hue, saturation and value."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._leading import apply_on_batch
from kvision._modules import FunctionModule
from kvision.color.codes import are_codes, decoder, of_rgb, values
from kvision.color.hue import hue, lack, quotient
from kvision.color.program import step


def _reference(x: Tensor, eps: float) -> Tensor:
    value, lowest = x.amax(1), x.amin(1)
    saturation = quotient(value - lowest, torch.where(value == 0, 1, value + eps))
    return torch.stack([hue(x), saturation, value], 1)


def _inverse(x: Tensor) -> Tensor:
    h, saturation, value = x.unbind(1)
    return value[:, None] - (value * saturation)[:, None] * lack(h)


def _of_bytes(x: Tensor) -> Tensor:
    """OpenCV's HSV of bytes over 255. It divides by products with rounded tables in 4096ths."""
    levels = (255 * x).round()
    value = levels.amax(1)
    chroma = value - levels.amin(1)
    r, g, b = levels.unbind(1)
    ahead = torch.where(value == r, g - b, torch.where(value == g, b - r + 2 * chroma, r - g + 4 * chroma))
    hue = _quotient(ahead, (30 * 4096 / chroma.clamp(min=1)).round())
    saturation = _quotient(chroma, (255 * 4096 / value.clamp(min=1)).round())
    return torch.stack([torch.where(hue < 0, hue + 180, hue), saturation, value], 1) / 255


def _quotient(x: Tensor, table: Tensor) -> Tensor:
    """floor(x * table / 4096 + 1 / 2), in two parts, because float32 cannot represent 28 bits."""
    high = (table / 4096).floor()
    return x * high + (x * (table - 4096 * high) / 4096 + 0.5).floor()


_rgb_to_hsv = step("rgb_to_hsv", _reference)
_hsv_u8 = step("hsv_u8", _of_bytes)
_hsv_to_rgb = step("hsv_to_rgb", _inverse)
_decode = decoder("hsv_to_rgb", (180 / math.tau, 255.0, 255.0), (0.0, 0.0, 0.0))


def rgb_to_hsv(image: Tensor, eps: float = 1e-8, opencv: bool = False) -> Tensor:
    """RGB to hue, saturation and value.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1]; bytes are 255ths, other integers computed in float32, unscaled.
        eps: added to the value where the chroma is divided by it.
        opencv: take uint8 images and give what `cv2.cvtColor` gives with COLOR_RGB2HSV: hue in [0, 180), saturation and
            value in [0, 255], as uint8.

    Returns:
        Images of the same shape: hue in radians in [0, 2 pi), saturation and value in [0, 1]. Grays have hue 0, black has
        saturation 0. Where channels tie for the highest, red counts before green and green before blue.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv; eps not a number, opencv not a bool.
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
    if are_codes("rgb_to_hsv", image, opencv):
        return apply_on_batch(_hsv_u8, image)
    return of_rgb(_rgb_to_hsv, image, eps)


def hsv_to_rgb(image: Tensor, opencv: bool = False) -> Tensor:
    """Hue, saturation and value to RGB.

    Args:
        image: HSV images (*, 3, H, W): hue in radians, taken modulo 2 pi, saturation and value in [0, 1]. Integers are
            computed in float32.
        opencv: take and give uint8 images in the ranges of `cv2.cvtColor`: hue in [0, 180), all others in [0, 255].

    Returns:
        RGB images of the same shape, in [0, 1].

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, or uint8 without; opencv not a bool.
        ShapeError: image is not (*, 3, H, W).

    Source: A. R. Smith, "Color gamut transform pairs" (1978).

    Example:
        >>> import math, torch, kvision as K
        >>> K.color.hsv_to_rgb(torch.tensor([math.pi, 1.0, 0.5]).view(3, 1, 1)).flatten()
        tensor([0.0000, 0.5000, 0.5000])
    """
    _check.channels("hsv_to_rgb", "image", image, 3)
    if are_codes("hsv_to_rgb", image, opencv):
        return apply_on_batch(_decode, image)
    return apply_on_batch(_hsv_to_rgb, values("hsv_to_rgb", image))


class RgbToHsv(FunctionModule):
    """Module form of :func:`rgb_to_hsv`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToHsv()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, eps: float = 1e-8, opencv: bool = False) -> None:
        super().__init__(eps=eps, opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_hsv(image, self.eps, self.opencv)


class HsvToRgb(FunctionModule):
    """Module form of :func:`hsv_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.HsvToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return hsv_to_rgb(image, self.opencv)
