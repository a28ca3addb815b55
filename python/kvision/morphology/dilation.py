"""Dilation and erosion, from which all of morphology is made.

Both are one operator. With offsets i, j where the kernel of the structuring element is not 0,

    erosion   y(q) = min over i, j of x(q + (i, j) - origin) - height(i, j)
    dilation  y(q) = max over i, j of x(q - (i, j) + origin) + height(i, j)

Pixels with the same maximum get equal parts of its gradient.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, pixels
from kvision._ops import register, vjp
from kvision.core.exceptions import TypeCheckError, ValueCheckError

Border: TypeAlias = Literal["geodesic", "constant"]
_BORDERS = get_args(Border)
Engine: TypeAlias = Literal["auto", "unfold", "convolution", "shift"]
_ENGINES = get_args(Engine)


def _reference(
    x: Tensor, kernel: Tensor, heights: Tensor | None, origin_y: int, origin_x: int, value: float, erode: bool
) -> Tensor:
    """`kernel` and `heights` are (B or 1, height, width), `value` is the pixel outside of the images."""
    h, w = x.shape[-2:]
    ky, kx = kernel.shape[1:]
    worst = torch.inf if erode else -torch.inf
    top, left = (origin_y, origin_x) if erode else (ky - 1 - origin_y, kx - 1 - origin_x)
    padded = F.pad(x, (left, kx - 1 - left, top, ky - 1 - top), value=value)
    taps = []
    for i in range(ky):
        for j in range(kx):
            at = (slice(None), i, j, None, None, None)
            y, x_ = (i, j) if erode else (ky - 1 - i, kx - 1 - j)
            tap = padded[..., y : y + h, x_ : x_ + w]
            if heights is not None:
                tap = tap - heights[at] if erode else tap + heights[at]
            taps.append(torch.where(kernel[at] == 0, worst, tap))  # never chosen, even if the pixel is infinite
    return torch.stack(taps).amin(0) if erode else torch.stack(taps).amax(0)


register("dilation_backward", vjp(_reference), fake=lambda grad, x, *_: x.shape, layout_of=1)
_dilation = register("dilation", _reference, gradients="input: dilation_backward; heights: reference", bytes=True)


def dilation(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: Border = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: Engine = "auto",
) -> Tensor:
    """Take the largest pixel under a structuring element rotated by 180 degrees, as SciPy does.

    Args:
        tensor: images (B, C, H, W). uint8 gives uint8 (saturated), other integers give float32.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: heights (kH, kW) that are added to the pixels; it may carry a gradient. None for a flat element.
        origin: (y, x) of the element's center; None for (kH // 2, kW // 2).
        border_type: 'geodesic' leaves out what lies outside of the image, 'constant' has border_value there.
        border_value: see border_type.
        max_val: for compatibility, without effect.
        engine: for compatibility, one of 'auto', 'unfold', 'convolution', 'shift'; the result is the same.

    Returns:
        (B, C, H, W); minus infinity, or 0 of uint8, where no pixel is under the element. Pixels that share the maximum share its
        gradient evenly. NaN spreads to every window it is in.

    Raises:
        TypeCheckError: tensor, kernel or structuring_element is not a real tensor.
        ShapeError: tensor is not (B, C, H, W); kernel has no two axes, structuring_element others.
        ValueCheckError: an origin outside of the kernel; an unknown border_type or engine, which is a
            NotImplementedError, too.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: J. Serra, "Image analysis and mathematical morphology" (1982).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 5., 0., 0.]]]])
        >>> K.morphology.dilation(x, torch.ones(1, 3))
        tensor([[[[0., 5., 5., 5., 0.]]]])
    """
    element = checked(
        "dilation", tensor, kernel, structuring_element, origin, border_type, border_value, max_val, engine
    )
    return dilated(tensor, *element)


def erosion(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: Border = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: Engine = "auto",
) -> Tensor:
    """Take the smallest pixel under a structuring element.

    Args:
        tensor: images (B, C, H, W). uint8 gives uint8 (saturated), other integers give float32.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: heights (kH, kW) that are subtracted from the pixels; it may carry a gradient.
        origin: (y, x) of the element's center; None for (kH // 2, kW // 2).
        border_type: 'geodesic' leaves out what lies outside of the image, 'constant' has border_value there.
        border_value: see border_type.
        max_val: for compatibility, without effect.
        engine: for compatibility, one of 'auto', 'unfold', 'convolution', 'shift'; the result is the same.

    Returns:
        (B, C, H, W); infinity, or 255 of uint8, where no pixel is under the element.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`dilation`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[5., 5., 0., 5., 5.]]]])
        >>> K.morphology.erosion(x, torch.ones(1, 3))
        tensor([[[[5., 0., 0., 0., 5.]]]])
    """
    element = checked(
        "erosion", tensor, kernel, structuring_element, origin, border_type, border_value, max_val, engine
    )
    return eroded(tensor, *element)


# The structuring element of a call: mask and heights (1, kH, kW), origin, and the value outside of the image or None.
Element = tuple[Tensor, Tensor | None, tuple[int, int], float | None]


def checked(
    op: str,
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None,
    origin: Sequence[int] | None,
    border_type: Border,
    border_value: float,
    max_val: float,
    engine: Engine,
) -> Element:
    _check.images(op, "tensor", tensor)
    _check.shape(op, "kernel", kernel, "kH", "kW")
    ky, kx = kernel.shape
    if kernel.numel() == 0:
        raise ValueCheckError(f"{op}: expected a kernel of at least one pixel, got {tuple(kernel.shape)}")
    kernel = _check.to_device_of(op, tensor, "kernel", kernel, of="tensor")
    if structuring_element is not None:
        _check.shape(op, "structuring_element", structuring_element, ky, kx)
        structuring_element = _check.to_device_of(op, tensor, "structuring_element", structuring_element, of="tensor")
    if origin is None:
        origin = (ky // 2, kx // 2)
    elif not isinstance(origin, (tuple, list)) or len(origin) != 2 or not all(map(_check.is_int, origin)):
        raise TypeCheckError(f"{op}: expected origin to be two ints, got {origin!r}", actual_type=type(origin))
    y, x = origin
    if not (0 <= y < ky and 0 <= x < kx):
        raise ValueCheckError(f"{op}: expected an origin in the kernel {(ky, kx)}, got {origin!r}", actual_value=origin)
    _check.choice(op, "border_type", border_type, _BORDERS, _check.UnknownChoiceError)
    _check.choice(op, "engine", engine, _ENGINES, _check.UnknownChoiceError)
    border_value = _check.number(op, "border_value", border_value)
    _check.number(op, "max_val", max_val)
    dtype = compute_dtype(tensor)
    heights = None if structuring_element is None else structuring_element.to(dtype)[None]
    kernel = kernel if kernel.dtype == dtype else (kernel != 0).to(dtype)
    return kernel[None], heights, (y, x), border_value if border_type == "constant" else None


def dilated(
    x: Tensor, kernel: Tensor, heights: Tensor | None, origin: tuple[int, int], outside: float | None
) -> Tensor:
    return _dilation(pixels(x), kernel, heights, *origin, -torch.inf if outside is None else outside, False)


def eroded(x: Tensor, kernel: Tensor, heights: Tensor | None, origin: tuple[int, int], outside: float | None) -> Tensor:
    return _dilation(pixels(x), kernel, heights, *origin, torch.inf if outside is None else outside, True)
