"""CIE L*a*b*."""

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

# Below this threshold a linear function replaces the cube root. Its coefficients are rounded as in OpenCV.
DARKEST, SLOPE, FOOT = 0.008856, 7.787, 4 / 29
DARKEST_ROOT = 0.2068966


def _root(t: Tensor) -> Tensor:
    return torch.where(t > DARKEST, clamp(t, DARKEST) ** (1 / 3), SLOPE * t + FOOT)


def _cube(t: Tensor) -> Tensor:
    return torch.where(t > DARKEST_ROOT, t**3, (t - FOOT) / SLOPE)


def _reference(x: Tensor) -> Tensor:
    fx, fy, fz = (_root(c / white) for c, white in zip(xyz_of_rgb(decoded(x)).unbind(1), WHITE))
    return torch.stack([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)], 1)


def _inverse(x: Tensor, clip: bool) -> Tensor:
    lightness, a, b = x.unbind(1)
    fy = (lightness + 16) / 116
    roots = (fy + a / 500, fy, clamp(fy - b / 200, 0))
    xyz = torch.stack([_cube(f) * white for f, white in zip(roots, WHITE)], 1)
    rgb = encoded(rgb_of_xyz(xyz))
    return clamp(rgb, 0, 1) if clip else rgb


_rgb_to_lab = step("rgb_to_lab", _reference)
_lab_to_rgb = step("lab_to_rgb", _inverse)
_CODES = (2.55, 1.0, 1.0), (0.0, 128.0, 128.0)  # the scale and the offset of OpenCV's bytes
_encode, _decode = encoder("rgb_to_lab", *_CODES), decoder("lab_to_rgb", *_CODES)


def rgb_to_lab(image: Tensor, opencv: bool = False) -> Tensor:
    """sRGB to CIE L*a*b*, for the white D65.

    Args:
        image: sRGB images (*, 3, H, W) in [0, 1]; bytes are 255ths, other integers computed in float32, unscaled.
        opencv: take uint8 images and give the 8-bit codes of `cv2.cvtColor`: L in 255ths of 100, a and b plus 128.

    Returns:
        Images of the same shape: L in [0, 100], a and b in about [-127, 127]; grays have a and b near 0.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv.
        ShapeError: image is not (*, 3, H, W).

    Source: CIE 15, IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_lab(torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1)).flatten().round()
        tensor([53., 80., 67.])
    """
    _check.channels("rgb_to_lab", "image", image, 3)
    if are_codes("rgb_to_lab", image, opencv):
        return apply_on_batch(_encode, image)
    return of_rgb(_rgb_to_lab, image)


def lab_to_rgb(image: Tensor, clip: bool = True, opencv: bool = False) -> Tensor:
    """CIE L*a*b* to sRGB, the inverse of :func:`rgb_to_lab`.

    Args:
        image: Lab images (*, 3, H, W): L in [0, 100], a and b in about [-127, 127].
        clip: clamp the result to [0, 1]; many Lab colors lie outside of sRGB.
        opencv: take the 8-bit codes of :func:`rgb_to_lab` with opencv, and give uint8 images.

    Returns:
        sRGB images of the same shape.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, or uint8 without, clip not a bool.
        ShapeError: image is not (*, 3, H, W).

    Source: CIE 15, IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.lab_to_rgb(torch.tensor([100.0, 0.0, 0.0]).view(3, 1, 1)).flatten().round(decimals=3)
        tensor([1., 1., 1.])
    """
    _check.channels("lab_to_rgb", "image", image, 3)
    _check.flag("lab_to_rgb", "clip", clip)
    if are_codes("lab_to_rgb", image, opencv):
        return apply_on_batch(_decode, image, float(clip))
    return apply_on_batch(_lab_to_rgb, values("lab_to_rgb", image), clip)


class RgbToLab(FunctionModule):
    """Module form of :func:`rgb_to_lab`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToLab()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_lab(image, opencv=self.opencv)


class LabToRgb(FunctionModule):
    """Module form of :func:`lab_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.LabToRgb()(torch.rand(2, 3, 4, 5), clip=False).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor, clip: bool = True) -> Tensor:
        return lab_to_rgb(image, clip, self.opencv)
