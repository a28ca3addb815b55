"""Precision of the geometry of few points: half types are computed in float32 and rounded once; autocast is off."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch
from torch import Tensor

from kvision._dtype import is_autocast_on
from kvision._torch_compat import is_any_autocast_enabled
from kvision.geometry.linalg import root

F = TypeVar("F", bound=Callable[..., Any])

_HALF_TYPES = (torch.float16, torch.bfloat16)


def in_full_precision(function: F) -> F:
    """`function` of tensors that computes half types in float32 and ignores autocast.

    The first tensor sets the type: the others are converted to the one it is computed in, results are stored in its own.
    """

    @functools.wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        values = (*args, *kwargs.values()) if kwargs else args
        if not is_any_autocast_enabled():
            for a in values:
                if isinstance(a, Tensor) and a.dtype is not torch.float32:
                    break
            else:
                return function(*args, **kwargs)  # which also raises the error for a missing tensor
        tensors = [a for a in values if isinstance(a, Tensor)]
        if not tensors:
            return function(*args, **kwargs)
        first = tensors[0]
        if is_autocast_on(first):
            with torch.autocast(first.device.type, enabled=False):
                return wrapped(*args, **kwargs)
        computed = torch.float32 if first.dtype in _HALF_TYPES else first.dtype
        if not first.is_floating_point() or all(a.dtype is computed or not a.is_floating_point() for a in tensors):
            return function(*args, **kwargs)
        output = function(*_map(lambda x: x.to(computed), args), **_map(lambda x: x.to(computed), kwargs))
        return _map(lambda y: y.to(first.dtype), output)

    return wrapped  # type: ignore[return-value]


def _map(f: Callable[[Any], Any], values: Any) -> Any:
    if isinstance(values, tuple):
        return tuple(_map(f, v) for v in values)
    if isinstance(values, dict):
        return {k: _map(f, v) for k, v in values.items()}
    return f(values) if isinstance(values, Tensor) and values.is_floating_point() else values


# --- values at the boundary of a function's domain, with finite gradients ---------------------------------------------


def quotient(a: Tensor, b: Tensor, otherwise: float) -> Tensor:
    """a / b, and `otherwise`, without a gradient, where b is 0."""
    zero = b == 0
    return torch.where(zero, otherwise, a / torch.where(zero, 1, b))


def length(x: Tensor, keepdim: bool = False) -> Tensor:
    """Of the vectors along the last axis, with gradient 0 at 0."""
    return root(x.square().sum(-1, keepdim=keepdim))
