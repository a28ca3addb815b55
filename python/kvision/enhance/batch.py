"""Images of any rank as one batch, and the parameters that go with them."""

from __future__ import annotations

import math

from torch import Tensor

from kvision import _check
from kvision._leading import flat
from kvision.core.exceptions import ImageError, ShapeError


def as_batch(x: Tensor) -> Tensor:
    """(*, C, H, W) as (B, C, H, W): the axes in front joined, or added where there are fewer than four."""
    return flat(x if x.dim() > 2 else x.reshape((1,) * (3 - x.dim()) + x.shape))


def parameter(
    op: str, name: str, value: float | Tensor, x: Tensor, minimum: float = -math.inf
) -> tuple[Tensor | None, float]:
    """A parameter of images `x` as (tensor beside as_batch(x), 0), or as (None, number).

    The axes of a tensor are the first ones of `x`, of the same size or 1: (B,) has one value a sample, (B, C) one a
    channel. Only numbers are compared with `minimum`: a look at a tensor would wait for its device.
    """
    if not isinstance(value, Tensor):
        return None, _check.number(op, name, value, minimum)
    _check.numbers(op, name, value)
    _check.same_device(op, **{"the images": x, name: value})
    if value.dim() > x.dim() or any(n not in (1, m) for n, m in zip(value.shape, x.shape)):
        raise ShapeError(
            f"{op}: expected {name} with the first axes of the images {tuple(x.shape)}, or axes of size 1, "
            f"got {tuple(value.shape)}",
            actual_shape=value.shape,
        )
    value = value.reshape(*value.shape, *(1,) * (x.dim() - value.dim()))
    if x.dim() > 4 and value.shape[:-3].numel() > 1:
        value = value.expand(*x.shape[:-3], *value.shape[-3:])
    return as_batch(value), 0.0


def per_pixel(op: str, name: str, value: float | Tensor, x: Tensor) -> tuple[Tensor | None, float]:
    """A parameter that all channels of a pixel share."""
    tensor, number = parameter(op, name, value, x)
    if tensor is not None and tensor.shape[1] != 1:
        raise ShapeError(f"{op}: expected one {name} for all channels, got {tuple(value.shape)}")  # type: ignore[union-attr]
    return tensor, number


def chosen(tensor: Tensor | None, number: float) -> Tensor | float:
    """The one of both that `parameter` found."""
    return number if tensor is None else tensor


def floats(op: str, name: str, x: Tensor) -> None:
    """Raise unless `x` is a tensor of floating-point numbers with at least one axis."""
    _check.numbers(op, name, x)
    _check.floating(op, name, x)
    if x.dim() == 0:
        raise ShapeError(f"{op}: expected {name} of shape (*, C, H, W), got ()", actual_shape=x.shape)


def images(op: str, name: str, x: Tensor, spatial: int = 2) -> None:
    """Raise unless `x` holds floating-point images, at least (H, W); or (D, H, W), where `spatial` is 3."""
    _check.numbers(op, name, x)
    _check.floating(op, name, x)
    if x.dim() < spatial or 0 in x.shape[-spatial:]:
        axes = ", ".join(("D", "H", "W")[-spatial:])
        raise ShapeError(
            f"{op}: expected {name} of shape (*, C, {axes}) with {axes} of at least 1, got {tuple(x.shape)}",
            actual_shape=x.shape,
        )


def colours(op: str, name: str, x: Tensor) -> None:
    """Raise unless `x` holds floating-point images of three channels, (*, 3, H, W)."""
    _check.channels(op, name, x, 3, ImageError)
    _check.floating(op, name, x)
