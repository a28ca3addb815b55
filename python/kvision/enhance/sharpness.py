"""Sharpness: an image and its smoothed copy, mixed."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from kvision._ops import as_stored
from kvision.enhance.batch import as_batch, images, parameter, shaped


def _reference(x: Tensor, factor: float | Tensor) -> Tensor:
    if min(x.shape[2:]) < 3:  # nothing but rim
        return x.clamp(0, 1)
    rows = x[..., :-2, :] + x[..., 1:-1, :] + x[..., 2:, :]
    inner = x[..., 1:-1, 1:-1]
    # | 1 1 1 |
    # | 1 5 1 | / 13
    # | 1 1 1 |
    smooth = ((rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:] + 4 * inner) / 13).clamp(0, 1)
    return (x + F.pad((inner - smooth) * (factor - 1), (1, 1, 1, 1))).clamp(0, 1)


_sharpness = as_stored(_reference)


def sharpness(input: Tensor, factor: float | Tensor) -> Tensor:
    """Mix an image with its smoothed copy, or move away from it; PIL's sharpness.

    The copy is smoothed with a 3x3 kernel of ones and a 5 in the centre, over 13. The rim, one pixel wide, stays.

    Args:
        input: (*, C, H, W), floating point, in [0, 1].
        factor: 0 for the smoothed image, 1 for no change, above 1 to sharpen: a number, or a tensor with the first axes
            of the image, (B,) or (B, C).

    Returns:
        smooth + (input - smooth) * factor, clamped to [0, 1], differentiable in image and factor.

    Raises:
        TypeCheckError: input is no floating-point tensor; factor is neither number nor tensor.
        ShapeError: input is not (*, C, H, W); factor has axes that the image has not.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.zeros(3, 3)
        >>> x[1, 1] = 0.52
        >>> K.enhance.sharpness(x, 0.0)
        tensor([[0.0000, 0.0000, 0.0000],
                [0.0000, 0.2000, 0.0000],
                [0.0000, 0.0000, 0.0000]])
    """
    images("sharpness", "input", input)
    amount = parameter("sharpness", "factor", factor, input)
    if isinstance(amount, Tensor) and amount.dim() == 3:
        amount = amount[..., None]
    return shaped(_sharpness(as_batch(input), amount), input)
