"""Argument checks. Every message says operator, argument, expected, got; see CONTRIBUTING.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError

BORDERS = ("constant", "reflect", "replicate", "circular")


def is_tensor(op: str, name: str, x: Any) -> None:
    """Raise TypeCheckError unless `x` is a tensor of real numbers."""
    if not isinstance(x, Tensor):
        raise TypeCheckError(f"{op}: expected {name} to be a Tensor, got {type(x).__name__}", actual_type=type(x))
    if x.dtype.is_complex:
        raise TypeCheckError(f"{op}: expected {name} to be real, got {x.dtype}", actual_type=x.dtype)


def shape(op: str, name: str, x: Any, *expected: str | int) -> None:
    """Raise unless `x` is a tensor with one axis per entry of `expected`; an int entry fixes the size of its axis."""
    is_tensor(op, name, x)
    if x.dim() != len(expected) or any(isinstance(e, int) and e != n for e, n in zip(expected, x.shape)):
        want = ", ".join(map(str, expected)) + ("," if len(expected) == 1 else "")
        raise ShapeError(
            f"{op}: expected {name} of shape ({want}), got {tuple(x.shape)}", actual_shape=x.shape, expected_shape=expected
        )


def images(op: str, name: str, x: Any) -> None:
    """Raise unless `x` is a (B, C, H, W) tensor with at least one pixel an image."""
    is_tensor(op, name, x)
    if x.dim() != 4:
        raise ShapeError(f"{op}: expected {name} of shape (B, C, H, W), got {tuple(x.shape)}", actual_shape=x.shape)
    if x.shape[2] == 0 or x.shape[3] == 0:
        raise ShapeError(f"{op}: expected {name} with H, W of at least 1, got {tuple(x.shape)}", actual_shape=x.shape)


def volumes(op: str, name: str, x: Any) -> None:
    """Raise unless `x` is a (B, C, D, H, W) tensor with at least one voxel a volume."""
    is_tensor(op, name, x)
    if x.dim() != 5:
        raise ShapeError(f"{op}: expected {name} of shape (B, C, D, H, W), got {tuple(x.shape)}", actual_shape=x.shape)
    if 0 in x.shape[2:]:
        raise ShapeError(f"{op}: expected {name} with D, H, W of at least 1, got {tuple(x.shape)}", actual_shape=x.shape)


def floating(op: str, name: str, x: Tensor) -> None:
    """Raise TypeCheckError unless `x` holds floating-point numbers."""
    if not x.is_floating_point():
        raise TypeCheckError(f"{op}: expected {name} to be floating point, got {x.dtype}", actual_type=x.dtype)


def same_device(op: str, **tensors: Tensor) -> None:
    """Raise DeviceError unless all the named tensors are on one device."""
    devices = {name: x.device for name, x in tensors.items()}
    if len(set(devices.values())) > 1:
        got = ", ".join(f"{name} on {device}" for name, device in devices.items())
        raise DeviceError(f"{op}: expected all tensors on one device, got {got}", actual_devices=list(devices.values()))


def choice(op: str, name: str, value: Any, options: Sequence[Any]) -> None:
    """Raise ValueCheckError unless `value` is one of `options`."""
    if value not in options:
        listed = ", ".join(map(str, options))
        raise ValueCheckError(f"{op}: {name} must be one of {listed}; got {value!r}", actual_value=value)


def border(op: str, border_type: Any) -> None:
    """Raise ValueCheckError unless `border_type` names a border rule."""
    if border_type not in BORDERS:
        choice(op, "border_type", border_type, BORDERS)


def reflectable(op: str, x: Tensor, pads: Sequence[int], border_type: str) -> None:
    """Raise ShapeError where a border of `pads` pixels along the trailing axes of `x` would reach past the other rim.

    'reflect' needs more pixels than it mirrors, 'circular' as many as it repeats; torch's padding has the same limits.
    """
    if border_type not in ("reflect", "circular"):
        return
    spare = 0 if border_type == "circular" else 1
    for pad, size in zip(pads, x.shape[x.dim() - len(pads) :]):
        if pad > size - spare:
            raise ShapeError(
                f"{op}: expected input larger than its '{border_type}' border of {pad} pixels, got {tuple(x.shape)}; "
                "use border_type='replicate' for images this small",
                actual_shape=x.shape,
            )


def pair(op: str, name: str, value: Any, minimum: int = 1) -> tuple[int, int]:
    """`value`, an int or two of them in (y, x) order, as (y, x); each at least `minimum`."""
    return ints(op, name, value, 2, minimum)  # type: ignore[return-value]  # two entries by construction


def ints(op: str, name: str, value: Any, count: int, minimum: int = 1) -> tuple[int, ...]:
    """`value`, an int or `count` of them, as a tuple of `count` ints of at least `minimum`."""
    given, kind = value, "an int" if count == 1 else f"an int or {count} ints"
    if type(value) is int:
        value = (value,) * count
    elif isinstance(value, torch.Size):
        value = tuple(value)
    if not isinstance(value, (tuple, list)) or any(isinstance(v, bool) or not isinstance(v, int) for v in value):
        raise TypeCheckError(f"{op}: expected {name} to be {kind}, got {given!r}", actual_type=type(given))
    if len(value) != count or any(v < minimum for v in value):
        raise ValueCheckError(
            f"{op}: expected {name} to be {kind} of at least {minimum}, got {given!r}", actual_value=given
        )
    return tuple(value)


def odd(op: str, name: str, sizes: Sequence[int]) -> None:
    """Raise ValueCheckError unless all `sizes` are odd."""
    if any(n % 2 == 0 for n in sizes):
        raise ValueCheckError(f"{op}: expected {name} to be odd, got {tuple(sizes)}", actual_value=tuple(sizes))
