"""The base of v2's classes: which inputs are transformed, and draws of each sample of a batch."""

from __future__ import annotations

import dataclasses
import enum
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextvars import ContextVar
from typing import Any

import torch
from torch import nn
from typing_extensions import Self, dataclass_transform

from kvision._torch_compat import tree_flatten, tree_unflatten
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
from kvision.tv import argument, draw
from kvision.tv.functional.dispatch import on_device, takes
from kvision.tv.functional.steps import apply_steps
from kvision.tv.inputs import EVERYTHING, IMAGES, LABELS, channels_of, height_and_width

Step = tuple[str, Any]
Call = tuple[Callable[..., Any], dict[str, Any]]  # a function and its arguments beside the input
_EXPLICIT = IMAGES - {"tensor"}
_LEAVES = TV_TENSORS | {"tensor", "array", "pil"}
ONCE: ContextVar[bool] = ContextVar("kvision.tv draws once", default=False)


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

    kinds: Set[str] = EVERYTHING | {"tv_tensor"}
    """The kinds of inputs that are transformed."""
    refused: Set[str] = frozenset()
    """The kinds of inputs that a sample must not have."""
    draws: bool = False
    """Whether each sample of a batch (B, C, H, W) draws numbers of its own."""
    checks: Mapping[str, argument.Check] = {}
    """What makes arguments of a constructor what is kept of them, where it is not what `argument.CHECKS` says."""
    _applies_functions = True  # by parameters of the size alone, so that calls of all samples can be made together
    _function: Callable[..., Any] | None = None
    _options: Mapping[str, str] = {}  # the field of each argument of the function that the class has

    # In this package a class is its fields, which are the arguments of v2's constructor, what it draws, and the function that is
    # applied by both. Attributes such as `kinds` are given with the function.

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        self = super().__new__(cls)
        nn.Module.__init__(self)  # before the fields are set
        return self

    def __init_subclass__(
        cls,
        function: Callable[..., Any] | None = None,
        kw_only: bool = False,
        renamed: Mapping[str, str] = {},  # arguments of the function by the fields that have other names
        **attributes: Any,
    ) -> None:
        if not cls.__module__.startswith("kvision.tv."):
            super().__init_subclass__(**attributes)
            cls._applies_functions = False
            return
        dataclasses.dataclass(eq=False, repr=False, kw_only=kw_only)(cls)
        for name, value in {**attributes, **({"_function": staticmethod(function)} if function else {})}.items():
            setattr(cls, name, value)
        if cls._function is not None:
            taken, fields = inspect.signature(cls._function).parameters, cls.__dataclass_fields__  # type: ignore[attr-defined]
            cls._options = {renamed.get(f, f): f for f in fields if renamed.get(f, f) in taken}

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

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any] | None:
        """Draw the parameters of a sample, given its inputs that are transformed; None for one that stays as it is."""
        return {}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        """Transform an input by the parameters."""
        for function, arguments in self._calls(self._options_for(inpt), params):
            if takes(function, inpt):
                inpt = function(inpt, **arguments)
        return inpt

    def _calls(self, options: dict[str, Any], params: dict[str, Any]) -> list[Call]:
        """The calls that transform an input by the parameters, one after the other."""
        if self._function is None:
            raise NotImplementedError(f"{type(self).__name__}.transform")
        return [(self._function, {**options, **params})]

    def _options_for(self, inpt: Any) -> dict[str, Any]:
        """What the function of the class gets beside the parameters."""
        options = {argument: getattr(self, field) for argument, field in self._options.items()}
        if isinstance(fill := options.get("fill"), dict):  # by class of input, "others" for the rest
            options["fill"] = fill[type(inpt)] if type(inpt) in fill else fill.get("others")
        return options

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        """What this is of kvision.augmentation for a batch of images: a class and its arguments, or "dtype" and the type."""
        return None

    def _call_kernel(self, functional: Callable[..., Any], inpt: Any, *args: Any, **kwargs: Any) -> Any:
        """Apply a function of kvision.tv.functional, which passes on what it does not change."""
        return functional(inpt, *args, **kwargs) if takes(functional, inpt) else inpt

    def forward(self, *inputs: Any) -> Any:
        flat, spec = flatten(inputs)
        self.check_inputs(flat)
        needed = self._needed(flat)
        samples = count_samples(flat, needed) if self.draws else 0
        outputs = self._each(flat, needed, samples) if samples else self._flat(flat, needed)
        return unflatten(outputs, spec)

    def _needed(self, flat: list[Any]) -> list[bool]:
        """Which inputs are transformed."""
        if len(flat) == 1:
            return [kind_of(flat[0]) in self.kinds]
        kinds = [kind_of(x) for x in flat]
        needed = [kind in self.kinds for kind in kinds]
        if "tensor" in kinds and "tensor" in self.kinds:
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
            # Samples are of one size.
            inputs = _Inputs(wrap(plain(x)[0], x) for x, is_needed in zip(flat, needed) if is_needed)
            params = [self._drawn(inputs) for _ in range(samples)]
        return [self._applied(x, params) if is_needed else x for x, is_needed in zip(flat, needed)]

    def _applied(self, x: Any, params: list[dict[str, Any] | None]) -> Any:
        """A batch transformed by the parameters of each sample."""
        options = self._options_for(x)
        return apply_calls(x, [[] if p is None else self._calls(options, p) for p in params])

    def extra_repr(self) -> str:
        shown = (bool, int, float, str, tuple, list, enum.Enum)
        items = ((name, value) for name, value in vars(self).items() if name[0] != "_" and name != "training")
        return ", ".join(f"{name}={value}" for name, value in items if isinstance(value, shown))


