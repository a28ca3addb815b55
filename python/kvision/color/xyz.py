"""CIE XYZ."""

from __future__ import annotations

from torch import Tensor, nn

from kvision import _check
from kvision._dtype import floats
from kvision._leading import apply_on_batch
from kvision.color.matrix import affine, inverse, mixed

XYZ_FROM_RGB = (
    (0.412453, 0.357580, 0.180423),
    (0.212671, 0.715160, 0.072169),
    (0.019334, 0.119193, 0.950227),
)
RGB_FROM_XYZ = inverse(XYZ_FROM_RGB)
WHITE = (0.95047, 1.0, 1.08883)  # D65


def xyz_of_rgb(x: Tensor) -> Tensor:
    return mixed(x, XYZ_FROM_RGB)


def rgb_of_xyz(x: Tensor) -> Tensor:
    return mixed(x, RGB_FROM_XYZ)


_rgb_to_xyz = affine(XYZ_FROM_RGB)
_xyz_to_rgb = affine(RGB_FROM_XYZ)


def rgb_to_xyz(image: Tensor) -> Tensor:
    """RGB to CIE XYZ by the matrix of the sRGB primaries and the white D65.

    The colors must be linear light. :func:`rgb_to_linear_rgb` converts gamma-encoded colors.

    Args:
        image: RGB images (*, 3, H, W). Integers are computed in float32.

    Returns:
        XYZ images of the same shape; of colors in [0, 1] they are in [0, 0.950456], [0, 1] and [0, 1.088754].

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.709, CIE 15.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_xyz(torch.ones(3, 1, 1)).flatten()
        tensor([0.9505, 1.0000, 1.0888])
    """
    _check.channels("rgb_to_xyz", "image", image, 3)
    return apply_on_batch(_rgb_to_xyz, floats(image))


def xyz_to_rgb(image: Tensor) -> Tensor:
    """CIE XYZ to RGB, the inverse of :func:`rgb_to_xyz`.

    Args:
        image: XYZ images (*, 3, H, W). Integers are computed in float32.

    Returns:
        RGB images of the same shape, of linear light, not clamped.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.709, CIE 15.

    Example:
        >>> import torch, kvision as K
        >>> K.color.xyz_to_rgb(torch.tensor([0.412453, 0.212671, 0.019334]).view(3, 1, 1)).flatten().round(decimals=4).abs()
        tensor([1., 0., 0.])
    """
    _check.channels("xyz_to_rgb", "image", image, 3)
    return apply_on_batch(_xyz_to_rgb, floats(image))


class RgbToXyz(nn.Module):
    """Module form of :func:`rgb_to_xyz`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToXyz()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_xyz(image)


class XyzToRgb(nn.Module):
    """Module form of :func:`xyz_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.XyzToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return xyz_to_rgb(image)
