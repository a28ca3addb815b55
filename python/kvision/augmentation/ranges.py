"""Ranges of random parameters, as constructors of augmentations take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import torch
from torch import Tensor, nn

from kvision import _check
from kvision.augmentation.draws import Draw, uniform
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

# What constructors take, for type checkers and editors: a number, some of them, or a tensor, which may get gradients.
Numbers: TypeAlias = float | Sequence[float] | Tensor
NumbersOfAxes: TypeAlias = Numbers | Sequence[Sequence[float]]  # or some numbers for each axis


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


class ParameterOf(Sequence["ParameterOf"]):
    """A parameter of a module, or an entry of it, which is read from the module whenever it is used.

    So it is what the module has by then, whoever has replaced it: load_state_dict(assign=True), `torch.func.functional_call`,
    parametrizations, `.to` and an assignment.
    """

    def __init__(self, module: nn.Module, name: str, entry: tuple[int | slice, ...] = ()) -> None:
        self.module, self.name, self.entry = module, name, entry

    @property
    def tensor(self) -> Tensor:
        """The parameter as it is now."""
        parameter: Tensor = getattr(self.module, self.name)
        return parameter[self.entry] if self.entry else parameter

    def __len__(self) -> int:
        tensor = self.tensor
        return len(tensor) if tensor.dim() else 0

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, int) and not 0 <= i < len(self):
            raise IndexError(i)
        return ParameterOf(self.module, self.name, (*self.entry, i))


class Range:
    """The lowest and the highest value of a parameter: two numbers, or a tensor that gets gradients.

    Args:
        low, high: the numbers.
        learned: in place of them a tensor (2,), or one of one entry s for center - s to center + s.
        center: that of one entry.
    """

    def __init__(
        self, low: float, high: float, learned: Tensor | ParameterOf | None = None, center: float = 0.0
    ) -> None:
        self._numbers, self.learned, self.center = (low, high), learned, center

    @property
    def low(self) -> float:
        """The lowest value as it is now, as a number."""
        return self._numbers[0] if (tensor := self.tensor) is None else float(tensor[0])

    @property
    def high(self) -> float:
        """The highest value as it is now, as a number."""
        return self._numbers[1] if (tensor := self.tensor) is None else float(tensor[1])

    @property
    def tensor(self) -> Tensor | None:
        """(2,), both values as they are now; None for two numbers."""
        value = self.learned.tensor if isinstance(self.learned, ParameterOf) else self.learned
        if value is None or value.numel() != 1:
            return value
        spread = value.reshape(1)
        return torch.cat([self.center - spread, self.center + spread])

    def uniform(self, scale: float = 1.0, identity: float = 0.0) -> Draw | LearnedUniform:
        """A draw from the range, times `scale`; `identity` is the value of samples that are not chosen."""
        if (tensor := self.tensor) is not None:
            return LearnedUniform(tensor, scale, identity)
        return uniform(self.low * scale, self.high * scale, identity)

    def uniform_and_affine(self, scale: float, offset: float, identity: float = 0.0) -> Draw | LearnedPair:
        """A draw v from the range, followed by scale * v + offset, in two columns."""
        if (tensor := self.tensor) is not None:
            return LearnedPair(tensor, scale, offset, identity)
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
    and may be on any device; a :class:`ParameterOf` is read in each call.
    """
    if isinstance(value, ParameterOf):
        if not value.tensor.requires_grad:
            parse(op, name, value.tensor, center=center, bounds=bounds)  # which checks its numbers
        return _learned(op, name, value.tensor, value, center)
    if isinstance(value, Tensor) and value.requires_grad:
        return _learned(op, name, value, value, center)
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


def without_gradient(op: str, name: str, value: Any) -> Any:
    """The value of a range whose draws are rounded or decide about sizes: a tensor that requires a gradient is refused."""
    tensor = value.tensor if isinstance(value, ParameterOf) else value
    if isinstance(tensor, Tensor) and tensor.requires_grad:
        raise TypeCheckError(
            f"{op}: expected {name} to be numbers, got a Tensor that requires a gradient, which it would not get; "
            f"pass {name}.detach()",
            actual_type=type(tensor),
        )
    return value


def as_pair(value: Any) -> Any:
    """A number, or the only entry of a sequence, as the pair of it and itself; anything else as it is."""
    if isinstance(value, ParameterOf):
        return value
    if not isinstance(value, Tensor) or not value.requires_grad:
        value = _check.scalar("both_ends", "value", value)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    return (value[0], value[0]) if isinstance(value, (tuple, list)) and len(value) == 1 else value


