"""Elementwise losses of two tensors and their sums, without intermediate tensors.

The sum is the operator of every loss that is one number: the result is `factor` times the sum, or if `decibels` is not
0 its logarithm to base 10 times `decibels`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._choices import Reduction
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import POINT_LOSS
from kvision._ops import register
from kvision._torch_compat import full, hypot


def _charbonnier(x: Tensor, y: Tensor) -> Tensor:
    d = x - y
    return d * (d / (hypot(d, torch.ones_like(d)) + 1))  # sqrt(...) - 1 would cancel for small d


def _welsch(x: Tensor, y: Tensor) -> Tensor:
    return -torch.expm1(-((x - y) ** 2) / 2)


def _cauchy(x: Tensor, y: Tensor) -> Tensor:
    return torch.log1p((x - y) ** 2 / 2)


def _geman_mcclure(x: Tensor, y: Tensor) -> Tensor:
    d = x - y
    return 2 * (d / hypot(d, torch.full_like(d, 2))) ** 2


def _square(x: Tensor, y: Tensor) -> Tensor:
    return (x - y) ** 2


def _kl(q: Tensor, p: Tensor) -> Tensor:
    nothing = (p == 0) & (q >= 0)  # no value and no gradient, but a NaN in q stays NaN
    p, q = p.masked_fill(nothing, 1), q.masked_fill(nothing, 1)
    return p * (p.log() - q.log())


def _js(x: Tensor, y: Tensor) -> Tensor:
    middle = (x + y) / 2
    return (_kl(middle, x) + _kl(middle, y)) / 2


_LOSSES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "charbonnier": _charbonnier,
    "welsch": _welsch,
    "cauchy": _cauchy,
    "geman_mcclure": _geman_mcclure,
    "square": _square,
    "kl": _kl,
    "js": _js,
}

_FUNCTIONS = tuple(_LOSSES[name] for name in POINT_LOSS)


def _map_reference(x: Tensor, y: Tensor, kind: int) -> Tensor:
    return _FUNCTIONS[kind](x, y)


def _map_backward_reference(grad: Tensor, x: Tensor, y: Tensor, kind: int, by_other: bool) -> Tensor:
    vjp_fn = torch.func.vjp(_FUNCTIONS[kind], x.expand_as(grad), y.expand_as(grad))[1]
    return vjp_fn(grad)[by_other]


def _sum_reference(x: Tensor, y: Tensor, kind: int, factor: float, decibels: float) -> Tensor:
    dtype = compute_dtype(x)
    total = factor * _FUNCTIONS[kind](x.to(dtype), y.to(dtype)).sum(1)
    if decibels == 0:
        return total
    nothing = total == 0
    return torch.where(nothing, -math.copysign(math.inf, decibels), decibels * torch.where(nothing, 1, total).log10())


def _sum_backward_reference(
    grad: Tensor, sums: Tensor, x: Tensor, y: Tensor, kind: int, factor: float, decibels: float, by_other: bool
) -> Tensor:
    rows = grad.shape[0]
    x, y = x.expand(rows, -1), y.expand(rows, -1)
    vjp_fn = torch.func.vjp(lambda x, y: _sum_reference(x, y, kind, factor, decibels), x, y)[1]
    return vjp_fn(grad)[by_other]


def _fake_sum(x: Tensor, *_: Any) -> Tensor:
    return x.new_empty(x.shape[:1], dtype=compute_dtype(x))


register("pointwise_loss_backward", _map_backward_reference)
_loss = register(
    "pointwise_loss",
    _map_reference,
    gradients="input: pointwise_loss_backward(by_other=False); other: pointwise_loss_backward(by_other=True)",
)
register(
    "pointwise_sum_backward",
    _sum_backward_reference,
    fake=lambda grad, sums, x, *_: x.new_empty((grad.shape[0], x.shape[1])),
    casts_outputs=True,
)
_sum = register(
    "pointwise_sum",
    _sum_reference,
    fake=_fake_sum,
    gradients="input: pointwise_sum_backward(sums=result, by_other=False); "
    "other: pointwise_sum_backward(sums=result, by_other=True)",
    casts_outputs=True,
)


def _rows(x: Tensor) -> Tensor:
    if x.dim() == 0:
        return x.reshape(1, 1)
    return x.flatten(1) if x.dim() > 1 else x[:, None]


def pointwise(kind: str, x: Tensor, y: Tensor, reduction: Reduction) -> Tensor:
    """The loss `kind` of floating-point tensors of one shape, in the type of x."""
    if reduction != "none":
        count = x.numel()
        return total(kind, x, y, 1.0 if reduction == "sum" else 1 / count if count else math.nan)
    y = as_dtype(y, x.dtype)
    if x.dim() == 4 and x.shape[1] > 1 and x.stride(1) == 1:  # channels-last: in the order of the memory
        return pointwise(kind, x.movedim(1, -1), y.movedim(1, -1), reduction).movedim(-1, 1)
    return _loss(_rows(x), _rows(y), POINT_LOSS[kind]).reshape(x.shape)


def total(kind: str, x: Tensor, y: Tensor, factor: float, decibels: float = 0.0) -> Tensor:
    """`factor` times the sum of the loss `kind`, or decibels of it, of tensors of one shape, in the type of x."""
    dtype = x.dtype
    y = as_dtype(y, dtype)
    traced = is_compiling()  # numbers of operators are constants of a program, and the factor depends on symbolic sizes
    row = (1, x.numel())
    sums = _sum(x.reshape(row), y.reshape(row), POINT_LOSS[kind], 1.0 if traced else factor, decibels)[0]
    if traced:
        sums = (
            sums * factor
            if decibels == 0
            else sums + decibels * full((), factor, dtype=sums.dtype, device=sums.device).log10()
        )
    return as_dtype(sums, dtype)


def sum_of_maps(kind: str, x: Tensor, y: Tensor) -> Tensor:
    """(B, N): the loss `kind` of maps (B, N, H, W), summed over their pixels."""
    rows = x.shape[0] * x.shape[1]
    flat = (z.reshape(rows, x.shape[2] * x.shape[3]) for z in (x, as_dtype(y, x.dtype)))
    return _sum(*flat, POINT_LOSS[kind], 1.0, 0.0).view(x.shape[:2])
