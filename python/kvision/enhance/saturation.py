"""Saturation, in HSV or as distance from gray."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._modules import FunctionModule
from kvision.color import rgb_to_grayscale as luma
from kvision.color.hue import quotient
from kvision.color.program import step
from kvision.core.exceptions import ImageError
from kvision.enhance.batch import as_batch, colors, per_pixel, shaped


def _reference(x: Tensor, factor: float | Tensor) -> Tensor:
    # HSV keeps the largest channel v and measures the others by their distance from it: that of the smallest is s * v.
    # To scale s is to scale the distances, until the smallest channel reaches 0.
    v = x.amax(1, keepdim=True)
    span = v - x.amin(1, keepdim=True)
    colorful = span > 0
    most = torch.where(colorful, quotient(clamp(v, 0), torch.where(colorful, span, 1)), 1)
    f = clamp(factor, 0) if isinstance(factor, Tensor) else max(factor, 0)
    return v - (v - x) * torch.where(most < f, most, f)


def _in_hsv(x: Tensor, factor: float | Tensor) -> Tensor:
    h, s, v = x.split(1, 1)
    return torch.cat([h, clamp(s * factor, 0, 1), v], 1)


def _from_gray(x: Tensor, factor: float | Tensor) -> Tensor:
    gray = luma(x)
    return clamp(gray + (x - gray) * factor, 0, 1)


_adjust_saturation = step("saturation", _reference)
_adjust_saturation_raw = step("saturation_raw", _in_hsv)
_adjust_saturation_from_gray = step("saturation_gray", _from_gray)


def adjust_saturation(image: Tensor, factor: float | Tensor) -> Tensor:
    """Adjust the saturation of RGB images: multiply it in HSV and clamp it to [0, 1].

    Args:
        image: (*, 3, H, W), floating point, in [0, 1], or uint8.
        factor: 1 for no change, 0 or less for a gray of the largest channel: a number, or a tensor with the first axes
            of the image, such as (B,).

    Returns:
        The image with other saturation and the same hue and largest channel, differentiable in image and factor.

    Raises:
        TypeCheckError: image is not a tensor of floats or uint8; factor is neither number nor tensor.
        ImageError: image is not (*, 3, H, W).
        ShapeError: factor has axes that the image has not, or differs between channels.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_saturation(torch.tensor([0.8, 0.4, 0.6]).view(3, 1, 1), 0.5).flatten()
        tensor([0.8000, 0.6000, 0.7000])
    """
    colors("adjust_saturation", "image", image)
    amount = per_pixel("adjust_saturation", "factor", factor, image)
    return shaped(_adjust_saturation(as_batch(image), amount), image)


def adjust_saturation_raw(image: Tensor, factor: float | Tensor) -> Tensor:
    """Scale the saturation of an HSV image and clamp it to [0, 1].

    Args:
        image: (*, 3, H, W), floating point: hue, saturation, value.
        factor: 1 for no change, 0 for gray: a number, or a tensor with the first axes of the image, such as (B,).

    Returns:
        The HSV image with other saturation, differentiable in image and factor.

    Raises:
        TypeCheckError, ImageError, ShapeError, DeviceError: as :func:`adjust_saturation`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_saturation_raw(torch.tensor([3.0, 0.4, 0.6]).view(3, 1, 1), 0.5).flatten()
        tensor([3.0000, 0.2000, 0.6000])
    """
    colors("adjust_saturation_raw", "image", image)
    _check.floating("adjust_saturation_raw", "image", image)
    amount = per_pixel("adjust_saturation_raw", "factor", factor, image)
    return shaped(_adjust_saturation_raw(as_batch(image), amount), image)


def adjust_saturation_with_gray_subtraction(image: Tensor, factor: float | Tensor) -> Tensor:
    """Adjust the saturation of RGB images by scaling their difference from their gray, as PIL and torchvision do.

    Args:
        image: (*, 3, H, W), floating point, in [0, 1], or uint8; gray images (*, 1, H, W) come back as they are.
        factor: 1 for no change, 0 for gray: a number, or a tensor with the first axes of the image, such as (B,).

    Returns:
        gray + (image - gray) * factor, clamped to [0, 1], differentiable in image and factor; the gray is
        0.299 R + 0.587 G + 0.114 B.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as :func:`adjust_saturation`.
        ImageError: image is neither (*, 3, H, W) nor (*, 1, H, W).

    Example:
        >>> import torch, kvision as K
        >>> red = torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1)
        >>> K.enhance.adjust_saturation_with_gray_subtraction(red, 0.0).flatten()
        tensor([0.2990, 0.2990, 0.2990])
    """
    op = "adjust_saturation_with_gray_subtraction"
    _check.numbers(op, "image", image)
    _check.floating_or_bytes(op, "image", image)
    if image.dim() < 3 or image.shape[-3] not in (1, 3):
        raise ImageError(f"{op}: expected image of shape (*, 3, H, W) or (*, 1, H, W), got {tuple(image.shape)}")
    amount = per_pixel(op, "factor", factor, image)
    if image.shape[-3] == 1:
        return image
    return shaped(_adjust_saturation_from_gray(as_batch(image), amount), image)


class AdjustSaturation(FunctionModule):
    """Module form of :func:`adjust_saturation`; a factor that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustSaturation(0.0)(torch.tensor([0.8, 0.4, 0.6]).view(3, 1, 1)).flatten()
        tensor([0.8000, 0.8000, 0.8000])
    """

    def __init__(self, saturation_factor: float | Tensor) -> None:
        super().__init__(saturation_factor=saturation_factor)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_saturation(input, self.saturation_factor)


class AdjustSaturationWithGraySubtraction(FunctionModule):
    """Module form of :func:`adjust_saturation_with_gray_subtraction`; a factor that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustSaturationWithGraySubtraction(1.0)(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, saturation_factor: float | Tensor) -> None:
        super().__init__(saturation_factor=saturation_factor)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_saturation_with_gray_subtraction(input, self.saturation_factor)
