"""Thresholding with OpenCV's types."""

from __future__ import annotations

import math
from enum import IntEnum

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision.color.program import step
from kvision.core.exceptions import TypeCheckError
from kvision.enhance.batch import as_batch, broadcast, broadcastable, shaped

Value = float | Tensor


def _reference(x: Tensor, limit: Value, above: Value, below: Value, keeps_above: float, keeps_below: float) -> Tensor:
    def value(unchanged: float, other: Value) -> Tensor:
        return x if unchanged else other if isinstance(other, Tensor) else x.new_full((), other)

    return torch.where(x > limit, value(keeps_above, above), value(keeps_below, below))


_threshold = step("threshold", _reference)


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


_TYPES = [int(t) for t in ThresholdType if t < ThresholdType.THRESH_OTSU]


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
        A tensor of the input's shape and type, differentiable in what is taken over into it. Integers saturate.

    Raises:
        TypeCheckError: input is not a real tensor; thresh or maxval is neither number nor tensor; type is not an int.
        ShapeError: thresh or maxval does not broadcast to the input.
        ValueCheckError: an unknown type.
        NotImplementedError: THRESH_OTSU, which is :func:`kvision.filters.otsu_threshold`.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.threshold(torch.tensor([10, 100, 200], dtype=torch.uint8), 100)
        tensor([  0,   0, 255], dtype=torch.uint8)
    """
    _check.numbers("threshold", "input", input)
    thresh, maxval = (
        broadcastable("threshold", name, value, input)
        if isinstance(value, Tensor)
        else _check.number("threshold", name, value)
        for name, value in (("thresh", thresh), ("maxval", maxval))
    )
    if not isinstance(type, int):
        raise TypeCheckError(f"threshold: expected type to be a ThresholdType, got {type!r}")
    if type & ThresholdType.THRESH_OTSU:
        raise NotImplementedError("threshold: THRESH_OTSU is kvision.filters.otsu_threshold")
    _check.choice("threshold", "type", int(type), _TYPES)
    if input.is_floating_point():
        limit, *results = _values(type, thresh, maxval)
        # Neither the comparison nor an image that is only compared has a gradient.
        limit = limit.detach() if isinstance(limit, Tensor) else limit
        slots = [broadcast(v, input) if isinstance(v, Tensor) else v for v in (limit, *results)]
        x = input if any(_kept(type)) else input.detach()
        return shaped(_threshold(as_batch(x), *slots, *_kept(type)), input)
    if input.dtype == torch.uint8 and not isinstance(thresh, Tensor) and not isinstance(maxval, Tensor):
        level = math.floor(max(-1.0, min(thresh, 255.0)))
        above, below = (math.floor(max(0.0, min(v, 255.0))) / 255 for v in _values(type, level, maxval)[1:])
        return shaped(_threshold(as_batch(input), (level + 0.5) / 255, above, below, *_kept(type)), input)
    floored = torch.as_tensor(thresh, dtype=torch.float64, device=input.device).floor()
    limit, high, low = (torch.as_tensor(value, device=input.device) for value in _values(type, floored, maxval))
    keeps_above, keeps_below = _kept(type)
    return torch.where(
        input.double() > limit,
        input if keeps_above else _stored(high, input.dtype),
        input if keeps_below else _stored(low, input.dtype),
    )


def _values(type: int, thresh: Value, maxval: Value) -> tuple[Value, Value, Value]:
    """The threshold, and the constant results above it and elsewhere, where these are not the input."""
    above = maxval if type == ThresholdType.THRESH_BINARY else thresh if type == ThresholdType.THRESH_TRUNC else 0.0
    return thresh, above, maxval if type == ThresholdType.THRESH_BINARY_INV else 0.0


def _kept(type: int) -> tuple[bool, bool]:
    """Whether the result is the input above the threshold, and elsewhere."""
    return type == ThresholdType.THRESH_TOZERO, type in (ThresholdType.THRESH_TRUNC, ThresholdType.THRESH_TOZERO_INV)


def _stored(value: Tensor, dtype: torch.dtype) -> Tensor:
    """A value saturated to the range of an integer type."""
    low, high = (0, 1) if dtype == torch.bool else (torch.iinfo(dtype).min, torch.iinfo(dtype).max)
    return value.clamp(low, high).to(dtype)


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
