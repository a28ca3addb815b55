"""Peak signal-to-noise ratio."""

from __future__ import annotations

import math

from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.metrics.pointwise import total


def psnr(image: Tensor, target: Tensor, max_val: float) -> Tensor:
    """Compute the peak signal-to-noise ratio 10 log10(max_val^2 / mean square error), over all elements.

    Args:
        image: a tensor of any shape; integers are computed in float32.
        target: another one of the same shape.
        max_val: largest value that there can be, above 0.

    Returns:
        Decibels, a number; infinity, with no gradient, for equal images.

    Raises:
        TypeCheckError: not two real tensors of one shape.
        ValueCheckError: max_val not above 0.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.psnr(torch.ones(1), 1.2 * torch.ones(1), 2.0)
        tensor(20.0000)
    """
    return decibels_of_ratio("psnr", image, target, max_val, -10.0)


def decibels_of_ratio(op: str, image: Tensor, target: Tensor, max_val: float, decibels: float) -> Tensor:
    """`decibels` times log10 of the mean square error in units of max_val^2."""
    _check.numbers(op, "image", image)
    _check.numbers(op, "target", target)
    if image.shape != target.shape:
        raise TypeCheckError(f"{op}: expected target of shape {tuple(image.shape)} as image, got {tuple(target.shape)}")
    _check.same_device(op, image=image, target=target)
    if not _check.number(op, "max_val", max_val) > 0:
        raise ValueCheckError(f"{op}: expected max_val above 0, got {max_val!r}", actual_value=max_val)
    x = floats(image)
    factor = 1 / (x.numel() * max_val * max_val) if x.numel() else math.nan
    return total("square", x, floats(target), factor, decibels)
