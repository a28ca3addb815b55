"""CIE L*u*v*."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._leading import apply_on_batch
from kvision._modules import FunctionModule
from kvision.color.codes import are_codes, decoder, encoder, of_rgb, values
from kvision.color.linear import decoded, encoded
from kvision.color.program import step
from kvision.color.xyz import WHITE, rgb_of_xyz, xyz_of_rgb

# Lightness is the cube root of luminance, and linear for luminance below this threshold.
DARKEST, SLOPE = 0.008856, 903.3
DARKEST_LIGHTNESS = 7.999625
_SUM = WHITE[0] + 15 * WHITE[1] + 3 * WHITE[2]
WHITE_U, WHITE_V = 4 * WHITE[0] / _SUM, 9 * WHITE[1] / _SUM


def _reference(rgb: Tensor, eps: float) -> Tensor:
    x, y, z = xyz_of_rgb(decoded(rgb)).unbind(1)
    lightness = torch.where(y > DARKEST, 116 * clamp(y, DARKEST) ** (1 / 3) - 16, SLOPE * y)
    total = x + 15 * y + 3 * z + eps
    total = torch.where(total.abs() < 2.0**-100, 1, total)
    u = 13 * lightness * (4 * x / total - WHITE_U)
    v = 13 * lightness * (9 * y / total - WHITE_V)
    return torch.stack([lightness, u, v], 1)


def _inverse(luv: Tensor, eps: float) -> Tensor:
    lightness, u, v = luv.unbind(1)
    y = torch.where(lightness > DARKEST_LIGHTNESS, ((lightness + 16) / 116) ** 3, lightness / SLOPE)
    scale = 13 * lightness + eps
    scale = torch.where(scale == 0, 1, scale)
    u, v = u / scale + WHITE_U, v / scale + WHITE_V
    luminance_over_v = y / (4 * v + eps)
    x, z = 9 * u * luminance_over_v, (12 - 3 * u - 20 * v) * luminance_over_v
    return encoded(rgb_of_xyz(torch.stack([x, y, z], 1)))


_rgb_to_luv = step("rgb_to_luv", _reference)
_luv_to_rgb = step("luv_to_rgb", _inverse)
_CODES = (
    (2.55, 255 / 354, 255 / 262),
    (0.0, 134 * 255 / 354, 140 * 255 / 262),
)  # the scale and the offset of OpenCV's bytes
_encode, _decode = encoder("rgb_to_luv", *_CODES), decoder("luv_to_rgb", *_CODES)


def rgb_to_luv(image: Tensor, eps: float = 1e-12, opencv: bool = False) -> Tensor:
    """sRGB to CIE L*u*v*, for the white D65.

    Args:
        image: sRGB images (*, 3, H, W) in [0, 1]; bytes are 255ths, other integers computed in float32, unscaled.
        eps: added to the divisor X + 15 Y + 3 Z of the chromaticities.
        opencv: take uint8 images and give the 8-bit codes of `cv2.cvtColor`: L in 255ths of 100, u in
            255ths from -134 to 220, v from -140 to 122.

    Returns:
        Images of the same shape: L in [0, 100], u in about [-84, 176], v in about [-135, 108]; grays have u and v near 0.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, eps not a number.
        ShapeError: image is not (*, 3, H, W).
        ValueCheckError: eps is negative.

    Source: CIE 15, IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_luv(torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1)).flatten().round()
        tensor([ 53., 175.,  38.])
    """
    _check.channels("rgb_to_luv", "image", image, 3)
    eps = _check.number("rgb_to_luv", "eps", eps, minimum=0)
    if are_codes("rgb_to_luv", image, opencv):
        return apply_on_batch(_encode, image, eps)
    return of_rgb(_rgb_to_luv, image, eps)


def luv_to_rgb(image: Tensor, eps: float = 1e-12, opencv: bool = False) -> Tensor:
    """CIE L*u*v* to sRGB, the inverse of :func:`rgb_to_luv`.

    Args:
        image: Luv images (*, 3, H, W): L in [0, 100], u in about [-84, 176], v in about [-135, 108].
        eps: added to the divisors 13 L and 4 v'.
        opencv: take the 8-bit codes of :func:`rgb_to_luv` with opencv, and give uint8 images.

    Returns:
        sRGB images of the same shape, not clamped.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, or uint8 without, eps not a number.
        ShapeError: image is not (*, 3, H, W).
        ValueCheckError: eps is negative.

    Source: CIE 15, IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.luv_to_rgb(torch.tensor([100.0, 0.0, 0.0]).view(3, 1, 1)).flatten().round(decimals=3)
        tensor([1., 1., 1.])
    """
    _check.channels("luv_to_rgb", "image", image, 3)
    eps = _check.number("luv_to_rgb", "eps", eps, minimum=0)
    if are_codes("luv_to_rgb", image, opencv):
        return apply_on_batch(_decode, image, eps)
    return apply_on_batch(_luv_to_rgb, values("luv_to_rgb", image), eps)


class RgbToLuv(FunctionModule):
    """Module form of :func:`rgb_to_luv`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToLuv()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_luv(image, opencv=self.opencv)


class LuvToRgb(FunctionModule):
    """Module form of :func:`luv_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.LuvToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return luv_to_rgb(image, opencv=self.opencv)
