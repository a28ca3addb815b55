"""Draws as v2's, in its order, so that a seed draws the same; those of the samples of a batch together."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np
import torch

# Where set, the source of numbers in [0, 1).
_numbers: ContextVar[Iterator[float] | None] = ContextVar("kvision.tv numbers", default=None)


@contextmanager
def setting(variable: ContextVar[Any], value: Any) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def together() -> AbstractContextManager[None]:
    """Take numbers from few draws of many."""
    return setting(_numbers, _unit_numbers())


def _unit_numbers() -> Iterator[float]:
    while True:
        yield from torch.rand(256, dtype=torch.float64, device="cpu").tolist()


def units(count: int) -> Any:
    """An array of the numbers that `unit` would give in turn, while they are taken together."""
    numbers = _numbers.get()
    assert numbers is not None
    return np.fromiter(itertools.islice(numbers, count), np.float64, count)


def unit() -> float:
    numbers = _numbers.get()
    return torch.rand(1, device="cpu").item() if numbers is None else next(numbers)


def uniform(interval: Any) -> float:
    (low, high), numbers = interval, _numbers.get()
    if numbers is None:
        return torch.empty(1, device="cpu").uniform_(low, high).item()
    return low + next(numbers) * (high - low)


def between(interval: Any, count: int = 1) -> Any:
    """A tensor of numbers that are never those of samples of a batch: of sizes, that all have in common."""
    low, high = interval
    return low + torch.rand(count, device="cpu") * (high - low)


@functools.lru_cache(64)
def _logarithms(*numbers: float) -> list[float]:
    return torch.log(torch.tensor(numbers, device="cpu")).tolist()


def log_uniform(interval: Any) -> float:
    """Between two numbers, whose logarithms are as v2's in float32."""
    low, high = _logarithms(*interval)
    if _numbers.get() is None:
        return torch.exp(torch.empty(1, device="cpu").uniform_(low, high)).item()
    return math.exp(uniform((low, high)))


def integer(low: int, high: int) -> int:
    """Of [low, high)."""
    if (numbers := _numbers.get()) is None:
        return torch.randint(low, high, (1,), device="cpu").item()  # type: ignore[return-value]  # of integers
    return low + int(next(numbers) * (high - low))


def permutation(n: int) -> list[int]:
    if (numbers := _numbers.get()) is None:
        return torch.randperm(n, device="cpu").tolist()
    return sorted(range(n), key=lambda _: next(numbers))
