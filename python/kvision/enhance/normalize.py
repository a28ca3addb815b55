"""Normalisation by given statistics, and back."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import FunctionModule
from kvision._ops import as_stored
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.enhance.batch import chosen


def _to_unit(x: Tensor, mean: Tensor | None, std: Tensor | None, mean_number: float, std_number: float) -> Tensor:
    return (x - chosen(mean, mean_number)) / chosen(std, std_number)


def _from_unit(x: Tensor, mean: Tensor | None, std: Tensor | None, mean_number: float, std_number: float) -> Tensor:
    return x * chosen(std, std_number) + chosen(mean, mean_number)


_normalize = as_stored(_to_unit)
_denormalize = as_stored(_from_unit)


def normalize(data: Tensor, mean: float | Tensor, std: float | Tensor) -> Tensor:
    """Subtract the mean and divide by the standard deviation, channel by channel: (data - mean) / std.

    Args:
        data: (B, C, *), channels on axis 1; with numbers for mean and std any shape, (C, H, W) as well. Integers are
            computed in float32.
        mean: a number, or a tensor: (C,), (B, C), or with the first axes of data or axes of size 1.
        std: of the same kinds.

    Returns:
        The normalised data, differentiable in all three. A std of 0 gives infinities.

    Raises:
        TypeCheckError: data is no real tensor; mean or std is neither number nor tensor.
        ShapeError: mean or std does not fit the data.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([0.5, 1.0]).view(1, 2, 1, 1)
        >>> K.enhance.normalize(x, torch.tensor([0.5, 0.5]), torch.tensor([0.5, 0.25])).flatten()
        tensor([0., 2.])
        >>> K.enhance.normalize(torch.tensor([[0, 255]], dtype=torch.uint8), 0.0, 255.0)
        tensor([[0., 1.]])
    """
    return _normalize(*_arguments("normalize", data, mean, std))


def denormalize(data: Tensor, mean: float | Tensor, std: float | Tensor) -> Tensor:
    """Undo `normalize`: data * std + mean, channel by channel.

    Args:
        data: (B, C, *), channels on axis 1; with numbers for mean and std any shape.
        mean: a number, or a tensor: (C,), (B, C), or with the first axes of data or axes of size 1.
        std: of the same kinds.

    Returns:
        The data before normalisation, differentiable in all three.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as :func:`normalize`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.denormalize(torch.tensor([[0.0, 2.0]]), 0.5, 0.25)
        tensor([[0.5000, 1.0000]])
    """
    return _denormalize(*_arguments("denormalize", data, mean, std))


def _arguments(op: str, data: Tensor, mean: float | Tensor, std: float | Tensor) -> tuple:
    _check.numbers(op, "data", data)
    m, m_number = _statistic(op, "mean", mean, data)
    s, s_number = _statistic(op, "std", std, data)
    return floats(data), m, s, m_number, s_number


def _statistic(op: str, name: str, value: float | Tensor, data: Tensor) -> tuple[Tensor | None, float]:
    """A tensor with as many axes as the data, or a number."""
    if not isinstance(value, Tensor):
        return None, _check.number(op, name, value)
    _check.numbers(op, name, value)
    _check.same_device(op, data=data, **{name: value})
    if value.dim() <= 1 and value.numel() == 1:
        return value.reshape((1,) * data.dim()), 0.0
    aligned = value[None] if value.dim() == 1 else value
    if aligned.dim() > data.dim() or any(n not in (1, m) for n, m in zip(aligned.shape, data.shape)):
        raise ShapeError(
            f"{op}: expected {name} to be a number, (C,) or (B, C) for data of shape (B, C, *), got {tuple(value.shape)} "
            f"for {tuple(data.shape)}",
            actual_shape=value.shape,
        )
    return aligned.reshape(*aligned.shape, *(1,) * (data.dim() - aligned.dim())), 0.0


class _Statistics(FunctionModule):
    def __init__(self, mean: float | Sequence[float] | Tensor, std: float | Sequence[float] | Tensor) -> None:
        super().__init__(mean=_tensor("mean", mean), std=_tensor("std", std))


def _tensor(name: str, value: float | Sequence[float] | Tensor) -> float | Tensor:
    if not isinstance(value, (tuple, list)):
        return value  # type: ignore[return-value]
    if not all(isinstance(v, (int, float)) for v in value):
        raise TypeCheckError(f"normalize: expected {name} to hold numbers, got {value!r}", actual_type=type(value))
    return torch.tensor(value, dtype=torch.float64)


class Normalize(_Statistics):
    """Module form of :func:`normalize`; mean and std may be tuples or lists as well.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.Normalize((0.5, 0.5), (0.5, 0.25))(torch.ones(1, 2, 1, 1)).flatten()
        tensor([1., 2.])
    """

    def forward(self, input: Tensor) -> Tensor:
        return normalize(input, self.mean, self.std)


class Denormalize(_Statistics):
    """Module form of :func:`denormalize`; mean and std may be tuples or lists as well.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.Denormalize((0.5, 0.5), (0.5, 0.25))(torch.ones(1, 2, 1, 1)).flatten()
        tensor([1.0000, 0.7500])
    """

    def forward(self, input: Tensor) -> Tensor:
        return denormalize(input, self.mean, self.std)
