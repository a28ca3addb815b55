"""`patch_kornia`: kvision's functions and modules instead of Kornia's, in a program that stays with Kornia."""

from __future__ import annotations

import ast
import functools
import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import torch
from torch import Tensor, nn

from kvision.core.exceptions import TypeCheckError
from kvision.migrate import Difference, concerns, differences


class KorniaPatch:
    """What `patch_kornia` has replaced, and what it left to Kornia. As a context manager it is undone on exit.

    Attributes:
        replaced: names in Kornia, such as 'filters.sobel'.
        partly: names whose calls go to kvision except for those that it would answer differently, with these calls.
        left: names that both libraries have and Kornia keeps, with the reasons.
        places: how many names of Kornia's modules were replaced.
    """

    def __init__(self, replacements: Sequence[_Replacement], partly: dict[str, str], left: dict[str, str]) -> None:
        self.partly = partly
        self.left = left
        self.replaced = [r.name for r in replacements if r.name not in partly]
        self._ours = {id(r.theirs): r.ours for r in replacements}
        self._theirs = {id(r.ours): r.theirs for r in replacements}
        self._replacements = replacements  # which keeps the objects, and with them their ids
        self._originals = _substitute(self._ours)
        self.places = len(self._originals)

    def undo(self) -> None:
        """Put back everything of Kornia, also in modules of Kornia that were imported meanwhile."""
        for namespace, name, theirs, ours in self._originals:
            if namespace.get(name) is ours:
                namespace[name] = theirs
        _substitute(self._theirs)
        self._originals, self._theirs = [], {}

    def __enter__(self) -> KorniaPatch:
        return self

    def __exit__(self, *_: object) -> None:
        self.undo()

    def __repr__(self) -> str:
        count = len(self.replaced) + len(self.partly)
        lines = [
            f"kvision serves {count} functions and modules of Kornia, in {self.places} places",
            f"  replaced: {', '.join(self.replaced)}",
            "  replaced, but calls of these kinds go to Kornia:",
            *(f"    {name}: {calls}" for name, calls in self.partly.items()),
            "  left to Kornia:",
            *(f"    {name}: {reason}" for name, reason in self.left.items()),
        ]
        return "\n".join(lines)


def patch_kornia(include_different: bool = False) -> KorniaPatch:
    """Let kvision's functions and modules replace Kornia's of the same names, everywhere in Kornia.

    Every loaded module of Kornia that holds such a function or class gets kvision's, so that Kornia's augmentations and
    losses compute with kvision, too. Names that a program has imported from Kornia before stay Kornia's: patch first, or
    call them as `kornia.filters.sobel`. Objects that were made before keep their class. Kornia is imported if it is not yet.

    Calls whose values would differ by more than rounding go to Kornia as before; the rows marked with a star in
    docs/differences.md say which ones. Some hold for certain arguments, such as `resize(antialias=True)`, and then only
    these calls go there.

    Args:
        include_different: replace those as well.

    Returns:
        A report, whose repr lists what was replaced and what was not, and why. It is a context manager, which puts
        Kornia's back on exit; `undo()` does the same.

    Raises:
        ImportError: Kornia is not installed.
        TypeCheckError: include_different is not a bool.

    Example:
        >>> import kvision, kornia  # doctest: +SKIP
        >>> with kvision.patch_kornia():  # doctest: +SKIP
        ...     kornia.filters.sobel is kvision.filters.sobel
        True
    """
    if not isinstance(include_different, bool):
        raise TypeCheckError(f"patch_kornia: expected include_different to be a bool, got {include_different!r}")
    importlib.import_module("kornia")
    rows = [] if include_different else [row for row in differences() if row.values]
    replacements: list[_Replacement] = []
    partly: dict[str, str] = {}
    left: dict[str, str] = {}
    for name, theirs, ours in _same_names():
        if reason := _incompatible(theirs, ours):
            left[name] = reason
            continue
        calls = [_Calls.of(row) for row in rows if concerns(row, name.split("."))]
        if any(c.all for c in calls) or (calls and inspect.isclass(theirs)):
            left[name] = "; ".join(c.text for c in calls)
            continue
        if calls:
            partly[name] = "; ".join(c.text for c in calls)
            ours = _choosing(theirs, ours, calls)
        replacements.append(_Replacement(name, theirs, ours))
    return KorniaPatch(replacements, partly, left)


# --- what is replaced -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Replacement:
    name: str
    theirs: Any
    ours: Any


def _same_names() -> Iterator[tuple[str, Any, Any]]:
    """(name, Kornia's, kvision's) of the functions and module classes that both have in a module of the same name."""
    seen: set[int] = set()
    for path in sorted(_public_modules(), key=lambda path: (path.count("."), path)):
        theirs, ours = (importlib.import_module(f"{library}.{path}") for library in ("kornia", "kvision"))
        for name, value in vars(theirs).items():
            other = getattr(ours, name, None)
            if name[0] == "_" or other is None or id(value) in seen or not _is_from(value, "kornia"):
                continue
            if _kind(value) is not None and _kind(value) == _kind(other):
                seen.add(id(value))
                yield f"{path}.{name}", value, other


# Random augmentations of one seed would not be the same ones. What they call is replaced.
_KEPT = ("augmentation",)


