"""Tone curves: gamma, logarithm, sigmoid."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._modules import FunctionModule
from kvision.color.program import step
from kvision.enhance.batch import as_batch, floats, parameter, shaped


def _power(x: Tensor, exponent: float | Tensor, gain: float | Tensor) -> Tensor:
    bright = ~(x <= 0)  # NaN counts as bright and stays
    y = torch.where(bright, x, 1) ** exponent
    # Black has no finite slope below gamma 1, so it has none at all; only gamma 0 lifts it.
    black = 1 - torch.sign(exponent.detach()) if isinstance(exponent, Tensor) else float(exponent == 0)
    dark = torch.where((x == 0) & (exponent == 1), x, black)  # the slope of gamma 1 is 1 everywhere
    return clamp(gain * torch.where(bright, y, dark), 0, 1)


def _log(x: Tensor, gain: float | Tensor, inv: float, clip: float) -> Tensor:
    y = gain * (torch.exp2(x) - 1 if inv else torch.log2(1 + x))
    return clamp(y, 0, 1) if clip else y


def _sigmoid(x: Tensor, cutoff: float | Tensor, gain: float | Tensor, inv: float) -> Tensor:
    y = gain * (x - cutoff)
    return torch.sigmoid(-y if inv else y)


_adjust_gamma = step("gamma", _power)
_adjust_log = step("log", _log)
_adjust_sigmoid = step("sigmoid", _sigmoid)


def adjust_gamma(input: Tensor, gamma: float | Tensor, gain: float | Tensor = 1.0) -> Tensor:
    """Raise an image to a power: gain * input ** gamma, clamped to [0, 1].

    Args:
        input: (*, C, H, W), floating point, in [0, 1], or uint8; values below 0 count as 0.
        gamma: the power, above 1 to darken, below 1 to brighten: a number of at least 0, or a tensor with the first axes
            of the image, (B,) or (B, C).
        gain: a factor, of the same kinds.

    Returns:
        The image, differentiable in image, gamma and gain. The gradient at black pixels is 0.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8; gamma or gain is neither number nor tensor.
        ShapeError: a tensor has axes that the image has not.
        ValueCheckError: a number below 0. Tensors are not checked by value.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_gamma(torch.tensor([[0.0, 0.5, 1.0]]), 2.0)
        tensor([[0.0000, 0.2500, 1.0000]])
    """
    floats("adjust_gamma", "input", input)
    exponent = parameter("adjust_gamma", "gamma", gamma, input, minimum=0)
    factor = parameter("adjust_gamma", "gain", gain, input, minimum=0)
    return shaped(_adjust_gamma(as_batch(input), exponent, factor), input)


def adjust_log(image: Tensor, gain: float | Tensor = 1, inv: bool = False, clip_output: bool = True) -> Tensor:
    """Take the logarithm of an image: gain * log2(1 + image), or with inv its inverse, gain * (2 ** image - 1).

    Args:
        image: (*, C, H, W), floating point, in [0, 1], or uint8. Values below -1 have no logarithm and give NaN.
        gain: a factor: a number, or a tensor with the first axes of the image, (B,) or (B, C).
        inv: the inverse curve, which darkens.
        clip_output: clamp the result to [0, 1].

    Returns:
        The image, differentiable in image and gain.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as :func:`adjust_gamma`; inv or clip_output not a bool.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_log(torch.tensor([[0.0, 0.5, 1.0]]))
        tensor([[0.0000, 0.5850, 1.0000]])
    """
    floats("adjust_log", "image", image)
    factor = parameter("adjust_log", "gain", gain, image)
    _check.flag("adjust_log", "inv", inv)
    _check.flag("adjust_log", "clip_output", clip_output)
    return shaped(_adjust_log(as_batch(image), factor, inv, clip_output), image)


def adjust_sigmoid(image: Tensor, cutoff: float | Tensor = 0.5, gain: float | Tensor = 10, inv: bool = False) -> Tensor:
    """Adjust the contrast of images by a sigmoid: 1 / (1 + exp(gain * (cutoff - image))), or with inv one minus it.

    Args:
        image: (*, C, H, W), floating point, in [0, 1], or uint8.
        cutoff: the value that becomes 0.5: a number, or a tensor with the first axes of the image, (B,) or (B, C).
        gain: four times the slope there, of the same kinds.
        inv: a falling curve.

    Returns:
        The image, differentiable in image, cutoff and gain.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as :func:`adjust_gamma`; inv not a bool.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.adjust_sigmoid(torch.tensor([[0.0, 0.5, 1.0]]))
        tensor([[0.0067, 0.5000, 0.9933]])
    """
    floats("adjust_sigmoid", "image", image)
    middle = parameter("adjust_sigmoid", "cutoff", cutoff, image)
    factor = parameter("adjust_sigmoid", "gain", gain, image)
    _check.flag("adjust_sigmoid", "inv", inv)
    return shaped(_adjust_sigmoid(as_batch(image), middle, factor, inv), image)


class AdjustGamma(FunctionModule):
    """Module form of :func:`adjust_gamma`; a gamma or gain that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustGamma(2.0, gain=0.5)(torch.ones(1, 3, 1, 1)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(self, gamma: float | Tensor, gain: float | Tensor = 1.0) -> None:
        super().__init__(gamma=gamma, gain=gain)

    def forward(self, input: Tensor) -> Tensor:
        return adjust_gamma(input, self.gamma, self.gain)


class AdjustLog(FunctionModule):
    """Module form of :func:`adjust_log`; a gain that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustLog()(torch.ones(1, 3, 1, 1)).flatten()
        tensor([1., 1., 1.])
    """

    def __init__(self, gain: float | Tensor = 1, inv: bool = False, clip_output: bool = True) -> None:
        super().__init__(gain=gain, inv=inv, clip_output=clip_output)

    def forward(self, image: Tensor) -> Tensor:
        return adjust_log(image, self.gain, self.inv, self.clip_output)


class AdjustSigmoid(FunctionModule):
    """Module form of :func:`adjust_sigmoid`; a cutoff or gain that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AdjustSigmoid(cutoff=0.0)(torch.zeros(1, 3, 1, 1)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(self, cutoff: float | Tensor = 0.5, gain: float | Tensor = 10, inv: bool = False) -> None:
        super().__init__(cutoff=cutoff, gain=gain, inv=inv)

    def forward(self, image: Tensor) -> Tensor:
        return adjust_sigmoid(image, self.cutoff, self.gain, self.inv)
