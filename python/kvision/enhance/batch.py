"""Images of any rank as one batch, and parameters that broadcast to it."""

from __future__ import annotations

import math

from torch import Tensor

from kvision import _check
from kvision._leading import flatten_batch
from kvision.core.exceptions import ImageError, ShapeError


def as_batch(x: Tensor) -> Tensor:
    """Reshape (*, C, H, W) to (B, C, H, W): flatten the leading axes, or add some if there are fewer than four."""
    return flatten_batch(x if x.dim() > 2 else x.reshape((1,) * (3 - x.dim()) + x.shape))


def shaped(y: Tensor, x: Tensor) -> Tensor:
    """Reshape a result for as_batch(x) to the axes of `x`."""
    return y if y.dim() == x.dim() else y.reshape(x.shape)


def parameter(op: str, name: str, value: float | Tensor, x: Tensor, minimum: float = -math.inf) -> float | Tensor:
    """Return a parameter of images `x` as a step on as_batch(x) takes it: a number, or a tensor (B or 1, C or 1, 1).

    The axes of a tensor are the first ones of `x`, of the same size or 1: (B,) has one value a sample, (B, C) one a
    channel; one a pixel gives (B, C, H, W). Only numbers are compared with `minimum`: a look at a tensor would wait for
    its device.
    """
    if not isinstance(value, Tensor):
        return _check.number(op, name, value, minimum)
    _check.numbers(op, name, value)
    value = _check.to_device_of(op, x, name, value, of="the images")
    axes, sizes = x.dim(), value.shape
    if len(sizes) > axes or any(n not in (1, m) for n, m in zip(sizes, x.shape)):
        raise ShapeError(
            f"{op}: expected {name} with the first axes of the images {tuple(x.shape)}, or axes of size 1, "
            f"got {tuple(sizes)}",
            actual_shape=sizes,
        )
    if sizes[axes - 2 :].numel() > 1:
        return as_batch(value.reshape(*sizes, *(1,) * (axes - len(sizes))).expand(*x.shape[:-3], *(-1,) * min(axes, 3)))
    channels = sizes[axes - 3] if 0 <= axes - 3 < len(sizes) else 1
    if axes > 4 and sizes[: axes - 3].numel() > 1:
        value = value.reshape(*sizes[: axes - 3], *(1,) * (axes - 3 - len(sizes)), channels)
        value = value.expand(*x.shape[:-3], channels)
    return value.reshape(math.prod(value.shape[: axes - 3]), channels, 1)


def broadcastable(op: str, name: str, value: Tensor, x: Tensor) -> Tensor:
    """`value` on the device of `x`; raise unless it is a tensor of numbers that broadcasts to `x`, from the last axis."""
    _check.numbers(op, name, value)
    if value.dim() > x.dim() or any(n not in (1, m) for n, m in zip(reversed(value.shape), reversed(x.shape))):
        raise ShapeError(
            f"{op}: expected {name} to broadcast to {tuple(x.shape)}, got {tuple(value.shape)}",
            actual_shape=value.shape,
        )
    return _check.to_device_of(op, x, name, value, of="the images")


def broadcast(value: Tensor, x: Tensor) -> Tensor:
    """Return a value that broadcasts to images `x` as a step on as_batch(x) takes it."""
    missing = (1,) * (max(x.dim(), 3) - value.dim())
    value = value.reshape(*missing, *value.shape)
    if value.dim() > 4 and value.shape[:-3].numel() > 1:
        value = value.expand(*x.shape[:-3], *value.shape[-3:])
    value = flatten_batch(value)
    return value[..., 0] if value.shape[2:].numel() == 1 else value


def per_pixel(op: str, name: str, value: float | Tensor, x: Tensor) -> float | Tensor:
    """Return a parameter with one value for all channels of a pixel."""
    checked = parameter(op, name, value, x)
    if isinstance(checked, Tensor) and checked.shape[1] != 1:
        raise ShapeError(f"{op}: expected one {name} for all channels, got {tuple(value.shape)}")  # type: ignore[union-attr]
    return checked


def floats(op: str, name: str, x: Tensor) -> None:
    """Raise unless `x` is a tensor of floating-point numbers or uint8 with at least one axis."""
    _check.numbers(op, name, x)
    _check.floating_or_bytes(op, name, x)
    if x.dim() == 0:
        raise ShapeError(f"{op}: expected {name} of shape (*, C, H, W), got ()", actual_shape=x.shape)


def images(op: str, name: str, x: Tensor, spatial: int = 2) -> None:
    """Raise unless `x` holds images, floating point or uint8, at least (H, W); or (D, H, W), where `spatial` is 3."""
    _check.numbers(op, name, x)
    _check.floating_or_bytes(op, name, x)
    if x.dim() < spatial or 0 in x.shape[-spatial:]:
        axes = ", ".join(("D", "H", "W")[-spatial:])
        raise ShapeError(
            f"{op}: expected {name} of shape (*, C, {axes}) with {axes} of at least 1, got {tuple(x.shape)}",
            actual_shape=x.shape,
        )


def colors(op: str, name: str, x: Tensor) -> None:
    """Raise unless `x` holds images of three channels, floating point or uint8, (*, 3, H, W)."""
    _check.channels(op, name, x, 3, ImageError)
    _check.floating_or_bytes(op, name, x)
