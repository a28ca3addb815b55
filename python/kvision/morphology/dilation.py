"""Dilation and erosion, from which all of morphology is made.

Both are one operator. With a window of offsets, minus infinity where the structuring element has no member,

    y(q) = max over i, j of x(q + (i - top, j - left)) + offsets(i, j)

is a dilation with the element turned round, and min(x - offsets) an erosion. Pixels that share a maximum share its gradient
evenly.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._ops import register, vjp
from kvision.core.exceptions import TypeCheckError, ValueCheckError


def _reference(x: Tensor, offsets: Tensor, top: int, left: int, value: float, erode: bool) -> Tensor:
    """`offsets` is (B or 1, height, width), `value` what lies outside of the images."""
    h, w = x.shape[-2:]
    ky, kx = offsets.shape[1:]
    worst = torch.inf if erode else -torch.inf
    padded = F.pad(x, (left, kx - 1 - left, top, ky - 1 - top), value=value)
    taps = []
    for i in range(ky):
        for j in range(kx):
            pixels, offset = padded[..., i : i + h, j : j + w], offsets[:, i, j, None, None, None]
            tap = pixels - offset if erode else pixels + offset
            taps.append(torch.where(offset == -torch.inf, worst, tap))  # never chosen, an infinite pixel included
    return torch.stack(taps).amin(0) if erode else torch.stack(taps).amax(0)


def _backward(needs, grad, x, offsets, *plain):
    grad_offsets = None
    if needs[1]:
        only_offsets = (False, True, *(False for _ in plain))
        grad_offsets = _dilation.differentiate_reference(only_offsets, grad, x, offsets, *plain)[1]
    return [_dilation_backward(grad, x, offsets, *plain) if needs[0] else None, grad_offsets]


_dilation_backward = register("dilation_backward", vjp(_reference), fake=lambda grad, x, *_: x.shape)
_dilation = register("dilation", _reference, backward=_backward)


def dilation(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: str = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: str = "auto",
) -> Tensor:
    """Take the largest pixel under a structuring element turned round, as SciPy and OpenCV do.

    Args:
        tensor: images (B, C, H, W), floating point.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: heights (kH, kW) that are added to the pixels; it may carry a gradient. None for a flat element.
        origin: (y, x) of the element's centre; None for (kH // 2, kW // 2).
        border_type: 'geodesic' leaves out what lies beyond the image, 'constant' has border_value there.
        border_value: see border_type.
        max_val: for compatibility, without effect.
        engine: for compatibility, one of 'auto', 'unfold', 'convolution', 'shift'; the result is the same.

    Returns:
        (B, C, H, W); minus infinity where no pixel is under the element. Pixels that share the maximum share its
        gradient evenly. NaN spreads to every window it is in.

    Raises:
        TypeCheckError: tensor is no floating-point tensor, kernel or structuring_element none at all.
        ShapeError: tensor is not (B, C, H, W); kernel has no two axes, structuring_element others.
        ValueCheckError: an origin outside of the kernel; an unknown border_type or engine, which is a
            NotImplementedError, too.
        DeviceError: tensors on different devices.

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
    border_type: str = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: str = "auto",
) -> Tensor:
    """Take the smallest pixel under a structuring element.

    Args:
        tensor: images (B, C, H, W), floating point.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: heights (kH, kW) that are subtracted from the pixels; it may carry a gradient.
        origin: (y, x) of the element's centre; None for (kH // 2, kW // 2).
        border_type: 'geodesic' leaves out what lies beyond the image, 'constant' has border_value there.
        border_value: see border_type.
        max_val: for compatibility, without effect.
        engine: for compatibility, one of 'auto', 'unfold', 'convolution', 'shift'; the result is the same.

    Returns:
        (B, C, H, W); infinity where no pixel is under the element.

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


# The element of a call: its offsets (kH, kW), its origin, and the number beyond the image or None.
Element = tuple[Tensor, tuple[int, int], float | None]


def checked(
    op: str,
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None,
    origin: Sequence[int] | None,
    border_type: str,
    border_value: float,
    max_val: float,
    engine: str,
) -> Element:
    _check.images(op, "tensor", tensor)
    _check.floating(op, "tensor", tensor)
    _check.shape(op, "kernel", kernel, "kH", "kW")
    ky, kx = kernel.shape
    if kernel.numel() == 0:
        raise ValueCheckError(f"{op}: expected a kernel of at least one pixel, got {tuple(kernel.shape)}")
    _check.same_device(op, tensor=tensor, kernel=kernel)
    if structuring_element is not None:
        _check.shape(op, "structuring_element", structuring_element, ky, kx)
        _check.same_device(op, tensor=tensor, structuring_element=structuring_element)
    if origin is None:
        origin = (ky // 2, kx // 2)
    elif not isinstance(origin, (tuple, list)) or [*map(type, origin)] != [int, int]:
        raise TypeCheckError(f"{op}: expected origin to be two ints, got {origin!r}", actual_type=type(origin))
    y, x = origin
    if not (0 <= y < ky and 0 <= x < kx):
        raise ValueCheckError(f"{op}: expected an origin in the kernel {(ky, kx)}, got {origin!r}", actual_value=origin)
    _check.known(op, "border_type", border_type, ("geodesic", "constant"))
    _check.known(op, "engine", engine, ("auto", "unfold", "convolution", "shift"))
    border_value = _check.number(op, "border_value", border_value)
    _check.number(op, "max_val", max_val)
    dtype = torch.float64 if tensor.dtype == torch.float64 else torch.float32
    heights = torch.zeros((), dtype=dtype, device=tensor.device)
    if structuring_element is not None:
        heights = structuring_element.to(dtype)
    return torch.where(kernel != 0, heights, -torch.inf), (y, x), border_value if border_type == "constant" else None


def dilated(x: Tensor, offsets: Tensor, origin: tuple[int, int], outside: float | None) -> Tensor:
    ky, kx = offsets.shape
    value = -torch.inf if outside is None else outside
    return _dilation(x, offsets.flip(0, 1)[None], ky - 1 - origin[0], kx - 1 - origin[1], value, False)


def eroded(x: Tensor, offsets: Tensor, origin: tuple[int, int], outside: float | None) -> Tensor:
    return _dilation(x, offsets[None], *origin, torch.inf if outside is None else outside, True)
