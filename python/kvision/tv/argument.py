"""Checks of the arguments of classes, which give what is kept of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from kvision import _check
from kvision.tv.functional.geometry import PADDING_MODES, four_paddings, interpolation_name
from kvision.tv.inputs import one_or_two

Check = Callable[[str, str, Any], Any]  # of the name of a class, that of an argument, and its value


def where(check: Check, is_right: Callable[[Any], bool], words: str) -> Check:
    """A check of what another one keeps, for which `is_right`; `words` say what is expected."""

    def checked(op: str, name: str, value: Any) -> Any:
        kept = check(op, name, value)
        if not is_right(kept):
            raise ValueError(f"{op}: expected {name} to be {words}, got {value!r}")
        return kept

    return checked


def optional(check: Check) -> Check:
    return lambda op, name, value: None if value is None else check(op, name, value)


def anything(op: str, name: str, value: Any) -> Any:
    return value


def one_of(*choices: Any) -> Check:
    return where(anything, choices.__contains__, f"one of {', '.join(map(str, choices))}")


def several(op: str, name: str, value: Any) -> list[Any]:
    """One or more numbers as a list."""
    values = _check.scalars(op, name, value)
    return [values] if isinstance(values, (int, float)) else list(values)


def two_numbers(op: str, name: str, value: Any) -> tuple[Any, Any]:
    return one_or_two(op, name, _check.scalars(op, name, value))


def two(op: str, name: str, value: Any) -> tuple[int, int]:
    """A height and width of at least 1, from an int for both, or a sequence of one or two."""
    height, width = _check.ints(op, name, two_numbers(op, name, value), 2)
    return height, width


def _pair(op: str, name: str, value: Any) -> tuple[Any, ...]:
    values = _check.scalars(op, name, value)
    if not isinstance(values, (tuple, list)) or len(values) != 2:
        raise ValueError(f"{op}: expected {name} to be two numbers, got {value!r}")
    return tuple(v if _check.is_int(v) else _check.number(op, name, v) for v in values)


def interval(op: str, name: str, value: Any) -> list[float]:
    """A number a as [-a, a], or a sequence of two, for shears of four."""
    values = _check.scalars(op, name, value)
    if isinstance(values, (int, float)):
        if values < 0:
            raise ValueError(f"{op}: expected {name} of at least 0, got {value}")
        return [-float(values), float(values)]
    if not isinstance(values, (tuple, list)) or len(values) not in ((2, 4) if name == "shear" else (2,)):
        raise ValueError(f"{op}: expected {name} to be a number or two, of shears four, got {value!r}")
    return [_check.number(op, name, v) for v in values]


def _interpolation(op: str, name: str, value: Any) -> Any:
    interpolation_name(op, value)
    return value


def padding(op: str, name: str, value: Any) -> Any:
    four_paddings(_check.scalars(op, name, value))
    return value


ascending = where(_pair, lambda v: v[0] <= v[1], "two numbers in ascending order")
above_0 = where(_pair, lambda v: min(v) > 0, "two numbers above 0")
fractions = where(_pair, lambda v: 0 <= min(v) and max(v) <= 1, "two numbers in [0, 1]")
# By the names of arguments, which mean the same in all classes that do not have `checks` of their own.
CHECKS: dict[str, Check] = {
    "p": _check.fraction,
    "size": two,
    "interpolation": _interpolation,
    "padding": padding,
    "padding_mode": one_of(*PADDING_MODES),
    "degrees": interval,
    "translate": optional(fractions),
    "ratio": where(ascending, lambda v: 0 < v[0] and v[1] < math.inf, "two numbers above 0, ascending"),
    "scale": _pair,
    "side_range": where(ascending, lambda v: v[0] >= 1, "two numbers of at least 1, ascending"),
    "distortion_scale": _check.fraction,
    "labels_getter": where(anything, lambda v: v in (None, "default") or callable(v), "'default', a function or None"),
    **dict.fromkeys(("brightness", "contrast", "saturation", "hue"), ascending),
}