def flatten(inputs: tuple[Any, ...]) -> tuple[list[Any], Any]:
    """The inputs of a call, and how they are nested."""
    if len(inputs) == 1 and kind_of(inputs[0]) in _LEAVES:  # needs no look for nested inputs
        return [*inputs], None
    return tree_flatten(inputs if len(inputs) > 1 else inputs[0])


def unflatten(outputs: list[Any], spec: Any) -> Any:
    return outputs[0] if spec is None else tree_unflatten(outputs, spec)


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
    return 0 if samples == 1 or ONCE.get() else samples


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
        return self.make_params(inputs) if draw.unit() < self.p else None  # type: ignore[operator]  # a field of subclasses


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


def apply_calls(x: Any, calls: list[list[Call]]) -> Any:
    """Make the calls of each sample of a batch, in turn: steps of colors together, then those of one function together."""
    passed_on = {f for f in {call[0] for own in calls for call in own} if not takes(f, x)}
    calls = [[call for call in own if call[0] not in passed_on] for own in calls]
    while any(calls):
        x = apply_steps(x, calls)
        by_function: dict[Any, list[int]] = {}
        for i, own in enumerate(calls):
            if own:
                by_function.setdefault(own[0][0], []).append(i)
        arguments = [[calls[i].pop(0)[1] for i in chosen] for chosen in by_function.values()]
        if [*map(len, arguments)] == [len(calls)]:
            x = next(iter(by_function)).of_each(x, arguments[0])
        elif arguments:
            index = on_device([i for chosen in by_function.values() for i in chosen], x.device)
            sizes, output = [*map(len, arguments)], plain(x).clone()
            pieces = zip(by_function, arguments, index.split(sizes), plain(x)[index].split(sizes))
            for function, rows, places, part in pieces:
                output.index_copy_(0, places, plain(function.of_each(wrap(part, x), rows)))
            x = wrap(output, x)
    return x


def at(x: Any, chosen: Any) -> Any:
    """Some samples of a batch."""
    return wrap(plain(x)[chosen], x)


# --- what a sample holds --------------------------------------------------------------------------------------------


class _Inputs(list[Any]):
    """Inputs of which the size and the channels are asked for many samples."""

    @functools.cached_property
    def size(self) -> tuple[int, int]:
        sizes = {height_and_width(x) for x in self if kind_of(x) in EVERYTHING}
        return _only(sizes, "height and width", "an image, a video, a mask, boxes or key points")

    @functools.cached_property
    def channels(self) -> int:
        channels = {channels_of(x) for x in self if kind_of(x) in IMAGES}
        return _only(channels, "number of channels", "an image or a video")


def size_of(flat: Sequence[Any]) -> tuple[int, int]:
    """The height and width that all inputs have."""
    return (flat if isinstance(flat, _Inputs) else _Inputs(flat)).size


def channels_in(flat: Sequence[Any]) -> int:
    return (flat if isinstance(flat, _Inputs) else _Inputs(flat)).channels


def _only(found: set[Any], what: str, of: str) -> Any:
    if not found:
        raise TypeError(f"expected {of} in the sample, got none")
    if len(found) > 1:
        raise ValueError(f"expected one {what} in the sample, got {sorted(found)}")
    return found.pop()
