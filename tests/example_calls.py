"""The calls that the examples of public docstrings make: valid arguments for every public function and module, for
tests that sweep all of them.
"""

from __future__ import annotations

import copy
import doctest
import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, wraps
from typing import Any

from torch import Tensor, nn

from test_docstrings import OBJECTS


@dataclass
class Call:
    """A call of a public function or of the forward of a module: `function(*args, **kwargs)`."""

    name: str
    function: Callable[..., Any]
    args: list[Any] = field(default_factory=list)
    kwargs: dict[str, Any] = field(default_factory=dict)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self.function(*args, **kwargs)

    def arguments(self) -> dict[str | int, Any]:
        """The arguments by position or name."""
        return {**dict(enumerate(self.args)), **self.kwargs}

    def parameters(self) -> list[inspect.Parameter]:
        target = self.function.forward if isinstance(self.function, nn.Module) else self.function
        return list(inspect.signature(target).parameters.values())

    def by_name(self) -> dict[str, Any]:
        """The arguments by name; none for functions that take any number of them."""
        parameters = self.parameters()
        if any(p.kind is p.VAR_POSITIONAL for p in parameters):
            return {}
        return {**{p.name: v for p, v in zip(parameters, self.args)}, **self.kwargs}

    def defaults(self) -> dict[str, Any]:
        """The defaults of the arguments that are not given."""
        named = self.by_name()
        missing = [p for p in self.parameters() if p.default is not p.empty and p.kind is not p.VAR_KEYWORD]
        return {p.name: p.default for p in missing if p.name not in named}

    def replaced(self, key: str | int, value: Any) -> Any:
        """The result with one argument replaced; the others are copies, so that calls share nothing."""
        arguments = {**{k: copied(v) for k, v in self.arguments().items()}, key: value}
        positional = [arguments.pop(i) for i in range(len(self.args))]
        return self.function(*positional, **arguments)


def copied(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.detach().clone().requires_grad_(value.requires_grad)
    if isinstance(value, (list, tuple)) and type(value) in (list, tuple):
        return type(value)(map(copied, value))
    return copy.copy(value)


@contextmanager
def recorded(value: Any, calls: list[Call]) -> Iterator[None]:
    """Record the calls of a public function, or of the constructor and the forward of a class."""
    name = value.__qualname__
    if inspect.isclass(value):
        methods = [m for m in ("__init__", "forward") if (m in dir(value) and m != "forward") or has_forward(value, m)]
        originals = {m: vars(value).get(m) for m in methods}
        for m in methods:
            setattr(value, m, recording(value, m, calls))
        try:
            yield
        finally:
            for m, original in originals.items():
                if original is None:
                    delattr(value, m)
                else:
                    setattr(value, m, original)
        return

    @wraps(value)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        call = Call(name, value, [copied(a) for a in args], {k: copied(a) for k, a in kwargs.items()})
        result = value(*args, **kwargs)
        calls.append(call)  # not if it raises, which some examples show
        return result

    homes = [m for n, m in sys.modules.items() if n.startswith("kvision") and vars(m).get(value.__name__) is value]
    for home in homes:
        setattr(home, value.__name__, wrapper)
    try:
        yield
    finally:
        for home in homes:
            setattr(home, value.__name__, value)


def has_forward(cls: type, method: str) -> bool:
    return method == "forward" and issubclass(cls, nn.Module) and cls.forward is not nn.Module.forward


def recording(cls: type, method: str, calls: list[Call]) -> Callable[..., Any]:
    original = getattr(cls, method)

    @wraps(original)
    def wrapper(self: Any, *args: Any, **kwargs: Any) -> Any:
        if type(self) is cls:
            target = cls if method == "__init__" else self
            name = cls.__qualname__ + ("" if method == "__init__" else ".forward")
            calls.append(Call(name, target, [copied(a) for a in args], {k: copied(a) for k, a in kwargs.items()}))
        before = len(calls)
        result = original(self, *args, **kwargs)
        if method == "__init__":
            del calls[before:]  # those of forward, by which a constructor checks its arguments
        return result

    return wrapper


@cache
def example_calls(home: str) -> dict[str, list[Call]]:
    """The recorded calls of the public objects that a file of kvision defines, by their names. Running the examples of
    all files takes a quarter of a minute, so tests ask for one when they run, not when they are collected."""
    result = {}
    for name, value in OBJECTS.items():
        if home_of(name) != home:
            continue
        calls: list[Call] = []
        examples: Sequence[doctest.DocTest] = doctest.DocTestFinder(recurse=False).find(value, name, globs={})
        with recorded(value, calls):
            for example in examples:
                doctest.DocTestRunner(verbose=False).run(example, out=lambda _: None)
        result[name] = calls
    return result


def home_of(name: str) -> str:
    """The file that defines a public object: `filters.sobel` of `filters.sobel.Sobel`."""
    return name.rpartition(".")[0]


HOMES = sorted(set(map(home_of, OBJECTS)))
