"""Checks of the arguments of classes, which give what is kept of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from kvision import _check
from kvision.tv.functional.geometry import PADDING_MODES, interpolation_name

Check = Callable[[str, str, Any], Any]  # of the name of a class, that of an argument, and its value


def _of_numbers(counts: Sequence[int], words: str, is_right: Callable[[Any], bool] = lambda values: True) -> Check:
    """A check of a sequence of so many numbers, for which `is_right`; `words` say what is expected."""

    def check(op: str, name: str, value: Any) -> Any:
        values = _check.scalars(op, name, value)
        if not isinstance(values, (tuple, list)) or len(values) not in counts or not is_right(values):
            raise ValueError(f"{op}: expected {name} to be {words}, got {value!r}")
        return tuple(_check.number(op, name, v) if not _check.is_int(v) else v for v in values)

    return check


def optional(check: Check) -> Check:
    return lambda op, name, value: None if value is None else check(op, name, value)


def _ascends(values: Any) -> bool:
    return bool(values[0] <= values[1])


def choice_of(names: Sequence[Any]) -> Check:
    def check(op: str, name: str, value: Any) -> Any:
        _check.choice(op, name, value, names)
        return value

    return check


def _interpolation(op: str, name: str, value: Any) -> Any:
    interpolation_name(op, value)
    return value


def two(op: str, name: str, value: Any) -> tuple[int, int]:
    """A height and width of at least 1, from an int for both, or a sequence of one or two."""
    values = _check.scalars(op, name, value)
    values = (values,) if isinstance(values, (int, float)) else values
    if not isinstance(values, (tuple, list)) or len(values) not in (1, 2):
        raise ValueError(f"{op}: expected {name} to be a number or 1 or 2 of them, got {value!r}")
    height, width = _check.ints(op, name, (values[0], values[-1]), 2)
    return height, width


def two_numbers(value: Any) -> tuple[Any, Any]:
    return (value, value) if isinstance(value, (int, float)) else (value[0], value[-1])


def interval(op: str, name: str, value: Any) -> list[float]:
    """A number a as [-a, a], or a sequence of two, for shears of four."""
    values = _check.scalars(op, name, value)
    if isinstance(values, (int, float)):
        if values < 0:
            raise ValueError(f"{op}: expected {name} of at least 0, got {value}")
        return [-float(values), float(values)]
    words, counts = ("a number, two or four", (2, 4)) if name == "shear" else ("a number or two", (2,))
    return [float(v) for v in _of_numbers(counts, words)(op, name, values)]


pair = _of_numbers((2,), "two numbers in ascending order", _ascends)
positive_pair = _of_numbers((2,), "two numbers above 0", lambda values: min(values) > 0)
fractions = _of_numbers((2,), "two numbers in [0, 1]", lambda values: 0 <= min(values) and max(values) <= 1)
# By the names of arguments, which mean the same in all classes that do not have `checks` of their own.
CHECKS: dict[str, Check] = {
    "p": _check.fraction,
    "size": two,
    "interpolation": _interpolation,
    "padding_mode": choice_of(PADDING_MODES),
    "degrees": interval,
    "translate": optional(fractions),
    "ratio": _of_numbers((2,), "two numbers above 0, ascending", lambda v: 0 < v[0] <= v[1] < math.inf),
    "scale": _of_numbers((2,), "two numbers"),
    "side_range": _of_numbers((2,), "two numbers of at least 1, ascending", lambda v: 1 <= v[0] <= v[1]),
    "distortion_scale": _check.fraction,
    **dict.fromkeys(("brightness", "contrast", "saturation", "hue"), pair),
}
