"""Color to gray and back."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._leading import apply_on_batch
from kvision._limits import LUMA as LUMA
from kvision._modules import FunctionModule
from kvision.color.program import step
from kvision.core.exceptions import TypeCheckError

_BYTE_LUMA = (9798.0, 19235.0, 3735.0)  # the same weights in 32768ths


def _weighted(x: Tensor, wr: float | Tensor, wg: float | Tensor, wb: float | Tensor) -> Tensor:
    r, g, b = x.split(1, 1)
    return wr * r + wg * g + wb * b


def _fixed_point(x: Tensor, wr: float, wg: float, wb: float) -> Tensor:
    """OpenCV's 15-bit luma of bytes over 255. Sums stay below 2^24, so float32 is exact."""
    r, g, b = (255 * x).round().split(1, 1)
    return ((wr * r + wg * g + wb * b + 16384) / 32768).floor() / 255


def _rounded(x: Tensor, wr: Tensor, wg: Tensor, wb: Tensor) -> Tensor:
    """The sum of bytes over 255, whose halves then are exact."""
    return _weighted((255 * x).round(), wr, wg, wb).round() / 255


weighted_sum = step("weighted_sum", _weighted)
_luma_u8_fixed_point = step("luma_u8_fixed_point", _fixed_point)
luma_u8 = step("luma_u8", _rounded)


def rgb_to_grayscale(image: Tensor, rgb_weights: Tensor | None = None) -> Tensor:
    """Gray as the weighted sum of red, green and blue.

    Args:
        image: RGB images (*, 3, H, W), floating point or uint8, in any range.
        rgb_weights: a weight for each channel, (3,); default: 0.299, 0.587, 0.114, whose gray is called luma.

    Returns:
        Gray images (*, 1, H, W) in the type of the image. uint8 has the levels of OpenCV: fixed-point weights of 15 bits
        where none are given; otherwise rounded half to even and saturated.

    Raises:
        TypeCheckError: image is not a tensor, or of integers other than uint8; rgb_weights is not a real tensor.
        ShapeError: image is not (*, 3, H, W), rgb_weights not (3,).
        DeviceError: rgb_weights on another device; those in CPU memory are moved.

    Source: ITU-R BT.601.

    Example:
        >>> import torch, kvision as K
        >>> red_green_blue = torch.eye(3)[:, None]
        >>> K.color.rgb_to_grayscale(red_green_blue)
        tensor([[[0.2990, 0.5870, 0.1140]]])
        >>> K.color.rgb_to_grayscale(red_green_blue, torch.tensor([0.0, 1.0, 0.0]))
        tensor([[[0., 1., 0.]]])
    """
    _check.channels("rgb_to_grayscale", "image", image, 3)
    _floats_or_bytes("rgb_to_grayscale", image)
    if rgb_weights is not None:
        _check.shape("rgb_to_grayscale", "rgb_weights", rgb_weights, 3)
        rgb_weights = _check.to_device_of("rgb_to_grayscale", image, "rgb_weights", rgb_weights, of="image")
        weighted = luma_u8 if image.dtype == torch.uint8 else weighted_sum
        return apply_on_batch(weighted, image, rgb_weights.reshape(1, 1, 3))
    if image.dtype == torch.uint8:
        return apply_on_batch(_luma_u8_fixed_point, image, *_BYTE_LUMA)
    return apply_on_batch(weighted_sum, image, *LUMA)


def bgr_to_grayscale(image: Tensor) -> Tensor:
    """Gray as 0.299 R + 0.587 G + 0.114 B, from blue, green and red.

    Args:
        image: BGR images (*, 3, H, W), floating point or uint8, in any range.

    Returns:
        Gray images (*, 1, H, W) in the type of the image; uint8 as :func:`rgb_to_grayscale` gives it.

    Raises:
        TypeCheckError: image is not a tensor, or of integers other than uint8.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.601.

    Example:
        >>> import torch, kvision as K
        >>> blue_green_red = torch.eye(3)[:, None]
        >>> K.color.bgr_to_grayscale(blue_green_red)
        tensor([[[0.1140, 0.5870, 0.2990]]])
    """
    _check.channels("bgr_to_grayscale", "image", image, 3)
    _floats_or_bytes("bgr_to_grayscale", image)
    if image.dtype == torch.uint8:
        return apply_on_batch(_luma_u8_fixed_point, image, *reversed(_BYTE_LUMA))
    return apply_on_batch(weighted_sum, image, *reversed(LUMA))


def _floats_or_bytes(op: str, image: Tensor) -> None:
    if not image.is_floating_point() and image.dtype != torch.uint8:
        raise TypeCheckError(f"{op}: expected image to be uint8 or floating point, got {image.dtype}")


def grayscale_to_rgb(image: Tensor) -> Tensor:
    """Gray in all three channels.

    Args:
        image: gray images (*, 1, H, W) of any type.

    Returns:
        RGB images (*, 3, H, W) of the same type, in memory of their own.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 1, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.grayscale_to_rgb(torch.rand(2, 1, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """
    _check.channels("grayscale_to_rgb", "image", image, 1)
    return torch.cat([image] * 3, -3)


class RgbToGrayscale(FunctionModule):
    """Module form of :func:`rgb_to_grayscale`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToGrayscale()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 1, 4, 5])
    """

    def __init__(self, rgb_weights: Tensor | None = None) -> None:
        super().__init__(rgb_weights=rgb_weights)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_grayscale(image, self.rgb_weights)


class BgrToGrayscale(nn.Module):
    """Module form of :func:`bgr_to_grayscale`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.BgrToGrayscale()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 1, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return bgr_to_grayscale(image)


class GrayscaleToRgb(nn.Module):
    """Module form of :func:`grayscale_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.GrayscaleToRgb()(torch.rand(2, 1, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return grayscale_to_rgb(image)
