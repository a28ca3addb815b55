"""Inversion of values."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import SIGNED, as_dtype
from kvision._modules import FunctionModule


def invert(image: Tensor, max_val: float | Tensor | None = None) -> Tensor:
    """Subtract an image from its largest possible value.

    Args:
        image: a tensor of any shape and real type.
        max_val: the value that becomes 0, by default 1: a number, or a tensor that broadcasts to the image. Give 255
            for uint8 images.

    Returns:
        max_val - image, in the type of the image.

    Raises:
        TypeCheckError: image is not a real tensor; max_val is neither number nor tensor.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.invert(torch.tensor([0, 100], dtype=torch.uint8), 255)
        tensor([255, 155], dtype=torch.uint8)
    """
    _check.numbers("invert", "image", image)
    if isinstance(max_val, Tensor):
        _check.numbers("invert", "max_val", max_val)
        _check.subtractable("invert", max_val=max_val)
        _check.broadcastable("invert", image=image.shape, max_val=max_val.shape)
        max_val = _check.to_device_of("invert", image, "max_val", max_val, of="image")
    else:
        max_val = 1.0 if max_val is None else _check.number("invert", "max_val", max_val)
    if image.is_floating_point():
        return as_dtype(max_val - image, image.dtype)
    largest = torch.as_tensor(max_val, device=image.device).to(image.dtype)
    if image.dtype is torch.bool:
        return largest ^ image
    if image.dtype in SIGNED:
        signed = SIGNED[image.dtype]
        return (largest.view(signed) - image.view(signed)).view(image.dtype)
    return largest - image


class Invert(FunctionModule):
    """Module form of :func:`invert`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.Invert()(torch.tensor([0.25, 1.0]))
        tensor([0.7500, 0.0000])
    """

    def __init__(self, max_val: float | Tensor | None = None) -> None:
        super().__init__(max_val=max_val)

    def forward(self, input: Tensor) -> Tensor:
        return invert(input, self.max_val)
