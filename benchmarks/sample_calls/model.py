"""The model of the one table of sample calls. Tests, sweeps and benchmarks read the table; none guesses arguments.

- An entry is the name of a function, or the names of several that take the same, and the arguments of its call by name.
- A tensor is an `Axes`: its axes by name ("B C H W"), the range of its numbers, all of which the function takes, and, where the
  numbers have a structure (a rotation, a camera), the function that makes it.
- The names stand for the numbers of a `Size`, which a reader chooses. An axis may be an expression of them ("H//2").
- An argument that depends on the library or on the tensors of the call is `Derived`.
- A class is an entry, too: its arguments are those that make it, and its call is that of the module on its tensors.
- A `Window` is a further call of a function, with the reach of a pixel. Tests of bad pixels and of alignment read it, and the
  inherited suites of filters take their variants from it.
- A class of augmentations says in `augmentations.py` what a test has to know of it.
- `WITHOUT_SAMPLE` has the public functions that no sweep calls, and why.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, NamedTuple

import torch
from torch import Tensor

import kvision as K

Number = float | str  # a number, or an expression of the names of a Size


class Size(NamedTuple):
    """Batch, channels, height and width of the images of a call."""

    b: int
    c: int
    h: int
    w: int

    def number(self, expression: Number) -> Any:
        """The value of an expression of B, C, H, W, of N, the points of a sample, and of M, the rows of a call without samples."""
        if not isinstance(expression, str):
            return expression
        b, c, h, w = self
        return eval(expression, {"__builtins__": {}}, {"B": b, "C": c, "H": h, "W": w, "N": w, "M": h * w})


@dataclass(frozen=True)
class Axes:
    """A tensor of a call: uniform numbers of [low, high), or what `make` gives for a size."""

    axes: str
    low: Number = 0.0
    high: Number = 1.0
    make: Callable[[Size], Tensor] | None = None
    integer: bool = False

    def shape(self, size: Size) -> tuple[int, ...]:
        return tuple(size.number(axis) for axis in self.axes.split())

    def __call__(self, size: Size) -> Tensor:
        if self.make is not None:
            return self.make(size)
        low, high = size.number(self.low), size.number(self.high)
        if self.integer:
            return torch.randint(low, high, self.shape(size))
        return low + (high - low) * torch.rand(self.shape(size))


def rand(axes: str, low: Number = 0.0, high: Number = 1.0) -> Axes:
    return Axes(axes, low, high)


def randint(axes: str, high: Number, low: Number = 0) -> Axes:
    return Axes(axes, low, high, integer=True)


def made(axes: str, make: Callable[[Size], Tensor]) -> Axes:
    return Axes(axes, make=make)


@dataclass(frozen=True)
class Derived:
    """An argument made at the time of the call, from the library and the tensors of the call by name."""

    make: Callable[[Any, Mapping[str, Tensor]], Any]


def half(name: str, axes: int = 2) -> Derived:
    """Half of the sizes of the tensor of that name."""
    return Derived(lambda _, tensors: tuple(n // 2 for n in tensors[name].shape[-axes:]))


def length(name: str, axis: int) -> Derived:
    return Derived(lambda _, tensors: tensors[name].shape[axis])


@dataclass(frozen=True)
class SampleCall:
    """A function or a class with the arguments of its call. `call(library, tensors)` calls Kornia's as well.

    A tensor whose name starts with an underscore is no argument: others are derived from it.
    """

    name: str
    axes: Mapping[str, Axes]
    others: Mapping[str, Any]
    args: tuple[Any, ...] = ()  # positional ones, which make the module of a class
    modules: dict[tuple[str, torch.device], Any] = field(default_factory=dict, compare=False)

    def tensors(self, size: Size, device: torch.device | str = "cpu") -> dict[str, Tensor]:
        torch.manual_seed(0)
        return {name: axes(size).to(device) for name, axes in self.axes.items()}

    def function(self, library: ModuleType | Any = K) -> Any:
        """The library's function or class, None where it has none of that name."""
        module, name = self.name.split(".")
        return getattr(getattr(library, module, None), name, None)

    def arguments(self, library: ModuleType | Any, tensors: Mapping[str, Tensor]) -> dict[str, Any]:
        others = {k: v.make(library, tensors) if isinstance(v, Derived) else v for k, v in self.others.items()}
        return {k: v for k, v in tensors.items() if k[0] != "_"} | others

    def call(self, library: ModuleType | Any, tensors: Mapping[str, Tensor]) -> Any:
        function = self.function(library)
        if inspect.isclass(function):
            return self.module(library, next(iter(tensors.values())).device)(*tensors.values())
        return function(**self.arguments(library, tensors))

    def module(self, library: ModuleType | Any, device: torch.device) -> Any:
        """The module of a class, made once for each library and device."""
        key = library.__name__, device
        if key not in self.modules:
            self.modules[key] = self.function(library)(*self.args, **self.others).to(device)
        return self.modules[key]


Table = dict[str, dict[str, Any]]  # the names of functions, with spaces between them, and their arguments


def calls(module: str, table: Table) -> list[SampleCall]:
    found = []
    for names, arguments in table.items():
        axes = {k: v for k, v in arguments.items() if isinstance(v, Axes)}
        others = {k: v for k, v in arguments.items() if k not in axes}
        found += [SampleCall(f"{module}.{name}", axes, others) for name in names.split()]
    return found
