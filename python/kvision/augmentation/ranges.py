"""Ranges of random parameters, as constructors of augmentations take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from kvision import _check
from kvision.augmentation.draws import Draw, uniform
from kvision.core.exceptions import TypeCheckError, ValueCheckError


class LearnedUniform(NamedTuple):
    """A draw between the two entries of a tensor, which get gradients. The operator draws in [0, 1), or -1 for identity."""

    range: Tensor
    scale: float
    identity: float
    kind: str = "uniform"
    numbers: tuple[float, ...] = (0.0, 1.0, -1.0)
    columns: int = 1

    def value(self, drawn: Tensor) -> Tensor:
        low, high = self.range.to(drawn.device).unbind(-1)
        value = (low + drawn * (high - low)) * self.scale
        return torch.where(drawn < 0, self.identity, value)


def affine(x: Tensor, scale: float, offset: float) -> Tensor:
    """scale * x + offset, rounded once to the type of x: the second column of `uniform_and_affine`."""
    return (x.double() * scale + offset).to(x.dtype)


class LearnedPair(NamedTuple):
    """A :class:`LearnedUniform` whose value v is followed by scale * v + offset."""

    range: Tensor
    scale: float
    offset: float
    identity: float
    kind: str = "uniform_and_affine"
    numbers: tuple[float, ...] = (0.0, 1.0, 1.0, 0.0, -1.0)
    columns: int = 2

    def value(self, drawn: Tensor) -> Tensor:
        first = LearnedUniform(self.range, 1.0, self.identity).value(drawn[:, :1])
        return torch.cat([first, self.scale * first + self.offset], 1)


class Range:
    """The lowest and the highest value of a parameter: two numbers, or a tensor (2,) that gets gradients."""

    def __init__(self, low: float, high: float, tensor: Tensor | None = None) -> None:
        self.low, self.high, self.tensor = low, high, tensor

    def uniform(self, scale: float = 1.0, identity: float = 0.0) -> Draw | LearnedUniform:
        """A draw from the range, times `scale`; `identity` is the value of samples that are not chosen."""
        if self.tensor is not None:
            return LearnedUniform(self.tensor, scale, identity)
        return uniform(self.low * scale, self.high * scale, identity)

    def uniform_and_affine(self, scale: float, offset: float, identity: float = 0.0) -> Draw | LearnedPair:
        """A draw v from the range, followed by scale * v + offset, in two columns."""
        if self.tensor is not None:
            return LearnedPair(self.tensor, scale, offset, identity)
        return Draw("uniform_and_affine", (self.low, self.high, scale, offset, identity))


def parse(
    op: str,
    name: str,
    value: Any,
    *,
    center: float | None = None,
    bounds: tuple[float, float] = (-float("inf"), float("inf")),
) -> Range:
    """A range from a number s, which stands for center - s to center + s, or from the lower bound on, or from a pair.

    Without a center only pairs are taken. Tensors count like the numbers in them. One that requires a gradient keeps it,
    and may be on any device.
    """
    if isinstance(value, Tensor) and value.requires_grad:
        return _learned(op, name, value, center)
    numbers = _numbers(op, name, value)
    if len(numbers) == 1:
        if center is None:
            raise ValueCheckError(f"{op}: expected {name} to be a pair of numbers, got {value}")
        if numbers[0] < 0:
            raise ValueCheckError(f"{op}: expected {name} to be 0 or more, or a pair, got {value}")
        low, high = max(center - numbers[0], bounds[0]), center + numbers[0]
    elif len(numbers) == 2:
        low, high = numbers
    else:
        raise ValueCheckError(f"{op}: expected {name} to be a number or a pair, got {value}")
    if not bounds[0] <= low <= high <= bounds[1]:
        limits = "" if bounds[0] == -float("inf") else f" within {bounds[0]:g} and {bounds[1]:g}"
        raise ValueCheckError(f"{op}: expected {name} in ascending order{limits}, got {value}")
    return Range(low, high)


def as_pair(value: Any) -> Any:
    """A number, or the only entry of a sequence, as the pair of it and itself; anything else as it is."""
    if not isinstance(value, Tensor) or not value.requires_grad:
        value = _check.scalar("both_ends", "value", value)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    return (value[0], value[0]) if isinstance(value, (tuple, list)) and len(value) == 1 else value


def pairs(op: str, name: str, value: Any, count: int, **options: Any) -> list[Range]:
    """`count` ranges from `count` pairs; a shorter value is one range, or a number, for all of them."""
    if isinstance(value, Tensor) and not value.requires_grad:
        value = value.tolist()
    if isinstance(value, Sequence) and len(value) == 2 * count and count > 1 and not isinstance(value[0], Sequence):
        return [parse(op, name, value[2 * i : 2 * i + 2], **options) for i in range(count)]
    if isinstance(value, Sequence) and len(value) == count and count > 1 and isinstance(value[0], Sequence):
        return [parse(op, name, part, **options) for part in value]
    return [parse(op, name, value, **options)] * count


def parse_each(op: str, name: str, value: Any, count: int, **options: Any) -> list[Range]:
    """`count` ranges from as many numbers or pairs; one number or one pair is the range of all of them."""
    if isinstance(value, Tensor) and not value.requires_grad:
        value = value.tolist()
    if isinstance(value, Sequence) and len(value) == count:
        return [parse(op, name, part, **options) for part in value]
    return [parse(op, name, value, **options)] * count


def _learned(op: str, name: str, value: Tensor, center: float | None) -> Range:
    if value.numel() == 1 and center is not None:
        spread = value.reshape(1)
        value = torch.cat([center - spread, center + spread])
    if value.shape != (2,):
        raise ValueCheckError(f"{op}: expected {name} of shape (2,), got {tuple(value.shape)}")
    return Range(0.0, 0.0, value)


def _numbers(op: str, name: str, value: Any) -> list[float]:
    """The entries of a number, a sequence or a tensor as floats."""
    if isinstance(value, Tensor):
        _check.numbers(op, name, value)
        value = value.tolist()
    try:
        entries = list(value) if hasattr(value, "__len__") else [value]
        numbers = [float(x) for x in entries]
    except (TypeError, ValueError):
        raise TypeCheckError(f"{op}: expected {name} to be a number or a pair of numbers, got {value!r}") from None
    if any(isinstance(x, (bool, str)) for x in entries):
        raise TypeCheckError(f"{op}: expected {name} to be a number or a pair of numbers, got {value!r}")
    if any(x != x for x in numbers):
        raise ValueCheckError(f"{op}: expected {name} to be finite, got {value!r}")
    return numbers


def keep_parameters(module: nn.Module, **values: Any) -> None:
    """Make the nn.Parameters among `values` parameters of `module`, so that they move and are saved with it."""
    for name, value in values.items():
        if isinstance(value, nn.Parameter):
            module.register_parameter(name, value)
