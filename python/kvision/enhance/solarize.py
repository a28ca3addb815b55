"""Solarization: bright pixels inverted."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision.color.program import step
from kvision.core.exceptions import ValueCheckError
from kvision.enhance.batch import as_batch, floats, parameter, shaped


def _reference(x: Tensor, threshold: float | Tensor, addition: float | Tensor, adds: float) -> Tensor:
    if adds:
        x = clamp(x + addition, 0, 1)
    return torch.where(x < threshold, x, 1 - x)


_solarize = step("solarize", _reference)


def solarize(input: Tensor, thresholds: float | Tensor = 0.5, additions: float | Tensor | None = None) -> Tensor:
    """Invert the pixels that reach a threshold.

    Args:
        input: (*, C, H, W), floating point, in [0, 1], or uint8.
        thresholds: pixels of at least this value become one minus it: a number, or a tensor with the first axes of the
            image, (B,) or (B, C).
        additions: added first, and the sum clamped to [0, 1]: a number in [-0.5, 0.5], or a tensor as for thresholds.

    Returns:
        The image, differentiable in image and additions.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8; a parameter is neither number nor tensor.
        ShapeError: a tensor has axes that the image has not.
        ValueCheckError: additions is a number outside [-0.5, 0.5]. Tensors are not checked by value.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.solarize(torch.tensor([[0.1, 0.5, 0.9]]))
        tensor([[0.1000, 0.5000, 0.1000]])
    """
    floats("solarize", "input", input)
    threshold = parameter("solarize", "thresholds", thresholds, input)
    addition: float | Tensor = 0.0
    if additions is not None:
        addition = parameter("solarize", "additions", additions, input, minimum=-0.5)
        if not isinstance(addition, Tensor) and addition > 0.5:
            raise ValueCheckError(f"solarize: expected additions in [-0.5, 0.5], got {additions!r}")
    return shaped(_solarize(as_batch(input), threshold, addition, additions is not None), input)
