"""Thresholds, of OpenCV's kinds."""

from __future__ import annotations

from enum import IntEnum

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision.core.exceptions import TypeCheckError


class ThresholdType(IntEnum):
    """What `threshold` makes of values above the threshold, and of the others; numbered as OpenCV does.

    Example:
        >>> import kvision as K
        >>> int(K.enhance.ThresholdType.THRESH_TOZERO)
        3
    """

    THRESH_BINARY = 0
    THRESH_BINARY_INV = 1
    THRESH_TRUNC = 2
    THRESH_TOZERO = 3
    THRESH_TOZERO_INV = 4
    THRESH_OTSU = 8


def threshold(
    input: Tensor,
    thresh: float | Tensor,
    maxval: float | Tensor = 255.0,
    type: int | ThresholdType = ThresholdType.THRESH_BINARY,
) -> Tensor:
    """Compare every value with a threshold.

        type                 above the threshold    elsewhere
        THRESH_BINARY        maxval                 0
        THRESH_BINARY_INV    0                      maxval
        THRESH_TRUNC         thresh                 input
        THRESH_TOZERO        input                  0
        THRESH_TOZERO_INV    0                      input

    Args:
        input: a tensor of any shape and real type.
        thresh: the threshold, rounded down for integer images: a number, or a tensor that broadcasts to the input.
        maxval: the value of a binary result, of the same kinds.
        type: a :class:`ThresholdType` or its number.

    Returns:
        A tensor of the input's shape and type. Integers saturate.

    Raises:
        TypeCheckError: input is no real tensor; thresh or maxval is neither number nor tensor; type is no int.
        ValueCheckError: an unknown type.
        NotImplementedError: THRESH_OTSU, which is :func:`kvision.filters.otsu_threshold`.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.threshold(torch.tensor([10, 100, 200], dtype=torch.uint8), 100)
        tensor([  0,   0, 255], dtype=torch.uint8)
    """
    _check.numbers("threshold", "input", input)
    for name, value in (("thresh", thresh), ("maxval", maxval)):
        if not isinstance(value, Tensor):
            _check.number("threshold", name, value)
            continue
        _check.numbers("threshold", name, value)
        _check.same_device("threshold", input=input, **{name: value})
    if not isinstance(type, int):
        raise TypeCheckError(f"threshold: expected type to be a ThresholdType, got {type!r}")
    if type & ThresholdType.THRESH_OTSU:
        raise NotImplementedError("threshold: THRESH_OTSU is kvision.filters.otsu_threshold")
    _check.choice("threshold", "type", int(type), [int(t) for t in ThresholdType if t < ThresholdType.THRESH_OTSU])
    if not input.is_floating_point():
        thresh = torch.as_tensor(thresh, dtype=torch.float64).floor()
    above = (input if input.is_floating_point() else input.double()) > thresh
    zero = input.new_zeros(())
    if type == ThresholdType.THRESH_BINARY:
        return torch.where(above, _stored(maxval, input), zero)
    if type == ThresholdType.THRESH_BINARY_INV:
        return torch.where(above, zero, _stored(maxval, input))
    if type == ThresholdType.THRESH_TRUNC:
        return torch.where(above, _stored(thresh, input), input)
    if type == ThresholdType.THRESH_TOZERO:
        return torch.where(above, input, zero)
    return torch.where(above, zero, input)


def _stored(value: float | Tensor, x: Tensor) -> Tensor:
    """A value in the type of `x`: rounded, or saturated where it holds integers."""
    value = torch.as_tensor(value)
    if x.is_floating_point():
        return value.to(x.dtype)
    low, high = (0, 1) if x.dtype == torch.bool else (torch.iinfo(x.dtype).min, torch.iinfo(x.dtype).max)
    return value.clamp(low, high).to(x.dtype)


class Threshold(FunctionModule):
    """Module form of :func:`threshold`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.Threshold(0.5, 1.0)(torch.tensor([0.2, 0.7]))
        tensor([0., 1.])
    """

    def __init__(
        self,
        thresh: float | Tensor,
        maxval: float | Tensor = 255.0,
        type: int | ThresholdType = ThresholdType.THRESH_BINARY,
    ) -> None:
        super().__init__(thresh=thresh, maxval=maxval, type=type)

    def forward(self, input: Tensor) -> Tensor:
        return threshold(input, self.thresh, self.maxval, self.type)  # type: ignore[arg-type]  # not nn.Module's type
