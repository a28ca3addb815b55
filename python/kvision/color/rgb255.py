"""Conversions of colors between [0, 1] and [0, 255], and of unit normals stored in [0, 255]."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import floats
from kvision._leading import apply_on_batch
from kvision._ops import with_kernel_casts
from kvision.color.scale_shift import scale_shift
from kvision.core.exceptions import ImageError


def _unscaled(x: Tensor) -> Tensor:
    return x / 255


def _normals(x: Tensor) -> Tensor:
    n = x - 127.5  # 255 / 2 times the normal
    length = torch.linalg.vector_norm(n, dim=1, keepdim=True)
    return n / torch.where(length == 0, 1, length)  # the zero vector stays zero


_rgb255_to_rgb = with_kernel_casts(_unscaled)
_rgb255_to_normals = with_kernel_casts(_normals)


def _rgb_to_rgb255(x: Tensor) -> Tensor:
    return scale_shift(x, 1.0, 0.0, True).mul_(255)


@with_kernel_casts
def _normals_to_rgb255(n: Tensor) -> Tensor:
    return scale_shift(n, 0.5, 0.5, True).mul_(255)


def rgb_to_rgb255(image: Tensor) -> Tensor:
    """Scale colors from [0, 1] to [0, 255], clamped.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1]. Integers are computed in float32.

    Returns:
        Images of the same shape, floating point, not rounded.

    Raises:
        TypeCheckError: image is not a tensor.
        ImageError: image is not (*, 3, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_rgb255(torch.tensor([0.0, 0.5, 1.5]).view(3, 1, 1)).flatten()
        tensor([  0.0000, 127.5000, 255.0000])
    """
    _check.channels("rgb_to_rgb255", "image", image, 3, ImageError)
    return apply_on_batch(_rgb_to_rgb255, floats(image))


def rgb255_to_rgb(image: Tensor) -> Tensor:
    """Scale colors from [0, 255] to [0, 1].

    Args:
        image: RGB images (*, 3, H, W) in [0, 255]. Integers give float32.

    Returns:
        Images of the same shape, floating point, not clamped.

    Raises:
        TypeCheckError: image is not a tensor.
        ImageError: image is not (*, 3, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb255_to_rgb(torch.tensor([0, 51, 255], dtype=torch.uint8).view(3, 1, 1)).flatten()
        tensor([0.0000, 0.2000, 1.0000])
    """
    _check.channels("rgb255_to_rgb", "image", image, 3, ImageError)
    return apply_on_batch(_rgb255_to_rgb, floats(image))


def rgb255_to_normals(image: Tensor) -> Tensor:
    """Unit normals from the colors in [0, 255] of a normal map: 2 x / 255 - 1, scaled to length 1.

    Args:
        image: normal maps (*, 3, H, W) in [0, 255], the channels x, y, z. Integers are computed in float32.

    Returns:
        Normals of the same shape, in [-1, 1]; 0 where the color is 127.5 throughout and so has no direction.

    Raises:
        TypeCheckError: image is not a tensor.
        ImageError: image is not (*, 3, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb255_to_normals(torch.tensor([127.5, 127.5, 255.0]).view(3, 1, 1)).flatten()
        tensor([0., 0., 1.])
    """
    _check.channels("rgb255_to_normals", "image", image, 3, ImageError)
    return apply_on_batch(_rgb255_to_normals, floats(image))


def normals_to_rgb255(image: Tensor) -> Tensor:
    """Colors of a normal map from unit normals: 255 (n + 1) / 2, clamped to [0, 255].

    Args:
        image: normals (*, 3, H, W) in [-1, 1], the channels x, y, z. Integers are computed in float32.

    Returns:
        Images of the same shape, floating point, not rounded.

    Raises:
        TypeCheckError: image is not a tensor.
        ImageError: image is not (*, 3, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.normals_to_rgb255(torch.tensor([0.0, 0.0, 1.0]).view(3, 1, 1)).flatten()
        tensor([127.5000, 127.5000, 255.0000])
    """
    _check.channels("normals_to_rgb255", "image", image, 3, ImageError)
    return apply_on_batch(_normals_to_rgb255, floats(image))


class RgbToRgb255(nn.Module):
    """Module form of :func:`rgb_to_rgb255`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToRgb255()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_rgb255(image)


class Rgb255ToRgb(nn.Module):
    """Module form of :func:`rgb255_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.Rgb255ToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb255_to_rgb(image)


class Rgb255ToNormals(nn.Module):
    """Module form of :func:`rgb255_to_normals`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.Rgb255ToNormals()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb255_to_normals(image)


class NormalsToRgb255(nn.Module):
    """Module form of :func:`normals_to_rgb255`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.NormalsToRgb255()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return normals_to_rgb255(image)
