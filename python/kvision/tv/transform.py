"""The base of v2's classes: which inputs are transformed, and draws of each sample of a batch."""

from __future__ import annotations

import enum
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import torch
from torch import nn

from kvision import _check
from kvision._torch_compat import tree_flatten, tree_unflatten
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
from kvision.tv.functional.dispatch import takes
from kvision.tv.functional.geometry import interpolation_name
from kvision.tv.inputs import EVERYTHING, IMAGES, LABELS, channels_of, height_and_width

Step = tuple[str, Any]
_EXPLICIT = frozenset({"image", "video", "pil"})
_LEAVES = frozenset({"tensor", "array", "pil", *TV_TENSORS})
_ALL_TENSORS = EVERYTHING | {"tv_tensor"}
_once: ContextVar[bool] = ContextVar("kvision.tv draws once", default=False)
# Where set, calls of functions are noted, not made: those of a sample of a batch.
_calls: ContextVar[list[Any] | None] = ContextVar("kvision.tv calls", default=None)
# Where set, the source of numbers in [0, 1): those of a batch are drawn together.
_numbers: ContextVar[Iterator[float] | None] = ContextVar("kvision.tv numbers", default=None)


@contextmanager
def draws_once() -> Iterator[None]:
    token = _once.set(True)
    try:
        yield
    finally:
        _once.reset(token)


class Transform(nn.Module):
    """The base of transforms of your own, with the methods of v2's: make_params, transform and check_inputs.

    In a sample the tv_tensors of torchvision and PIL images are transformed. A plain tensor is an image if it is the first one and
    there is no other image or video. What else there is passes through.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> class Dim(tv.Transform):
        ...     def transform(self, inpt, params):
        ...         return inpt / 2
        >>> Dim()({"image": torch.ones(1), "label": 3})
        {'image': tensor([0.5000]), 'label': 3}
    """

    kinds: frozenset[str] = _ALL_TENSORS
    """The kinds of inputs that are transformed."""
    draws: bool = False
    """Whether each sample of a batch (B, C, H, W) draws numbers of its own."""
    _applies_functions = True  # of the size alone, so that calls of all samples can be made together

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if not cls.__module__.startswith("kvision.tv."):
            cls._applies_functions = False

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        """Raise for a sample that cannot be transformed."""

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        """Draw the parameters of a sample, given its inputs that are transformed."""
        return {}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        """Transform an input by the parameters."""
        raise NotImplementedError

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        """What this is of kvision.augmentation for a batch of images: a class and its arguments, or "dtype" and the type."""
        return None

    def _call_kernel(self, functional: Callable[..., Any], inpt: Any, *args: Any, **kwargs: Any) -> Any:
        """Apply a function of kvision.tv.functional, which passes on what it does not change."""
        if not takes(functional, inpt):
            return inpt
        calls = _calls.get()
        if calls is None:
            return functional(inpt, *args, **kwargs)
        calls.append((functional, (args, kwargs)))
        return inpt

    def forward(self, *inputs: Any) -> Any:
        sample = inputs if len(inputs) > 1 else inputs[0]
        is_leaf = kind_of(sample) in _LEAVES  # needs no look for nested inputs
        flat, spec = ([sample], None) if is_leaf else tree_flatten(sample)
        self.check_inputs(flat)
        needed = self._needed(flat)
        samples = count_samples(flat, needed) if self.draws else 0
        outputs = self._each(flat, needed, samples) if samples else self._flat(flat, needed)
        return outputs[0] if spec is None else tree_unflatten(outputs, spec)

    def _needed(self, flat: list[Any]) -> list[bool]:
        """Which inputs are transformed."""
        kinds = [kind_of(x) for x in flat]
        needed = [kind in self.kinds for kind in kinds]
        if len(kinds) > 1 and "tensor" in kinds and "tensor" in self.kinds:
            first = -1 if not _EXPLICIT.isdisjoint(kinds) else kinds.index("tensor")
            needed = [is_needed and (kinds[i] != "tensor" or i == first) for i, is_needed in enumerate(needed)]
        return needed

    def _drawn(self, inputs: list[Any]) -> dict[str, Any] | None:
        """The parameters of a sample, None for one that stays as it is."""
        return self.make_params(inputs)

    def _flat(self, flat: list[Any], needed: list[bool]) -> list[Any]:
        params = self._drawn([x for x, is_needed in zip(flat, needed) if is_needed])
        if params is None:
            return flat
        return [self.transform(x, params) if is_needed else x for x, is_needed in zip(flat, needed)]

    def _each(self, flat: list[Any], needed: list[bool], samples: int) -> list[Any]:
        """Transform each sample of a batch by numbers of its own. The first way defines what the second one gives."""
        token = _numbers.set(_unit_numbers())
        try:
            if not self._applies_functions:
                return join([self._flat(sample, needed) for sample in split(flat, needed, samples)], flat, needed)
            first = next(split(flat, needed, samples))  # samples are of one size
            inputs = [x for x, is_needed in zip(first, needed) if is_needed]
            params = [self._drawn(inputs) for _ in range(samples)]
            calls = [[self._calls_of(x, p) for p in params] if is_needed else [] for x, is_needed in zip(first, needed)]
        finally:
            _numbers.reset(token)
        return [apply_calls(x, c) if is_needed else x for x, c, is_needed in zip(flat, calls, needed)]

    def _calls_of(self, x: Any, params: dict[str, Any] | None) -> list[Any]:
        calls: list[Any] = []
        if params is not None:
            token = _calls.set(calls)
            try:
                self.transform(x, params)
            finally:
                _calls.reset(token)
        return calls

    def extra_repr(self) -> str:
        shown = (bool, int, float, str, tuple, list, enum.Enum)
        items = ((name, value) for name, value in vars(self).items() if name[0] != "_" and name != "training")
        return ", ".join(f"{name}={value}" for name, value in items if isinstance(value, shown))


