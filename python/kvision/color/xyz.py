"""CIE XYZ."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._leading import apply_on_batch
from kvision._modules import FunctionModule
from kvision.color.codes import are_codes, decoder, encoder, of_rgb, values
from kvision.color.matrix import affine, affine_numbers, inverse, mixed

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
_TO_XYZ, _TO_RGB = affine_numbers(XYZ_FROM_RGB), affine_numbers(RGB_FROM_XYZ)
_BYTES = (255.0, 255.0, 255.0), (0.0, 0.0, 0.0)  # the scale and the offset of OpenCV's bytes
_encode, _decode = encoder("affine", *_BYTES), decoder("affine", *_BYTES)


def rgb_to_xyz(image: Tensor, opencv: bool = False) -> Tensor:
    """RGB to CIE XYZ by the matrix of the sRGB primaries and the white D65.

    The colors must be linear light. :func:`rgb_to_linear_rgb` converts gamma-encoded colors.

    Args:
        image: RGB images (*, 3, H, W); bytes are 255ths, other integers computed in float32, unscaled.
        opencv: take uint8 images and give the 8-bit codes of `cv2.cvtColor`: 255ths.

    Returns:
        XYZ images of the same shape; of colors in [0, 1] they are in [0, 0.950456], [0, 1] and [0, 1.088754].

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.709, CIE 15.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_xyz(torch.ones(3, 1, 1)).flatten()
        tensor([0.9505, 1.0000, 1.0888])
    """
    _check.channels("rgb_to_xyz", "image", image, 3)
    if are_codes("rgb_to_xyz", image, opencv):
        return apply_on_batch(_encode, image, *_TO_XYZ)
    return of_rgb(_rgb_to_xyz, image)


def xyz_to_rgb(image: Tensor, opencv: bool = False) -> Tensor:
    """CIE XYZ to RGB, the inverse of :func:`rgb_to_xyz`.

    Args:
        image: XYZ images (*, 3, H, W). Integers are computed in float32.
        opencv: take the 8-bit codes of :func:`rgb_to_xyz` with opencv, and give uint8 images.

    Returns:
        RGB images of the same shape, of linear light, not clamped.

    Raises:
        TypeCheckError: image is not a tensor, or not uint8 with opencv, or uint8 without.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.709, CIE 15.

    Example:
        >>> import torch, kvision as K
        >>> K.color.xyz_to_rgb(torch.tensor([0.412453, 0.212671, 0.019334]).view(3, 1, 1)).flatten().round(decimals=4).abs()
        tensor([1., 0., 0.])
    """
    _check.channels("xyz_to_rgb", "image", image, 3)
    if are_codes("xyz_to_rgb", image, opencv):
        return apply_on_batch(_decode, image, *_TO_RGB)
    return apply_on_batch(_xyz_to_rgb, values("xyz_to_rgb", image))


class RgbToXyz(FunctionModule):
    """Module form of :func:`rgb_to_xyz`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToXyz()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_xyz(image, opencv=self.opencv)


class XyzToRgb(FunctionModule):
    """Module form of :func:`xyz_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.XyzToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, opencv: bool = False) -> None:
        super().__init__(opencv=opencv)

    def forward(self, image: Tensor) -> Tensor:
        return xyz_to_rgb(image, opencv=self.opencv)
