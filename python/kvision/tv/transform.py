"""The base of v2's classes: which inputs are transformed, and draws of each sample of a batch."""

from __future__ import annotations

import dataclasses
import enum
import functools
import inspect
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import torch
from torch import nn
from typing_extensions import Self, dataclass_transform

from kvision._torch_compat import tree_flatten, tree_unflatten
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
from kvision.tv import argument, draw
from kvision.tv.functional.dispatch import on_device, takes
from kvision.tv.inputs import EVERYTHING, IMAGES, LABELS, channels_of, height_and_width

Step = tuple[str, Any]
_EXPLICIT = frozenset({"image", "video", "pil"})
_LEAVES = frozenset({"tensor", "array", "pil", *TV_TENSORS})
_ALL_TENSORS = EVERYTHING | {"tv_tensor"}
_once: ContextVar[bool] = ContextVar("kvision.tv draws once", default=False)
# Where set, calls of functions are noted, not made: those of a sample of a batch.
_calls: ContextVar[list[Any] | None] = ContextVar("kvision.tv calls", default=None)


@contextmanager
def draws_once() -> Iterator[None]:
    token = _once.set(True)
    try:
        yield
    finally:
        _once.reset(token)


@dataclass_transform(eq_default=False)
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
    refused: frozenset[str] = frozenset()
    """The kinds of inputs that a sample must not have."""
    draws: bool = False
    """Whether each sample of a batch (B, C, H, W) draws numbers of its own."""
    checks: Mapping[str, argument.Check] = {}
    """What makes arguments of a constructor what is kept of them, where it is not what `argument.CHECKS` says."""
    _applies_functions = True  # of the size alone, so that calls of all samples can be made together
    _function: Callable[..., Any] | None = None
    _options: tuple[str, ...] = ()  # the fields of the class that its function takes

    # In this package a class is its fields, which are the arguments of v2's constructor, what it draws, and the function that is
    # applied by both.

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        self = super().__new__(cls)
        nn.Module.__init__(self)  # before the fields are set
        return self

    def __init_subclass__(
        cls, function: Callable[..., Any] | None = None, kw_only: bool = False, **kwargs: Any
    ) -> None:
        super().__init_subclass__(**kwargs)
        if not cls.__module__.startswith("kvision.tv."):
            cls._applies_functions = False
            return
        dataclasses.dataclass(eq=False, repr=False, kw_only=kw_only)(cls)
        if function is not None:
            cls._function = staticmethod(function)
            fields = cls.__dataclass_fields__  # type: ignore[attr-defined]  # of a dataclass
            cls._options = tuple(name for name in inspect.signature(function).parameters if name in fields)

    def __post_init__(self) -> None:
        op = type(self).__name__
        for name in getattr(self, "__dataclass_fields__", ()):
            check = self.checks.get(name) or argument.CHECKS.get(name)
            if check is not None:
                setattr(self, name, check(op, name, getattr(self, name)))

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        """Raise for a sample that cannot be transformed."""
        if self.refused and not self.refused.isdisjoint(kind_of(x) for x in flat_inputs):
            raise TypeError(f"{type(self).__name__}: expected a sample without {', '.join(sorted(self.refused))}")

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        """Draw the parameters of a sample, given its inputs that are transformed."""
        return {}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        """Transform an input by the parameters."""
        if self._function is None:
            raise NotImplementedError(f"{type(self).__name__}.transform")
        return self._call_kernel(self._function, inpt, **{**self._options_for(inpt), **params})

    def _options_for(self, inpt: Any) -> dict[str, Any]:
        """What the function of the class gets beside the parameters."""
        options = {name: getattr(self, name) for name in self._options}
        if isinstance(options.get("fill"), dict):
            options["fill"] = fill_of(options["fill"], inpt)
        return options

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        """What this is of kvision.augmentation for a batch of images: a class and its arguments, or "dtype" and the type."""
        return None

    def _call_kernel(self, functional: Callable[..., Any], inpt: Any, *args: Any, **kwargs: Any) -> Any:
        """Apply a function of kvision.tv.functional, which passes on what it does not change."""
        if hasattr(functional, "kinds") and not takes(functional, inpt):
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
        with draw.together():
            if not self._applies_functions:
                return join([self._flat(sample, needed) for sample in split(flat, needed, samples)], flat, needed)
            first = next(split(flat, needed, samples))  # samples are of one size
            inputs = _Inputs(x for x, is_needed in zip(first, needed) if is_needed)
            params = [self._drawn(inputs) for _ in range(samples)]
            calls = [self._calls_of(x, params) if is_needed else [] for x, is_needed in zip(first, needed)]
        return [apply_calls(x, c) if is_needed else x for x, c, is_needed in zip(flat, calls, needed)]

    def _calls_of(self, x: Any, params: list[dict[str, Any] | None]) -> list[list[Any]]:
        """The calls of functions that transform each sample."""
        calls: list[list[Any]] = [[] for _ in params]
        if type(self).transform is Transform.transform and self._function is not None:
            options = self._options_for(x) if takes(self._function, x) else None
            return [[] if p is None or options is None else [(self._function, ((), {**options, **p}))] for p in params]
        for own, p in zip(calls, params):
            token = _calls.set(own)
            try:
                if p is not None:
                    self.transform(x, p)
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


class Chance(Transform):
    """What is applied with a probability `p`, a field of subclasses."""

    draws = True

    def _drawn(self, inputs: list[Any]) -> dict[str, Any] | None:
        return super()._drawn(inputs) if draw.unit() < self.p else None  # type: ignore[operator]  # a field of subclasses


class RandomTransform(Chance):
    """The base of transforms that are applied with a probability `p`.

    Args:
        p: the probability.

    Example:
        >>> from kvision import tv
        >>> tv.RandomInvert(p=0.2)
        RandomInvert(p=0.2)
    """

    p: float = 0.5


def apply_calls(x: Any, calls: list[list[Any]]) -> Any:
    """Make the calls of each sample of a batch, in turn; those of one function together."""
    for turn in itertools.zip_longest(*calls):
        by_function: dict[Any, list[int]] = {}
        for i, call in enumerate(turn):
            if call is not None:
                by_function.setdefault(call[0], []).append(i)
        source, is_copy = x, False
        for function, chosen in by_function.items():
            arguments = [turn[i][1] for i in chosen]
            if len(chosen) == len(source):
                x = function.of_each(source, arguments)
                continue
            index = on_device(chosen, source.device)
            part = function.of_each(at(source, index), arguments)
            target = plain(x) if is_copy else plain(x).clone()
            x, is_copy = wrap(target.index_copy_(0, index, plain(part)), source), True
    return x


def at(x: Any, chosen: Any) -> Any:
    """Some samples of a batch."""
    return wrap(plain(x)[chosen], x)


# --- what a sample holds --------------------------------------------------------------------------------------------


class _Inputs(list[Any]):
    """Inputs of which the size is asked for many samples."""

    @functools.cached_property
    def size(self) -> tuple[int, int]:
        return size_of(list(self))


def size_of(flat: Sequence[Any]) -> tuple[int, int]:
    """The height and width that all inputs have."""
    if isinstance(flat, _Inputs):
        return flat.size
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


def fill_of(fill: Any, x: Any) -> Any:
    """The fill of an input: one for all, or by class of input, "others" for the rest."""
    if not isinstance(fill, dict):
        return fill
    return fill[type(x)] if type(x) in fill else fill.get("others")
