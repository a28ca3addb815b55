"""Contrast: the distance of every value from 0, or from the mean of its image."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._modules import FunctionModule
from kvision.color import rgb_to_grayscale as luma
from kvision.color.program import step
from kvision.color.scale_shift import scale_shift
from kvision.enhance.batch import as_batch, floats, images, parameter, shaped


def _mean_gray(x: Tensor) -> Tensor:
    means = x.mean((2, 3), keepdim=True, dtype=compute_dtype(x))
    return luma(means) if x.shape[1] == 3 else means.mean(1, keepdim=True)


def _reference(x: Tensor, factor: float | Tensor, mean: Tensor) -> Tensor:
    return clamp(x * factor + mean * (1 - factor), 0, 1)


_around_mean = step("contrast", _reference, measure=_mean_gray)


def _by_channel(x: Tensor, factor: Tensor) -> Tensor:
    """With a factor (B or 1, C, 1) for each channel, but one mean."""
    return scale_shift(x, factor, _mean_gray(x)[..., 0] * (1 - factor), True)


def adjust_contrast(image: Tensor, factor: float | Tensor, clip_output: bool = True) -> Tensor:
    """Adjust the contrast of images by multiplying their values.

    Args:
        image: (*, C, H, W), floating point, in [0, 1], or uint8.
        factor: 1 for no change, 0 for black: a number, or a tensor with the first axes of the image, (B,) or (B, C).
        clip_output: clamp the result to [0, 1].

    Returns:
        The image with more or less contrast, differentiable in image and factor.

    Raises:
        TypeCheckError: image is not a tensor of floats or uint8; factor is neither number nor tensor.
        ShapeError: factor has axes that the image has not.
        ValueCheckError: a number below 0. Tensors are not checked by value.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: R. Szeliski, "Computer Vision: Algorithms and Applications" (2010), section 3.1.1.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_contrast(torch.tensor([[0.0, 0.3, 0.9]]), 2.0)
        tensor([[0.0000, 0.6000, 1.0000]])
    """
    floats("adjust_contrast", "image", image)
    amount = parameter("adjust_contrast", "factor", factor, image, minimum=0)
    _check.flag("adjust_contrast", "clip_output", clip_output)
    return shaped(scale_shift(as_batch(image), amount, 0.0, clip_output), image)


def adjust_contrast_with_mean_subtraction(image: Tensor, factor: float | Tensor) -> Tensor:
    """Adjust the contrast of images by scaling their difference from the mean gray, as PIL and torchvision do.

    Args:
        image: (*, C, H, W), floating point, in [0, 1], or uint8. The gray of three channels is 0.299 R + 0.587 G +
            0.114 B, that of any other number their mean.
        factor: 1 for no change, 0 for plain gray: a number, or a tensor with the first axes of the image.

    Returns:
        image * factor + mean * (1 - factor), clamped to [0, 1], differentiable in image and factor.

    Raises:
        TypeCheckError, ValueCheckError, DeviceError: as :func:`adjust_contrast`.
        ShapeError: image is not (*, C, H, W); factor has axes that the image has not.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_contrast_with_mean_subtraction(torch.tensor([[[0.2, 0.4, 0.6]]]), 2.0)
        tensor([[[0.0000, 0.4000, 0.8000]]])
    """
    images("adjust_contrast_with_mean_subtraction", "image", image)
    amount = parameter("adjust_contrast_with_mean_subtraction", "factor", factor, image, minimum=0)
    batch = as_batch(image)
    of_pixels = isinstance(amount, Tensor) and amount.dim() == 4
    if isinstance(amount, Tensor) and amount.shape[1] > 1 and not of_pixels:
        return shaped(_by_channel(batch, amount), image)
    if batch.shape[1] not in (1, 3) and not of_pixels:
        batch = batch.flatten(1, 2)[:, None]  # the mean of all channels is that of one large one
    y = _around_mean(batch, amount)
    return y if y.shape == image.shape else y.reshape(image.shape)


class AdjustContrast(FunctionModule):
    """Module form of :func:`adjust_contrast`; a factor that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustContrast(0.5)(torch.ones(1, 3, 1, 1)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(self, contrast_factor: float | Tensor) -> None:
        super().__init__(contrast_factor=contrast_factor)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_contrast(input, self.contrast_factor)


class AdjustContrastWithMeanSubtraction(FunctionModule):
    """Module form of :func:`adjust_contrast_with_mean_subtraction`; a factor that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustContrastWithMeanSubtraction(0.0)(torch.tensor([[[0.2, 0.6]]]))
        tensor([[[0.4000, 0.4000]]])
    """

    def __init__(self, contrast_factor: float | Tensor) -> None:
        super().__init__(contrast_factor=contrast_factor)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_contrast_with_mean_subtraction(input, self.contrast_factor)