def count_samples(flat: list[Any], needed: list[bool]) -> int:
    """How many samples draw by themselves: those of a batch of images or videos and their masks; 0 for a call as one."""
    samples = 0
    for x, is_needed in zip(flat, needed):
        if not is_needed:
            continue
        kind = kind_of(x)
        if kind == "pil" or kind in LABELS or x.ndim <= _AXES.get(kind, 3) or samples not in (0, x.shape[0]):
            return 0
        samples = x.shape[0]
    return 0 if samples == 1 or _once.get() else samples


_AXES = {"video": 4, "mask": 2}  # of a sample; 3 for images


def split(flat: list[Any], needed: list[bool], samples: int) -> Iterator[list[Any]]:
    parts = [plain(x).unbind(0) if is_needed else None for x, is_needed in zip(flat, needed)]
    for i in range(samples):
        yield [x if part is None else wrap(part[i], x) for x, part in zip(flat, parts)]


def join(results: list[list[Any]], flat: list[Any], needed: list[bool]) -> list[Any]:
    columns = zip(zip(*results), flat, needed)
    return [wrap(torch.stack([plain(y) for y in ys]), x) if is_needed else x for ys, x, is_needed in columns]


class RandomTransform(Transform):
    """The base of transforms that are applied with a probability `p`.

    Args:
        p: the probability.

    Example:
        >>> from kvision import tv
        >>> tv.RandomInvert(p=0.2)
        RandomInvert(p=0.2)
    """

    draws = True

    def __init__(self, p: float = 0.5) -> None:
        super().__init__()
        self.p = _check.fraction(type(self).__name__, "p", p)

    def _drawn(self, inputs: list[Any]) -> dict[str, Any] | None:
        return super()._drawn(inputs) if unit() < self.p else None


def apply_calls(x: Any, calls: list[list[Any]]) -> Any:
    """Make the calls of each sample of a batch, in turn; those of one function together."""
    for turn in itertools.zip_longest(*calls):
        by_function: dict[Any, list[int]] = {}
        for i, call in enumerate(turn):
            if call is not None:
                by_function.setdefault(call[0], []).append(i)
        source = x
        for function, chosen in by_function.items():
            x = at_samples(
                functools.partial(function.of_each, arguments=[turn[i][1] for i in chosen]), x, chosen, source
            )
    return x


def at_samples(function: Callable[[Any], Any], x: Any, chosen: list[int], source: Any = None) -> Any:
    """`x` with the results of a function of the `chosen` samples of `source`, by default of `x`."""
    source = x if source is None else source
    if len(chosen) == len(x):
        return function(source)
    index = torch.tensor(chosen, device=x.device)
    return wrap(plain(x).index_copy(0, index, plain(function(at(source, index)))), x)


