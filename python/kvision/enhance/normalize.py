"""Normalization by mean and standard deviation, and its inverse."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import floats
from kvision._modules import FunctionModule
from kvision._torch_compat import is_tracing
from kvision.color.program import step
from kvision.color.scale_shift import scale_shift, scale_shift_rgb
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.enhance.batch import shaped

_FEW = 1 << 12  # pixels


def _to_unit(x: Tensor, mean: float | Tensor, std: float | Tensor) -> Tensor:
    return (x - mean) / std


def _to_unit_rgb(x: Tensor, *p: float | Tensor) -> Tensor:
    return torch.cat([_to_unit(c, p[i], p[3 + i]) for i, c in enumerate(x.split(1, 1))], 1)


_normalize = step("standardize", _to_unit)
standardize_rgb = step("standardize_rgb", _to_unit_rgb)


def normalize(data: Tensor, mean: float | Tensor, std: float | Tensor) -> Tensor:
    """Subtract the mean and divide by the standard deviation, channel by channel: (data - mean) / std.

    Args:
        data: (B, C, *), channels on axis 1; with numbers for mean and std any shape, (C, H, W) as well. Integers are
            computed in float32.
        mean: a number, or a tensor: (C,), (B, C), or with the first axes of data or axes of size 1.
        std: of the same kinds.

    Returns:
        The normalized data, differentiable in all three. A std of 0 gives infinities.

    Raises:
        TypeCheckError: data is not a real tensor; mean or std is neither number nor tensor.
        ShapeError: mean or std does not fit the data.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([0.5, 1.0]).view(1, 2, 1, 1)
        >>> K.enhance.normalize(x, torch.tensor([0.5, 0.5]), torch.tensor([0.5, 0.25])).flatten()
        tensor([0., 2.])
        >>> K.enhance.normalize(torch.tensor([[0, 255]], dtype=torch.uint8), 0.0, 255.0)
        tensor([[0., 1.]])
    """
    x, m, s = _arguments("normalize", data, mean, std)
    if _is_rgb(x, m, s):
        return shaped(standardize_rgb(x, *_columns(m), *_columns(s)), data)
    return shaped(_normalize(x, _rows(m), _rows(s)), data)


def denormalize(data: Tensor, mean: float | Tensor, std: float | Tensor) -> Tensor:
    """Undo `normalize`: data * std + mean, channel by channel.

    Args:
        data: (B, C, *), channels on axis 1; with numbers for mean and std any shape.
        mean: a number, or a tensor: (C,), (B, C), or with the first axes of data or axes of size 1.
        std: of the same kinds.

    Returns:
        The data before normalization, differentiable in all three.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as :func:`normalize`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.denormalize(torch.tensor([[0.0, 2.0]]), 0.5, 0.25)
        tensor([[0.5000, 1.0000]])
    """
    x, m, s = _arguments("denormalize", data, mean, std)
    if _torch_is_fast(x, m, s):
        return shaped(torch.addcmul(_per_plane(m, x), x, _per_plane(s, x)), data)
    if _is_rgb(x, m, s):
        return shaped(scale_shift_rgb(x, *_columns(s), *_columns(m), False), data)
    return shaped(scale_shift(x, _rows(s), _rows(m), False), data)


def _arguments(
    op: str, data: Tensor, mean: float | Tensor, std: float | Tensor
) -> tuple[Tensor, float | Tensor, float | Tensor]:
    """The data as (B, C, H, W); the statistics as numbers, (B or 1, 1, C or 1), or of four axes that broadcast to it."""
    _check.numbers(op, "data", data)
    m, s = _statistic(op, "mean", mean, data), _statistic(op, "std", std, data)
    return _with_four_axes(floats(data)), m, s


def _is_rgb(x: Tensor, *parameters: float | Tensor) -> bool:
    """Whether there are three channels, and one or three numbers per statistic: this takes a faster kernel."""
    if x.shape[1] != 3:
        return False
    for p in parameters:
        if isinstance(p, Tensor) and p.dim() > 3:
            return False
    return True


def _torch_is_fast(x: Tensor, *parameters: float | Tensor) -> bool:
    """Whether torch's addcmul takes less time than the program of a step, as of few pixels and statistics on the CPU.

    It does for a gradient of statistics as well, which are sums over the image.
    """
    tensors = [p for p in parameters if isinstance(p, Tensor)]
    if not tensors or not x.is_cpu or x.dtype not in (torch.float32, torch.float64) or is_compiling() or is_tracing():
        return False
    return x.numel() < _FEW or (torch.is_grad_enabled() and any(p.requires_grad for p in tensors))


def _per_plane(p: float | Tensor, x: Tensor) -> Tensor:
    """A parameter as a tensor that broadcasts to x."""
    if not isinstance(p, Tensor):
        return x.new_full((), p)
    p = p.to(x.dtype)
    return p.mT[..., None] if p.dim() == 3 else p


def _columns(p: float | Tensor) -> Sequence[float | Tensor]:
    """A parameter with its three channels in the last axis."""
    if not isinstance(p, Tensor):
        return (p,) * 3
    return (p if p.shape[2] == 3 else p.expand(-1, -1, 3),)


def _rows(p: float | Tensor) -> float | Tensor:
    """A parameter with one row per channel."""
    return p.mT if isinstance(p, Tensor) and p.dim() == 3 else p


def _with_four_axes(x: Tensor) -> Tensor:
    if x.dim() == 4:
        return x
    return x.flatten(2, -2) if x.dim() > 4 else x.reshape(*x.shape, *(1,) * (4 - x.dim()))


def _statistic(op: str, name: str, value: float | Tensor, data: Tensor) -> float | Tensor:
    if not isinstance(value, Tensor):
        if isinstance(value, (tuple, list, str)) or value is None:
            raise TypeCheckError(
                f"{op}: expected {name} to be a number or a Tensor, got {value!r}", actual_type=type(value)
            )
        return _check.number(op, name, value)
    _check.numbers(op, name, value)
    value = _check.to_device_of(op, data, name, value, of="data")
    axes, count = value.dim(), value.numel()
    if axes <= 1 and (count == 1 or (data.dim() > 1 and count == data.shape[1])):
        return value.reshape(1, 1, count)
    sizes = (1, *value.shape) if axes == 1 else value.shape
    if len(sizes) > data.dim() or any(n not in (1, m) for n, m in zip(sizes, data.shape)):
        raise ShapeError(
            f"{op}: expected {name} to be a number, (C,) or (B, C) for data of shape (B, C, *), got {tuple(value.shape)} "
            f"for {tuple(data.shape)}{_check.channels_advice(data.shape)}",
            actual_shape=value.shape,
        )
    if math.prod(sizes[2:]) == 1:
        return value.reshape(sizes[0], 1, sizes[1])  # data with parameters has at least two axes
    value = value.reshape(*sizes, *(1,) * (data.dim() - len(sizes)))
    if value.dim() > 4:
        value = value.expand(*value.shape[:2], *data.shape[2:])
    return _with_four_axes(value)


class _Statistics(FunctionModule):
    def __init__(self, mean: float | Sequence[float] | Tensor, std: float | Sequence[float] | Tensor) -> None:
        super().__init__(mean=_tensor("mean", mean), std=_tensor("std", std))


def _tensor(name: str, value: float | Sequence[float] | Tensor) -> float | Tensor:
    if not isinstance(value, (tuple, list)):
        return value  # type: ignore[return-value]
    numbers = _check.scalars("normalize", name, value)
    if not all(isinstance(v, (int, float)) for v in numbers):
        raise TypeCheckError(f"normalize: expected {name} to hold numbers, got {value!r}", actual_type=type(value))
    return torch.tensor(numbers, dtype=torch.float64, device="cpu")


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