def is_nested(entry: Any) -> bool:
    """Whether an entry of a sequence is a sequence itself."""
    return isinstance(entry, Sequence) and len(entry) > 0


def pairs(op: str, name: str, value: Any, count: int, **options: Any) -> list[Range]:
    """`count` ranges from `count` pairs; a shorter value is one range, or a number, for all of them."""
    if isinstance(value, Tensor) and not value.requires_grad:
        value = value.tolist()
    if isinstance(value, Sequence) and len(value) == 2 * count and count > 1 and not is_nested(value[0]):
        return [parse(op, name, value[2 * i : 2 * i + 2], **options) for i in range(count)]
    if isinstance(value, Sequence) and len(value) == count and count > 1 and is_nested(value[0]):
        return [parse(op, name, part, **options) for part in value]
    return [parse(op, name, value, **options)] * count


def parse_each(op: str, name: str, value: Any, count: int, **options: Any) -> list[Range]:
    """`count` ranges from as many numbers or pairs; one number or one pair is the range of all of them."""
    if isinstance(value, Tensor) and not value.requires_grad:
        value = value.tolist()
    if isinstance(value, Sequence) and len(value) == count:
        return [parse(op, name, part, **options) for part in value]
    return [parse(op, name, value, **options)] * count


def _learned(op: str, name: str, value: Tensor, learned: Tensor | ParameterOf, center: float | None) -> Range:
    if value.shape != (2,) and (value.numel() != 1 or center is None):
        raise ValueCheckError(f"{op}: expected {name} of shape (2,), got {tuple(value.shape)}")
    return Range(0.0, 0.0, learned, center or 0.0)


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


def _is_whole(value: Any) -> bool:
    """Whether a number, which may be NumPy's or torch's, is an integer."""
    try:
        return not isinstance(value, (str, bytes)) and float(value).is_integer()
    except (TypeError, ValueError, OverflowError, RuntimeError):
        return False


def parse_integers(op: str, name: str, value: Any, lowest: int | None = None) -> tuple[int, int]:
    """A pair of ints in ascending order, of at least `lowest`."""
    if isinstance(value, Tensor):
        value = value.tolist()
    if not isinstance(value, (tuple, list)) or len(value) != 2 or not all(_is_whole(n) for n in value):
        raise TypeCheckError(f"{op}: expected {name} to be a pair of ints, got {value!r}")
    low, high = int(value[0]), int(value[1])
    if low > high or (lowest is not None and low < lowest):
        bound = "" if lowest is None else f" of at least {lowest}"
        raise ValueCheckError(f"{op}: expected {name} in ascending order{bound}, got {value}")
    return low, high


def fill_value(op: str, name: str, value: Any) -> float | list[float] | str:
    """What erased pixels get: a number within 0 and 1, a list of one of each channel, or 'random' for uniform noise."""
    if isinstance(value, str):
        if value != "random":
            raise ValueCheckError(
                f"{op}: expected {name} to be a number, one of each channel, or 'random', got {value!r}"
            )
        return value
    if isinstance(value, Tensor):
        value = value.tolist()
    each = list(value) if isinstance(value, Sequence) else [value]
    if not each:
        raise ValueCheckError(f"{op}: expected {name} to be a number, or one of each channel, got {value!r}")
    numbers = [parse(op, name, (number, number), bounds=(0.0, 1.0)).low for number in each]
    return numbers if isinstance(value, Sequence) else numbers[0]


def fill(op: str, name: str, value: Any) -> Any:
    """The value out of bounds as it is; raise unless it is None, a number, or one of each channel, also of each sample."""
    if value is not None:
        numbers = _check.as_tensor(op, name, value)
        _check.numbers(op, name, numbers)
        is_fill = numbers.dim() <= 2 or (numbers.dim() == 4 and numbers.shape[2:] == (1, 1))
        if not is_fill or numbers.numel() == 0:
            raise ShapeError(
                f"{op}: expected {name} of shape (), (C,) or (B, C, 1, 1), got {tuple(numbers.shape)}",
                actual_shape=numbers.shape,
            )
    return value


def keep_parameters(module: nn.Module, **values: Any) -> list[Any]:
    """Make the nn.Parameters among `values` parameters of `module`, so that they move and are saved with it.

    Returns:
        The values for `parse`, a :class:`ParameterOf` in place of each nn.Parameter.
    """
    for name, value in values.items():
        if isinstance(value, nn.Parameter):
            module.register_parameter(name, value)
    return [ParameterOf(module, name) if isinstance(value, nn.Parameter) else value for name, value in values.items()]
