"""Brightness: a number added or multiplied."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision.color.scale_shift import scale_shift
from kvision.enhance.batch import as_batch, floats, parameter, shaped


def adjust_brightness(image: Tensor, factor: float | Tensor, clip_output: bool = True) -> Tensor:
    """Adjust the brightness of images by adding a number to their values.

    Args:
        image: (*, C, H, W), floating point, in [0, 1], or uint8.
        factor: what is added, 0 for no change: a number, or a tensor with the first axes of the image, (B,) or (B, C).
        clip_output: clamp the result to [0, 1].

    Returns:
        The image, brighter or darker, differentiable in image and factor.

    Raises:
        TypeCheckError: image is not a tensor of floats or uint8; factor is neither number nor tensor.
        ShapeError: factor has axes that the image has not.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_brightness(torch.tensor([[0.0, 0.5, 0.9]]), 0.2)
        tensor([[0.2000, 0.7000, 1.0000]])
    """
    floats("adjust_brightness", "image", image)
    amount = parameter("adjust_brightness", "factor", factor, image)
    _check.flag("adjust_brightness", "clip_output", clip_output)
    return shaped(scale_shift(as_batch(image), 1.0, amount, clip_output), image)


def adjust_brightness_accumulative(image: Tensor, factor: float | Tensor, clip_output: bool = True) -> Tensor:
    """Adjust the brightness of images by multiplying their values, as PIL and torchvision do.

    Args:
        image: (*, C, H, W), floating point, in [0, 1], or uint8.
        factor: 1 for no change, 0 for black: a number, or a tensor with the first axes of the image, (B,) or (B, C).
        clip_output: clamp the result to [0, 1].

    Returns:
        The image, brighter or darker, differentiable in image and factor.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as :func:`adjust_brightness`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_brightness_accumulative(torch.tensor([[0.0, 0.3, 0.9]]), 2.0)
        tensor([[0.0000, 0.6000, 1.0000]])
    """
    floats("adjust_brightness_accumulative", "image", image)
    amount = parameter("adjust_brightness_accumulative", "factor", factor, image)
    _check.flag("adjust_brightness_accumulative", "clip_output", clip_output)
    return shaped(scale_shift(as_batch(image), amount, 0.0, clip_output), image)


class AdjustBrightness(FunctionModule):
    """Module form of :func:`adjust_brightness`; a factor that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustBrightness(0.5)(torch.zeros(1, 3, 1, 1)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(self, brightness_factor: float | Tensor) -> None:
        super().__init__(brightness_factor=brightness_factor)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_brightness(input, self.brightness_factor)


class AdjustBrightnessAccumulative(FunctionModule):
    """Module form of :func:`adjust_brightness_accumulative`; a factor that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustBrightnessAccumulative(0.5)(torch.ones(1, 3, 1, 1)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(self, brightness_factor: float | Tensor) -> None:
        super().__init__(brightness_factor=brightness_factor)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_brightness_accumulative(input, self.brightness_factor)
