"""The order of red, green and blue."""

from __future__ import annotations

from torch import Tensor, nn

from kvision import _check


def bgr_to_rgb(image: Tensor) -> Tensor:
    """Blue, green, red to red, green, blue: the channels in reverse.

    Args:
        image: BGR images (*, 3, H, W) of any type.

    Returns:
        RGB images of the same shape and type.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.bgr_to_rgb(torch.tensor([0.1, 0.2, 0.3]).view(3, 1, 1)).flatten()
        tensor([0.3000, 0.2000, 0.1000])
    """
    _check.channels("bgr_to_rgb", "image", image, 3)
    return image.flip(-3)


def rgb_to_bgr(image: Tensor) -> Tensor:
    """Red, green, blue to blue, green, red: the channels in reverse.

    Args:
        image: RGB images (*, 3, H, W) of any type.

    Returns:
        BGR images of the same shape and type.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_bgr(torch.tensor([0.1, 0.2, 0.3]).view(3, 1, 1)).flatten()
        tensor([0.3000, 0.2000, 0.1000])
    """
    _check.channels("rgb_to_bgr", "image", image, 3)
    return image.flip(-3)


class BgrToRgb(nn.Module):
    """Module form of :func:`bgr_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.BgrToRgb()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return bgr_to_rgb(image)


class RgbToBgr(nn.Module):
    """Module form of :func:`rgb_to_bgr`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToBgr()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_bgr(image)
