"""Posterization: fewer levels."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.color.program import step
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.enhance.batch import as_batch, images, parameter, shaped

# 2^n + 1 for n binary digits less than float32 has: how to round to the digits of a type (T. J. Dekker's splitting).
SPLIT = {torch.float16: 2.0**13 + 1, torch.bfloat16: 2.0**16 + 1}


def _reference(x: Tensor, bits: float | Tensor, split: float) -> Tensor:
    count = bits.detach().clamp(0, 8) if isinstance(bits, Tensor) else bits
    step = 2.0 ** (8 - count)
    level = x.detach().nan_to_num(0.0).clamp(0, 1) * 255
    high = level * split
    coarse = torch.floor((high - (high - level)).floor() / step) * step / 255
    return torch.where((torch.as_tensor(count, device=x.device) < 8) & ~x.isnan(), coarse, x)


_posterize = step("posterize", _reference)


def posterize(input: Tensor, bits: int | Tensor) -> Tensor:
    """Keep the high bits of the 8-bit levels of an image.

    Args:
        input: (*, C, H, W), floating point, in [0, 1], or uint8. A value x has the level floor(255 x); values outside
            count as 0 or 1.
        bits: how many bits stay, 0 (black) to 8 (the image as it is): an int, or a tensor of whole numbers with the
            first axes of the image, (B,) or (B, C).

    Returns:
        The image with levels that are multiples of 2 ** (8 - bits), divided by 255. Its gradient is 0 below 8 bits.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8; bits is neither int nor tensor.
        ShapeError: input is not (*, C, H, W); bits has axes that the image has not.
        ValueCheckError: an int outside 0 to 8. Tensors are not checked by value; they are clamped.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.posterize(torch.tensor([[0.2, 0.6, 1.0]]), 1) * 255
        tensor([[  0., 128., 128.]])
    """
    images("posterize", "input", input)
    if isinstance(bits, Tensor):
        tensor_bits = parameter("posterize", "bits", bits, input)
        return shaped(_posterize(as_batch(input), tensor_bits, SPLIT.get(input.dtype, 1.0)), input)
    bits = _check.scalar("posterize", "bits", bits)
    if not _check.is_int(bits):
        raise TypeCheckError(f"posterize: expected bits to be an int or a Tensor, got {bits!r}", actual_type=type(bits))
    if not 0 <= bits <= 8:
        raise ValueCheckError(f"posterize: expected bits of 0 to 8, got {bits}", actual_value=bits)
    return shaped(_posterize(as_batch(input), bits, SPLIT.get(input.dtype, 1.0)), input)
