"""CIE L*a*b*."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._clamp import clamp
from kvision._dtype import floats
from kvision._leading import apply_on_batch
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


def rgb_to_lab(image: Tensor) -> Tensor:
    """sRGB to CIE L*a*b*, for the white D65.

    Args:
        image: sRGB images (*, 3, H, W) in [0, 1]. Integers are computed in float32, unscaled.

    Returns:
        Images of the same shape: L in [0, 100], a and b in about [-127, 127]; grays have a and b near 0.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: CIE 15, IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_lab(torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1)).flatten().round()
        tensor([53., 80., 67.])
    """
    _check.channels("rgb_to_lab", "image", image, 3)
    return apply_on_batch(_rgb_to_lab, floats(image))


def lab_to_rgb(image: Tensor, clip: bool = True) -> Tensor:
    """CIE L*a*b* to sRGB, the inverse of :func:`rgb_to_lab`.

    Args:
        image: Lab images (*, 3, H, W): L in [0, 100], a and b in about [-127, 127].
        clip: clamp the result to [0, 1]; many Lab colors lie outside of sRGB.

    Returns:
        sRGB images of the same shape.

    Raises:
        TypeCheckError: image is not a tensor, clip not a bool.
        ShapeError: image is not (*, 3, H, W).

    Source: CIE 15, IEC 61966-2-1.

    Example:
        >>> import torch, kvision as K
        >>> K.color.lab_to_rgb(torch.tensor([100.0, 0.0, 0.0]).view(3, 1, 1)).flatten().round(decimals=3)
        tensor([1., 1., 1.])
    """
    _check.channels("lab_to_rgb", "image", image, 3)
    _check.flag("lab_to_rgb", "clip", clip)
    return apply_on_batch(_lab_to_rgb, floats(image), clip)


class RgbToLab(nn.Module):
    """Module form of :func:`rgb_to_lab`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToLab()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_lab(image)


class LabToRgb(nn.Module):
    """Module form of :func:`lab_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.LabToRgb()(torch.rand(2, 3, 4, 5), clip=False).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor, clip: bool = True) -> Tensor:
        return lab_to_rgb(image, clip)
