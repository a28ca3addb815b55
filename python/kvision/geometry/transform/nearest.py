"""Integers that nearest modes move: labels, indices, masks.

The operators compute in floating point, but for uint8, whose pixels a nearest mode copies. Other integers are moved as the
bytes that they are made of, so that labels of any size are exact.
"""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._dtype import pixels
from kvision._torch_compat import in_function_transform, in_onnx_export


def moves_values(image: Tensor, interpolation: str) -> bool:
    """Whether pixels are integers that go to the result as they are; operators themselves do so for uint8."""
    is_nearest = interpolation in ("nearest", "nearest-exact")
    return is_nearest and not image.is_floating_point() and image.dtype != torch.uint8


def as_values(image: Tensor, interpolation: str) -> Tensor:
    """Images (B, C, *S) as operators take them: bytes (B, C * bytes, *S) of integers that a nearest mode moves, else pixels."""
    if image.is_floating_point() or not moves_values(image, interpolation):
        return pixels(image)
    if in_onnx_export():
        return image.double()  # ONNX cannot view numbers as bytes; labels below 2^53 are exact
    size = image.element_size()
    if in_function_transform():  # torch 2.11 cannot map the view of numbers as bytes
        number = image.long()
        return torch.stack([number >> 8 * i & 255 for i in range(size)], 2).flatten(1, 2).to(torch.uint8)
    planes = image.contiguous().view(torch.uint8)
    if size == 1:
        return planes
    return planes.unflatten(-1, (image.shape[-1], size)).movedim(-1, 2).flatten(1, 2)


def of_values(result: Tensor, image: Tensor, interpolation: str) -> Tensor:
    """The result of an operator on :func:`as_values` of `image`, in the type of `image` where a nearest mode moved it."""
    if image.is_floating_point() or not moves_values(image, interpolation):
        return result
    if in_onnx_export():
        return result.to(image.dtype)
    size = image.element_size()
    planes = result.to(torch.uint8)  # volumes are moved in float32
    if in_function_transform():
        parts = planes.long().unflatten(1, (image.shape[1], size)).unbind(2)
        return sum((part << 8 * i for i, part in enumerate(parts[1:], 1)), parts[0]).to(image.dtype)
    if size == 1:
        return planes.view(image.dtype)
    values = planes.unflatten(1, (image.shape[1], size)).movedim(2, -1).contiguous()
    return values.flatten(-2).view(image.dtype)


def fill_of_values(fill: Tensor, image: Tensor) -> Tensor:
    """The fill (B or 1, channels) of :func:`as_values` of `image`, of one (B or 1, C or 1): rounded and saturated."""
    if image.dtype == torch.bool:
        fill = fill != 0
    elif fill.is_floating_point():
        limits = torch.iinfo(image.dtype)
        fill = fill.round().clamp(limits.min, limits.max)
    values = as_values(fill.to(image.dtype).expand(-1, image.shape[1])[..., None], "nearest")
    return values[..., 0].to(torch.float64 if in_onnx_export() else torch.float32)
