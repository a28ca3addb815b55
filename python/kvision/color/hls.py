"""Hue, lightness and saturation."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._leading import apply_on_batch
from kvision._modules import FunctionModule
from kvision.color.codes import are_codes, decoder, encoder, of_rgb, values
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


def _lighten(x: Tensor, limit: float | Tensor, factor: float | Tensor) -> Tensor:
    """HLS images with lightness below a limit times a factor, clamped to [0, 1]."""
    hue, lightness, saturation = x.split(1, 1)
    lighter = torch.where(lightness < limit, clamp(lightness * factor, 0, 1), lightness)
    return torch.cat([hue, lighter, saturation], 1)


step("lightness_raw", _lighten)  # of programs alone
_rgb_to_hls = step("rgb_to_hls", _reference)
_hls_to_rgb = step("hls_to_rgb", _inverse)
_CODES = (180 / math.tau, 255.0, 255.0), (0.0, 0.0, 0.0)  # the scale and the offset of OpenCV's bytes
_encode, _decode = encoder("rgb_to_hls", *_CODES), decoder("hls_to_rgb", *_CODES)


def rgb_to_hls(image: Tensor, eps: float = 1e-8, opencv: bool = False) -> Tensor:
    """RGB to hue, lightness and saturation.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1]; bytes are 255ths, other integers computed in float32, unscaled.
        eps: added to the divisors of hue and saturation that are not 0.
        opencv: take uint8 images and give the 8-bit codes of `cv2.cvtColor`: hue in 180ths of a turn,
            lightness and saturation in 255ths.

    Returns:
        Images of the same shape: hue in radians in [0, 2 pi), lightness and saturation in [0, 1]. Grays have hue and
        saturation 0. Where channels tie for the highest, red counts before green and green before blue.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, eps not a number.
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
    if are_codes("rgb_to_hls", image, opencv):
        return apply_on_batch(_encode, image, eps)
    return of_rgb(_rgb_to_hls, image, eps)


def hls_to_rgb(image: Tensor, opencv: bool = False) -> Tensor:
    """Hue, lightness and saturation to RGB.

    Args:
        image: HLS images (*, 3, H, W): hue in radians, taken modulo 2 pi, lightness and saturation in [0, 1]. Integers
            are computed in float32.
        opencv: take the 8-bit codes of :func:`rgb_to_hls` with opencv, and give uint8 images.

    Returns:
        RGB images of the same shape, in [0, 1].

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, or uint8 without.
        ShapeError: image is not (*, 3, H, W).

    Source: G. H. Joblove and D. Greenberg, "Color spaces for computer graphics" (1978).

    Example:
        >>> import math, torch, kvision as K
        >>> K.color.hls_to_rgb(torch.tensor([math.pi, 0.25, 1.0]).view(3, 1, 1)).flatten()
        tensor([0.0000, 0.5000, 0.5000])
    """
    _check.channels("hls_to_rgb", "image", image, 3)
    if are_codes("hls_to_rgb", image, opencv):
        return apply_on_batch(_decode, image)
    return apply_on_batch(_hls_to_rgb, values("hls_to_rgb", image))


class RgbToHls(FunctionModule):
    """Module form of :func:`rgb_to_hls`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToHls()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_hls(image, opencv=self.opencv)


class HlsToRgb(FunctionModule):
    """Module form of :func:`hls_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.HlsToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return hls_to_rgb(image, opencv=self.opencv)
