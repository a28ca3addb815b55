"""Opening, closing and the other compositions of dilations and erosions."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision._dtype import pixels
from kvision.morphology.dilation import Border, Engine, checked, dilated, eroded


def _difference(x: Tensor, y: Tensor, *, reuses_x: bool = True) -> Tensor:
    """`x - y`. Bytes saturate, they do not wrap, and are subtracted in the memory of `x` if `reuses_x`."""
    if x.dtype != torch.uint8:
        return x - y
    most = x.clamp_min_(y) if reuses_x else torch.maximum(x, y)
    return most.sub_(y)


def opening(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: Border = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: Engine = "auto",
) -> Tensor:
    """Erode, then dilate: remove bright details that are smaller than the structuring element.

    Args:
        tensor: images (B, C, H, W). uint8 gives uint8 (saturated), other integers give float32.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: its heights (kH, kW), None for a flat element.
        origin: (y, x) of its center; None for (kH // 2, kW // 2).
        border_type: 'geodesic' or 'constant'.
        border_value: value outside of the image for 'constant'.
        max_val: for compatibility, without effect.
        engine: for compatibility; the result is the same.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`dilation`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 5., 0., 5., 5., 5., 0.]]]])
        >>> K.morphology.opening(x, torch.ones(1, 3))
        tensor([[[[0., 0., 0., 5., 5., 5., 0.]]]])
    """
    element = checked(
        "opening", tensor, kernel, structuring_element, origin, border_type, border_value, max_val, engine
    )
    return dilated(eroded(tensor, *element), *element)


def closing(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: Border = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: Engine = "auto",
) -> Tensor:
    """Dilate, then erode: fill dark details that are smaller than the structuring element.

    Args:
        tensor: images (B, C, H, W). uint8 gives uint8 (saturated), other integers give float32.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: its heights (kH, kW), None for a flat element.
        origin: (y, x) of its center; None for (kH // 2, kW // 2).
        border_type: 'geodesic' or 'constant'.
        border_value: value outside of the image for 'constant'.
        max_val: for compatibility, without effect.
        engine: for compatibility; the result is the same.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`dilation`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[5., 5., 0., 5., 5.]]]])
        >>> K.morphology.closing(x, torch.ones(1, 3))
        tensor([[[[5., 5., 5., 5., 5.]]]])
    """
    element = checked(
        "closing", tensor, kernel, structuring_element, origin, border_type, border_value, max_val, engine
    )
    return eroded(dilated(tensor, *element), *element)


def gradient(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: Border = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: Engine = "auto",
) -> Tensor:
    """Subtract the erosion from the dilation: the height of edges.

    Args:
        tensor: images (B, C, H, W). uint8 gives uint8 (saturated), other integers give float32.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: its heights (kH, kW), None for a flat element.
        origin: (y, x) of its center; None for (kH // 2, kW // 2).
        border_type: 'geodesic' or 'constant'.
        border_value: value outside of the image for 'constant'.
        max_val: for compatibility, without effect.
        engine: for compatibility; the result is the same.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`dilation`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 5., 5., 5.]]]])
        >>> K.morphology.gradient(x, torch.ones(1, 3))
        tensor([[[[0., 5., 5., 0., 0.]]]])
    """
    element = checked(
        "gradient", tensor, kernel, structuring_element, origin, border_type, border_value, max_val, engine
    )
    return _difference(dilated(tensor, *element), eroded(tensor, *element))


def top_hat(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: Border = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: Engine = "auto",
) -> Tensor:
    """Subtract the opening from the image: the bright details that are smaller than the structuring element.

    Args:
        tensor: images (B, C, H, W). uint8 gives uint8 (saturated), other integers give float32.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: its heights (kH, kW), None for a flat element.
        origin: (y, x) of its center; None for (kH // 2, kW // 2).
        border_type: 'geodesic' or 'constant'.
        border_value: value outside of the image for 'constant'.
        max_val: for compatibility, without effect.
        engine: for compatibility; the result is the same.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`dilation`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 5., 0., 5., 5., 5., 0.]]]])
        >>> K.morphology.top_hat(x, torch.ones(1, 3))
        tensor([[[[0., 5., 0., 0., 0., 0., 0.]]]])
    """
    element = checked(
        "top_hat", tensor, kernel, structuring_element, origin, border_type, border_value, max_val, engine
    )
    return _difference(pixels(tensor), dilated(eroded(tensor, *element), *element), reuses_x=False)


def bottom_hat(
    tensor: Tensor,
    kernel: Tensor,
    structuring_element: Tensor | None = None,
    origin: Sequence[int] | None = None,
    border_type: Border = "geodesic",
    border_value: float = 0.0,
    max_val: float = 1e4,
    engine: Engine = "auto",
) -> Tensor:
    """Subtract the image from the closing: the dark details that are smaller than the structuring element.

    Args:
        tensor: images (B, C, H, W). uint8 gives uint8 (saturated), other integers give float32.
        kernel: the element's members are where this (kH, kW) is not 0.
        structuring_element: its heights (kH, kW), None for a flat element.
        origin: (y, x) of its center; None for (kH // 2, kW // 2).
        border_type: 'geodesic' or 'constant'.
        border_value: value outside of the image for 'constant'.
        max_val: for compatibility, without effect.
        engine: for compatibility; the result is the same.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`dilation`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[5., 5., 0., 5., 5.]]]])
        >>> K.morphology.bottom_hat(x, torch.ones(1, 3))
        tensor([[[[0., 0., 5., 0., 0.]]]])
    """
    element = checked(
        "bottom_hat", tensor, kernel, structuring_element, origin, border_type, border_value, max_val, engine
    )
    return _difference(eroded(dilated(tensor, *element), *element), pixels(tensor))