def _public_modules() -> Iterator[str]:
    """Paths of the packages that both libraries have."""
    for name in list(sys.modules):
        library, _, path = name.partition(".")
        if library != "kornia" or not path or "._" in name or path.count(".") > 1 or path.split(".")[0] in _KEPT:
            continue
        try:
            spec = importlib.util.find_spec(f"kvision.{path}")
        except ModuleNotFoundError:  # of the package that it is in
            continue
        if spec is not None and spec.submodule_search_locations is not None:
            yield path


def _kind(value: Any) -> str | None:
    if inspect.isclass(value):
        return "module" if issubclass(value, nn.Module) else None
    return "function" if inspect.isfunction(value) else None


def _is_from(value: Any, library: str) -> bool:
    return (getattr(value, "__module__", None) or "").partition(".")[0] == library


def _incompatible(theirs: Any, ours: Any) -> str:
    """Why kvision's cannot replace Kornia's; empty if it can."""
    if inspect.isclass(theirs) and "forward" not in {
        name for c in theirs.__mro__ if c is not nn.Module for name in vars(c)
    }:
        return "has no forward"
    if inspect.isclass(theirs) and theirs.__subclasses__():
        return f"Kornia's {', '.join(sorted(c.__name__ for c in theirs.__subclasses__()))} derive from it"
    for f, g in _callables(theirs, ours):
        taken, accepted = (list(inspect.signature(x).parameters.values()) for x in (f, g))
        if any(p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD) for p in accepted):
            continue
        names = [p.name for p in taken if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
        if names != [p.name for p in accepted][: len(names)]:
            return "takes other arguments in kvision"
        for annotation in (p.annotation for p in (*taken, *accepted)):
            if match := _OBJECTS.search(str(annotation)):
                return f"takes a {match[0]} of its own library"
    return ""


# Classes of both libraries that are neither modules nor accepted from the other one.
_OBJECTS = re.compile(
    r"\b(Boxes(?:3D)?|CFA|ColorMap|Hyperplane|Image|Keypoints(?:3D)?|NamedPose|PinholeCamera|Quaternion)\b"
)


def _callables(theirs: Any, ours: Any) -> Iterator[tuple[Any, Any]]:
    """A function with kvision's, or the methods of a class that are called with arguments."""
    if _kind(theirs) == "function":
        yield theirs, ours
    else:
        yield theirs.__init__, ours.__init__
        yield theirs.forward, ours.forward


# --- calls that go to Kornia ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Calls:
    """The calls that a row of docs/differences.md is about: all, those with images of a type, or those with some arguments.

    A row of the second kind begins with "uint8 images" or "integer images", one of the third kind has `name=value` in its first
    cell.
    """

    text: str
    all: bool
    images: str = ""
    arguments: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, row: Difference) -> _Calls:
        arguments: dict[str, tuple[Any, ...]] = {}
        for key, value in re.findall(r"\b(\w+)=((?:\"[^\"]*\")|\w+)", row.where):
            arguments[key] = (*arguments.get(key, ()), ast.literal_eval(value))
        images = next((kind for kind in ("uint8 images", "integer images") if row.where.startswith(kind)), "")
        kinds = [f"{key}={value!r}" for key, values in arguments.items() for value in values]
        text = images or " or ".join(kinds) or f"{row.where}: {row.kornia} -> {row.kvision}"
        return cls(text, not images and not arguments, images, arguments)

    def include(self, arguments: Mapping[str, Any]) -> bool:
        if self.images:
            return self.include_image(next(iter(arguments.values()), None))
        return any(arguments.get(key) in values for key, values in self.arguments.items())

    def include_image(self, image: Any) -> bool:
        if not isinstance(image, Tensor) or image.dtype.is_floating_point:
            return False
        return image.dtype == torch.uint8 or self.images == "integer images"


def _choosing(theirs: Callable[..., Any], ours: Callable[..., Any], calls: Sequence[_Calls]) -> Callable[..., Any]:
    """kvision's function, but Kornia's for these calls."""
    if all(c.images for c in calls):  # the common case, without looking at the other arguments

        def function(*args: Any, **kwargs: Any) -> Any:
            first = args[0] if args else next(iter(kwargs.values()), None)
            return (theirs if any(c.include_image(first) for c in calls) else ours)(*args, **kwargs)

    else:
        signature = inspect.signature(theirs)

        def function(*args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            return (theirs if any(c.include(bound.arguments) for c in calls) else ours)(*args, **kwargs)

    return functools.wraps(ours)(function)


# --- replacing ------------------------------------------------------------------------------------------------------


def _substitute(values: Mapping[int, Any]) -> list[tuple[dict[str, Any], str, Any, Any]]:
    """Replace values by identity in the namespaces of Kornia's modules, and in the tuples and lists there.

    Returns where: namespace, name, value before, value after.
    """
    replacements = []
    for module_name, module in list(sys.modules.items()):
        if isinstance(module, ModuleType) and module_name.partition(".")[0] == "kornia":
            namespace = vars(module)
            for name, value in list(namespace.items()):
                new = _substituted(value, values)
                if new is not value:
                    namespace[name] = new
                    replacements.append((namespace, name, value, new))
    return replacements


def _substituted(value: Any, values: Mapping[int, Any]) -> Any:
    if id(value) in values:
        return values[id(value)]
    if type(value) in (tuple, list) and any(id(part) in values for part in value):
        return type(value)(values.get(id(part), part) for part in value)
    return value
