"""Sharpness: interpolation between an image and its smoothed copy, or extrapolation."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._ops import match_layout, register, vjp, with_kernel_casts
from kvision.enhance.batch import as_batch, images, parameter, shaped


def _sharpened(x: Tensor, factor: float | Tensor) -> Tensor:
    if min(x.shape[2:]) < 3:  # only border pixels: the gradient of the factor is 0
        return clamp(x, 0, 1) + 0 * factor
    rows = x[..., :-2, :] + x[..., 1:-1, :] + x[..., 2:, :]
    inner = x[..., 1:-1, 1:-1]
    # | 1 1 1 |
    # | 1 5 1 | / 13
    # | 1 1 1 |
    smooth = clamp((rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:] + 4 * inner) / 13, 0, 1)
    return clamp(x + F.pad((inner - smooth) * (factor - 1), (1, 1, 1, 1)), 0, 1)


def _reference(x: Tensor, factor: Tensor | None, number: float) -> Tensor:
    """Images (B, C, H, W) with a factor (B or 1, C or 1, 1), or a number if it is None."""
    return _sharpened(x, number if factor is None else factor[..., None])


def _reference_backward(
    grad: Tensor, x: Tensor, factor: Tensor | None, number: float, of_image: bool, of_factor: bool
) -> tuple[Tensor, Tensor]:
    none = x[:, :0, 0, 0]
    of_x, of_planes = none, none.to(compute_dtype(x))[..., None]
    if of_image:
        of_x = vjp(_reference)(grad, x, factor, number)
    if of_factor:
        each = factor.expand(*x.shape[:2], 1)  # type: ignore[union-attr]  # a gradient for each channel
        (of_planes,) = torch.func.vjp(lambda f: _reference(x, f, number), each)[1](grad)
    return of_x, of_planes


def _fake_backward(grad, x, factor, number, of_image, of_factor):
    b, c = x.shape[:2]
    of_planes = x.new_empty((b, c if of_factor else 0, 1), dtype=compute_dtype(x))
    return [match_layout(torch.empty_like(x), x) if of_image else x.new_empty((b, 0)), of_planes]


_sharpness = register(
    "sharpness",
    _reference,
    gradients="input, factor: sharpness_backward(of_image=needs(input), of_factor=needs(factor))",
    bytes=True,
    levels=255,
    clamps=True,
)
_sharpness_backward = register("sharpness_backward", _reference_backward, fake=_fake_backward)
_composed = with_kernel_casts(_sharpened, levels=255)  # factors of single pixels


def sharpness(input: Tensor, factor: float | Tensor) -> Tensor:
    """Interpolate between an image and its smoothed copy, or extrapolate; PIL's sharpness.

    The copy is smoothed with a 3x3 kernel of ones and a 5 in the center, over 13. The border, one pixel wide,
    is unchanged.

    Args:
        input: (*, C, H, W), floating point, in [0, 1], or uint8.
        factor: 0 for the smoothed image, 1 for no change, above 1 to sharpen: a number, or a tensor with the first axes
            of the image, (B,) or (B, C).

    Returns:
        smooth + (input - smooth) * factor, clamped to [0, 1], differentiable in image and factor.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8; factor is neither number nor tensor.
        ShapeError: input is not (*, C, H, W); factor has axes that the image has not.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

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
    x = as_batch(input)
    if not isinstance(amount, Tensor):
        y = _sharpness(x, None, amount)
    elif amount.dim() == 3:
        y = _sharpness(x, amount.to(compute_dtype(x)), 0.0)
    else:
        y = _composed(x, amount)
    return shaped(y, input)
