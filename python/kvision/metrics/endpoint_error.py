"""Endpoint error of optical flow."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import Reduction
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._modules import FunctionModule, Sample
from kvision._ops import not_empty, register
from kvision.core.exceptions import ShapeError


def aepe(input: Tensor, target: Tensor, reduction: Reduction = "mean") -> Tensor:
    """Compute the average end-point error: the distance of flow vectors from the true ones.

    Args:
        input: flow (*, 2); integers are computed in float32.
        target: true flow in the same shape.
        reduction: 'mean', 'sum' or 'none'.

    Returns:
        A number, or for 'none' (*).

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: not (*, 2), or different shapes.
        ValueCheckError: an unknown reduction, which is a NotImplementedError, too.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.aepe(torch.zeros(4, 3, 2), torch.tensor([3.0, 4.0]).expand(4, 3, 2))
        tensor(5.)
    """
    _check.numbers("aepe", "input", input)
    _check.numbers("aepe", "target", target)
    if input.dim() == 0 or input.shape[-1] != 2:
        raise ShapeError(f"aepe: expected input of shape (*, 2), got {tuple(input.shape)}", actual_shape=input.shape)
    _check.same_shape("aepe", input=input, target=target)
    _check.same_device("aepe", input=input, target=target)
    _check.reduction("aepe", reduction)
    x = floats(input)
    y = as_dtype(target, x.dtype)
    count, sizes = x.numel() // 2, x.shape[:-1]
    factor = 1.0 if reduction != "mean" else 1 / count if count else math.nan
    planar = x.dim() > 2 and x.stride(-1) != 1 and x.movedim(-1, 1).is_contiguous()  # a permuted flow (B, 2, H, W)
    if planar:
        x, y = (z.movedim(-1, 1).flatten(2) for z in (x, y))
    else:
        x, y = (z.reshape(1, z.numel() // 2, 2) for z in (x, y))
    if reduction == "none":
        return _errors(x, y, planar, False, 1.0).view(sizes)
    if is_compiling():  # numbers of operators are constants of a program, and the factor depends on symbolic sizes
        return as_dtype(_errors(x, y, planar, True, 1.0).sum() * factor, x.dtype)
    return as_dtype(_errors(x, y, planar, True, factor).sum(), x.dtype)


def _reference(input: Tensor, target: Tensor, planar: bool, summed: bool, factor: float) -> Tensor:
    """(rows, size): the distances of vectors (rows, size, 2), or (rows, 2, size) if planar; or `factor` times their sums."""
    tiny = torch.finfo(compute_dtype(input)).tiny  # sqrt has no derivative at 0; sqrt(tiny) is exact
    difference = input.to(compute_dtype(input)) - target.to(compute_dtype(input))
    error = difference.square().sum(1 if planar else 2).add(tiny).sqrt() - tiny**0.5
    return factor * error.sum(1) if summed else error.to(input.dtype)


def _fake(input: Tensor, target: Tensor, planar: bool, summed: bool, factor: float) -> Tensor:
    if summed:
        return input.new_empty(input.shape[0], dtype=compute_dtype(input))
    return input.new_empty(input.shape[0], input.shape[2 if planar else 1])


def _backward(needs, grad, input, target, *plain):
    grad_input = _gradient(grad, input, target, *plain) if needs[0] or needs[1] else None
    return [grad_input if needs[0] else None, _of_rows(-grad_input, target) if needs[1] else None]


def _of_rows(grad: Tensor, like: Tensor) -> Tensor:
    """The gradient of a tensor whose single row may be broadcast."""
    return grad if grad.shape == like.shape else grad.sum(0, keepdim=True)


def _backward_reference(grad: Tensor, input: Tensor, target: Tensor, *plain: Any) -> Tensor:
    x, y = (z.expand(grad.shape[0], -1, -1) for z in (input, target))
    return torch.func.vjp(lambda x: _reference(x, y, *plain), x)[1](grad)[0]


_gradient = register(
    "endpoint_error_backward",
    _backward_reference,
    fake=lambda grad, input, *_: input.new_empty(grad.shape[0], *input.shape[1:]),
    casts_outputs=True,
)
_errors = register("endpoint_error", _reference, fake=_fake, backward=_backward, casts_outputs=True, supports=not_empty)


average_endpoint_error = aepe


class AEPE(FunctionModule):
    """Module form of :func:`aepe`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.AEPE("sum")(torch.zeros(4, 2), torch.ones(4, 2))
        tensor(5.6569)
    """

    samples = (Sample(256, 256, 2),) * 2

    def __init__(self, reduction: Reduction = "mean") -> None:
        super().__init__(reduction=reduction)

    def forward(self, input: Tensor, target: Tensor) -> Tensor:
        return aepe(input, target, self.reduction)