def at(x: Any, chosen: Any) -> Any:
    """Some samples of a batch."""
    return wrap(plain(x)[chosen], x)


# --- draws as v2's, in its order, so that a seed draws the same -----------------------------------------------------


def _unit_numbers() -> Iterator[float]:
    while True:
        yield from torch.rand(256, dtype=torch.float64, device="cpu").tolist()


def unit() -> float:
    numbers = _numbers.get()
    return torch.rand(1, device="cpu").item() if numbers is None else next(numbers)


def uniform(low: float, high: float) -> float:
    numbers = _numbers.get()
    if numbers is None:
        return torch.empty(1, device="cpu").uniform_(low, high).item()
    return low + next(numbers) * (high - low)


def log_uniform(low: float, high: float) -> float:
    """Between exp(low) and exp(high)."""
    if _numbers.get() is None:
        return torch.exp(torch.empty(1, device="cpu").uniform_(low, high)).item()
    return math.exp(uniform(low, high))


def integer(low: int, high: int) -> int:
    """Of [low, high)."""
    numbers = _numbers.get()
    if numbers is None:
        return int(torch.randint(low, high, (1,), device="cpu").item())
    return low + int(next(numbers) * (high - low))


def permutation(n: int) -> list[int]:
    numbers = _numbers.get()
    return (
        torch.randperm(n, device="cpu").tolist() if numbers is None else sorted(range(n), key=lambda _: next(numbers))
    )


# --- what a sample holds --------------------------------------------------------------------------------------------


def size_of(flat: Sequence[Any]) -> tuple[int, int]:
    """The height and width that all inputs have."""
    sizes = {height_and_width(x) for x in flat if kind_of(x) in EVERYTHING}
    if len(sizes) == 1:
        return sizes.pop()
    if not sizes:
        raise TypeError("expected an image, a video, a mask, boxes or key points in the sample, got none")
    raise ValueError(f"expected one height and width in the sample, got {sorted(sizes)}")


def channels_in(flat: Sequence[Any]) -> int:
    channels = {channels_of(x) for x in flat if kind_of(x) in IMAGES}
    if len(channels) == 1:
        return channels.pop()
    if not channels:
        raise TypeError("expected an image or a video in the sample, got none")
    raise ValueError(f"expected images of one number of channels in the sample, got {sorted(channels)}")


# --- arguments ------------------------------------------------------------------------------------------------------


def two(op: str, name: str, value: Any, count: Sequence[int] = (1, 2)) -> tuple[Any, ...]:
    """A number as two, or a sequence of one or two."""
    value = _check.scalars(op, name, value)
    if isinstance(value, (int, float)):
        return value, value
    if not isinstance(value, (tuple, list)) or len(value) not in count:
        raise ValueError(
            f"{op}: expected {name} to be a number or {' or '.join(map(str, count))} of them, got {value!r}"
        )
    return tuple(value) if len(value) > 1 else (value[0], value[0])


def pair(op: str, name: str, value: Any) -> tuple[float, float]:
    """Two numbers in ascending order."""
    value = _check.scalars(op, name, value)
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise TypeError(f"{op}: expected {name} to be a pair of numbers, got {value!r}")
    low, high = (_check.number(op, name, v) for v in value)
    if not low <= high:
        raise ValueError(f"{op}: expected {name} in ascending order, got {value!r}")
    return low, high


def interval(op: str, name: str, value: Any, counts: Sequence[int] = (2,)) -> list[float]:
    """A number a as [-a, a], or a sequence."""
    value = _check.scalars(op, name, value)
    if isinstance(value, (int, float)):
        if value < 0:
            raise ValueError(f"{op}: expected {name} of at least 0, got {value}")
        return [-float(value), float(value)]
    if not isinstance(value, (tuple, list)) or len(value) not in counts:
        raise ValueError(
            f"{op}: expected {name} to be a number or {' or '.join(map(str, counts))} of them, got {value!r}"
        )
    return [float(v) for v in value]


def checked_interpolation(transform: Any, interpolation: Any) -> Any:
    interpolation_name(type(transform).__name__, interpolation)
    return interpolation


def fill_of(fill: Any, x: Any) -> Any:
    """The fill of an input: one for all, or by class of input, "others" for the rest."""
    if not isinstance(fill, dict):
        return fill
    return fill[type(x)] if type(x) in fill else fill.get("others")
