"""Normalization by the range of every plane."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._dtype import floats
from kvision._ops import register, vjp
from kvision.core.exceptions import ShapeError
from kvision.enhance.batch import as_batch, shaped


def _stretch(x: Tensor, low: float, high: float, eps: float, clamps: bool, keeps_flat: bool) -> Tensor:
    """Planes to a range. `clamps`: the results, which leave it by rounding alone. `keeps_flat`: planes of one value."""
    darkest, brightest = x.amin((-2, -1), keepdim=True), x.amax((-2, -1), keepdim=True)
    y = (high - low) * (x - darkest) / (brightest - darkest + eps) + low
    if clamps:
        y = y + (clamp(y, low, high) - y).detach()
    return torch.where(darkest == brightest, x, y) if keeps_flat else y


def _reference(x: Tensor, *settings: Any) -> tuple[Tensor, Tensor]:
    """Normalize every plane of (B, C, H, W); also return the ranges (B, C, 2), which the gradient reads."""
    return _stretch(x, *settings), torch.stack([x.amin((-2, -1)), x.amax((-2, -1))], -1)


def _reference_backward(grad: Tensor, x: Tensor, range: Tensor, *settings: Any) -> Tensor:
    return vjp(_stretch)(grad, x, *settings)


_backward = register("normalize_min_max_backward", _reference_backward, layout_of=1)


_normalize_min_max = register(
    "normalize_min_max",
    _reference,
    fake=lambda x, *_: [x.shape, (*x.shape[:2], 2)],
    gradients="input: normalize_min_max_backward(range=result1)",
    non_differentiable=(1,),
)


def normalize_min_max(input: Tensor, min_val: float = 0.0, max_val: float = 1.0, eps: float = 1e-6) -> Tensor:
    """Map the range of every image plane to [min_val, max_val].

    Args:
        input: (*, H, W); integers are computed in float32.
        min_val: what the smallest value of a plane becomes.
        max_val: what the largest one becomes, up to eps.
        eps: added to the range of the plane, so that a flat one becomes min_val.

    Returns:
        (max_val - min_val) * (input - smallest) / (largest - smallest + eps) + min_val, differentiable; several
        smallest or largest pixels share their gradient.

    Raises:
        TypeCheckError: input is not a real tensor; min_val, max_val or eps not a number.
        ShapeError: input has less than two axes, or planes without pixels.
        ValueCheckError: eps below 0.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.normalize_min_max(torch.tensor([[2.0, 3.0, 4.0]]), 0.0, 10.0)
        tensor([[ 0.0000,  5.0000, 10.0000]])
    """
    _check.numbers("normalize_min_max", "input", input)
    if input.dim() < 2 or 0 in input.shape[-2:]:
        raise ShapeError(
            f"normalize_min_max: expected input of shape (*, H, W) with H, W of at least 1, got {tuple(input.shape)}",
            actual_shape=input.shape,
        )
    low = _check.number("normalize_min_max", "min_val", min_val)
    high = _check.number("normalize_min_max", "max_val", max_val)
    eps = _check.number("normalize_min_max", "eps", eps, minimum=0)
    return shaped(_normalize_min_max(as_batch(floats(input)), low, high, eps, False, False)[0], input)
