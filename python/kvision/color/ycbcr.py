"""YCbCr: luma, and the differences of blue and red from it."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._leading import apply_on_batch
from kvision._modules import FunctionModule
from kvision.color.codes import are_codes, decoder, encoder, of_rgb, values
from kvision.color.gray import LUMA, weighted_sum
from kvision.color.matrix import affine, affine_numbers

# The scales of b - y and r - y that map them to [-0.5, 0.5].
BLUE, RED = 0.564, 0.713
_R, _G, _B = LUMA
# Of r, g and b, and back; green is such that the luma is y.
YCBCR_FROM_RGB = (LUMA, (-BLUE * _R, -BLUE * _G, BLUE * (1 - _B)), (RED * (1 - _R), -RED * _G, -RED * _B))
RGB_FROM_YCBCR = ((1.0, 0.0, 1 / RED), (1.0, -_B / _G / BLUE, -_R / _G / RED), (1.0, 1 / BLUE, 0.0))
_CENTRE = (-0.5 / RED, (_B / BLUE + _R / RED) / (2 * _G), -0.5 / BLUE)

_rgb_to_ycbcr = affine(YCBCR_FROM_RGB, (0.0, 0.5, 0.5))
_ycbcr_to_rgb = affine(RGB_FROM_YCBCR, _CENTRE, clip=True)
_TO_YCBCR = affine_numbers(YCBCR_FROM_RGB, (0.0, 0.5, 0.5))
_TO_RGB = affine_numbers(RGB_FROM_YCBCR, _CENTRE, clip=True)
_BYTES = (255.0, 255.0, 255.0), (0.0, 0.5, 0.5)  # the scale and the offset of OpenCV's bytes
_encode, _decode = encoder("affine", *_BYTES), decoder("affine", *_BYTES)


def rgb_to_ycbcr(image: Tensor, opencv: bool = False) -> Tensor:
    """RGB to luma and chroma: y = 0.299 r + 0.587 g + 0.114 b, cb = 0.564 (b - y) + 0.5, cr = 0.713 (r - y) + 0.5.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1]; bytes are 255ths, other integers computed in float32, unscaled.
        opencv: take uint8 images and give the 8-bit codes of `cv2.cvtColor`: 255ths, chroma about 128.

    Returns:
        YCbCr images of the same shape, in [0, 1] up to the rounding of 0.564 and 0.713; grays have chroma 0.5.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.601.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_ycbcr(torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1)).flatten()
        tensor([0.2990, 0.3314, 0.9998])
    """
    _check.channels("rgb_to_ycbcr", "image", image, 3)
    if are_codes("rgb_to_ycbcr", image, opencv):
        return apply_on_batch(_encode, image, *_TO_YCBCR)
    return of_rgb(_rgb_to_ycbcr, image)


def ycbcr_to_rgb(image: Tensor, opencv: bool = False) -> Tensor:
    """Luma and chroma to RGB: the inverse of :func:`rgb_to_ycbcr`, clamped.

    Args:
        image: YCbCr images (*, 3, H, W) in [0, 1]. Integers are computed in float32, unscaled.
        opencv: take the 8-bit codes of :func:`rgb_to_ycbcr` with opencv, and give uint8 images.

    Returns:
        RGB images of the same shape, clamped to [0, 1].

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, or uint8 without.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.601.

    Example:
        >>> import torch, kvision as K
        >>> K.color.ycbcr_to_rgb(torch.tensor([0.3, 0.5, 0.5]).view(3, 1, 1)).flatten()
        tensor([0.3000, 0.3000, 0.3000])
    """
    _check.channels("ycbcr_to_rgb", "image", image, 3)
    if are_codes("ycbcr_to_rgb", image, opencv):
        return apply_on_batch(_decode, image, *_TO_RGB)
    return apply_on_batch(_ycbcr_to_rgb, values("ycbcr_to_rgb", image))


def rgb_to_y(image: Tensor) -> Tensor:
    """The luma of :func:`rgb_to_ycbcr`: 0.299 r + 0.587 g + 0.114 b.

    Args:
        image: RGB images (*, 3, H, W), in any range. Integers give float32; :func:`rgb_to_grayscale` keeps uint8.

    Returns:
        Luma (*, 1, H, W).

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.601.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_y(torch.eye(3)[:, None])
        tensor([[[0.2990, 0.5870, 0.1140]]])
    """
    _check.channels("rgb_to_y", "image", image, 3)
    return apply_on_batch(weighted_sum, floats(image), *LUMA)


class RgbToYcbcr(FunctionModule):
    """Module form of :func:`rgb_to_ycbcr`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToYcbcr()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_ycbcr(image, opencv=self.opencv)


class YcbcrToRgb(FunctionModule):
    """Module form of :func:`ycbcr_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.YcbcrToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return ycbcr_to_rgb(image, opencv=self.opencv)
