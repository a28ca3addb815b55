"""Focal losses: cross entropy that looks away from what is already right."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._modules import FunctionModule
from kvision._ops import as_stored, laid_out, register, vjp
from kvision.losses.reduction import (
    as_arguments,
    check_labels,
    check_weight,
    has_kernel,
    masked,
    reduced,
    selected,
)


def _reference(
    pred: Tensor,
    target: Tensor,
    weight: Tensor | None,
    first: float,
    other: float,
    gamma: float,
    ignored: int,
    ignores: bool,
    summed: bool,
) -> Tensor:
    """(losses, B, H, W) losses of logits (losses, B, C, H, W), or their sums (losses,).

    `first` weighs class 0, `other` the others, `weight` (losses or 1, C) all.
    """
    losses, classes, wide = pred.shape[0], pred.shape[2], pred.to(compute_dtype(pred))
    target = target.expand(losses, *target.shape[1:])
    index, counts = selected(target.flatten(0, 1), classes, ignored if ignores else None, wide.dtype)
    log_p = masked(wide.flatten(0, 1), counts).log_softmax(1).gather(1, index[:, None]).squeeze(1)
    factor = counts * torch.full_like(counts, other).masked_fill(index == 0, first)
    loss = (-factor * _power(-torch.expm1(log_p), gamma) * log_p).view(target.shape)
    if weight is not None:
        # An index and not gather(), whose gradient is summed in any order on CUDA.
        of_loss = classes * torch.arange(losses, device=pred.device).view(-1, 1, 1, 1)
        loss = loss * weight.expand(losses, -1).flatten()[index.view(target.shape) + of_loss]
    return loss.sum((1, 2, 3)) if summed else loss


def _power(x: Tensor, gamma: float) -> Tensor:
    """x ** gamma for x from 0 on, with a finite slope at 0."""
    return x.clamp_min(torch.finfo(x.dtype).tiny) ** gamma


def _fake(pred: Tensor, *args: Any) -> Tensor:
    losses, batch, _, h, w = pred.shape
    return pred.new_empty((losses,) if args[-1] else (losses, batch, h, w), dtype=compute_dtype(pred))


def _backward(needs, grad, pred, target, weight, *plain):
    grad_weight = None
    if needs[2]:
        only_weight = (False, False, True, *(False for _ in plain))
        grad_weight = _focal.differentiate_reference(only_weight, grad, pred, target, weight, *plain)[2]
    return [_focal_backward(grad, pred, target, weight, *plain) if needs[0] else None, None, grad_weight]


_focal_backward = register(
    "focal_backward",
    vjp(_reference),
    fake=lambda grad, pred, *_: torch.empty_like(pred, memory_format=torch.contiguous_format),
    stores=True,
)
_focal = register("focal", _reference, fake=_fake, backward=_backward, stores=True)


def focal_loss(
    pred: Tensor,
    target: Tensor,
    alpha: float | None = 0.5,
    gamma: float = 2.0,
    reduction: str = "none",
    weight: Tensor | None = None,
    ignore_index: int | None = -100,
) -> Tensor:
    """Compute the softmax focal loss -a (1 - p)^gamma log p, where p is the probability of a pixel's own class.

    Args:
        pred: logits (B, C, *).
        target: labels (B, *) in [0, C), int64. Another label makes the loss NaN, as labels are not read on the host.
        alpha: a of the classes from 1 on, 1 - alpha that of class 0; None for 1 everywhere.
        gamma: how much less a pixel weighs that is right already, at least 0; 0 gives cross entropy.
        reduction: 'none', 'mean' (over all B * C * pixels) or 'sum'.
        weight: factors of the classes (C,).
        ignore_index: label of the pixels that add nothing; None for no such label.

    Returns:
        A number, or for 'none' (B, C, *) with the loss in the slice of a pixel's class and 0 in the others.

    Raises:
        TypeCheckError: pred is no floating-point tensor or target not int64.
        ShapeError: target or weight do not fit pred.
        ValueCheckError: a negative gamma; an unknown reduction, which is a NotImplementedError, too.
        DeviceError: tensors on different devices.

    Source: T.-Y. Lin et al., "Focal loss for dense object detection" (2017).

    Example:
        >>> import torch, kvision as K
        >>> logits = torch.tensor([[0.0, 0.0], [2.0, 0.0]])
        >>> K.losses.focal_loss(logits, torch.tensor([1, 0]), alpha=None, reduction="sum")
        tensor(0.1751)
    """
    check_labels("focal_loss", pred, target, images=False)
    alpha, gamma = _focus("focal_loss", alpha, gamma)
    _check.reduction("focal_loss", reduction)
    check_weight("focal_loss", "weight", weight, pred)
    factor, summed = 1.0, reduction != "none"
    if reduction == "mean":
        count = pred.numel()
        factor = 1 / count if count else float("nan")
    first, other = (factor, factor) if alpha is None else ((1 - alpha) * factor, alpha * factor)
    weight = None if weight is None else weight[None].to(compute_dtype(pred))
    operator = _focal if has_kernel(pred) else _focal.reference
    terms = (first, other, gamma, *as_arguments(ignore_index), summed)
    loss = operator(_as_images(pred, 2)[None], _as_images(target, 1)[None], weight, *terms)
    if summed:
        return as_dtype(loss.squeeze(), pred.dtype)
    index = target.clamp(0, pred.shape[1] - 1)[:, None]
    return laid_out(torch.zeros_like(pred).scatter(1, index, loss.reshape(index.shape).to(pred.dtype)), pred)


def _as_images(x: Tensor, first: int) -> Tensor:
    """The axes from `first` on as two."""
    if x.dim() == first + 2:
        return x
    x = x.flatten(first) if x.dim() > first else x.unsqueeze(first)
    return x.unsqueeze(first)


def binary_focal_loss_with_logits(
    pred: Tensor,
    target: Tensor,
    alpha: float | None = 0.25,
    gamma: float = 2.0,
    reduction: str = "none",
    pos_weight: Tensor | None = None,
    weight: Tensor | None = None,
    ignore_index: int | None = -100,
) -> Tensor:
    """Compute the focal loss of C independent yes-or-no questions.

    With p = sigmoid(pred) and the target t it is -alpha (1 - p)^gamma t log p - (1 - alpha) p^gamma (1 - t) log(1 - p).

    Args:
        pred: logits (B, C, *).
        target: 0 or 1, or a probability, in the shape of pred.
        alpha: factor of the positive term, 1 - alpha that of the negative one; None for 1 in both.
        gamma: how much less a pixel weighs that is right already, at least 0.
        reduction: 'none', 'mean' or 'sum'.
        pos_weight: more factors of the positive terms (C,).
        weight: factors of the classes (C,).
        ignore_index: target of what adds nothing; None for none.

    Returns:
        A number, or for 'none' a map in the shape of pred.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`focal_loss`.

    Example:
        >>> import torch, kvision as K
        >>> logits = torch.tensor([[0.0, 4.0]])
        >>> K.losses.binary_focal_loss_with_logits(logits, torch.tensor([[1.0, 1.0]]), alpha=None)
        tensor([[1.7329e-01, 5.8716e-06]])
    """
    op = "binary_focal_loss_with_logits"
    _check.numbers(op, "pred", pred)
    _check.floating(op, "pred", pred)
    _check.numbers(op, "target", target)
    if pred.dim() < 2:
        _check.shape(op, "pred", pred, "B", "C")
    _check.same_shape(op, pred=pred, target=target)
    _check.same_device(op, pred=pred, target=target)
    alpha, gamma = _focus(op, alpha, gamma)
    _check.reduction(op, reduction)
    check_weight(op, "pos_weight", pos_weight, pred)
    check_weight(op, "weight", weight, pred)
    return _binary_focal(pred, target.to(pred.dtype), pos_weight, weight, alpha, gamma, reduction, ignore_index)


@as_stored
def _binary_focal(
    pred: Tensor,
    target: Tensor,
    pos_weight: Tensor | None,
    weight: Tensor | None,
    alpha: float | None,
    gamma: float,
    reduction: str,
    ignore_index: int | None,
) -> Tensor:
    if ignore_index is not None:
        ignored = target == ignore_index
        pred = pred.masked_fill(ignored, 0)
    log_yes, log_no = F.logsigmoid(pred), F.logsigmoid(-pred)
    of_yes, of_no = (1.0, 1.0) if alpha is None else (alpha, 1 - alpha)
    yes = -of_yes * target * torch.exp(gamma * log_no) * log_yes
    no = of_no * (target - 1) * torch.exp(gamma * log_yes) * log_no
    per_class = (-1, *(1,) * (pred.dim() - 2))
    if pos_weight is not None:
        yes = yes * pos_weight.view(per_class)
    loss = yes + no
    if weight is not None:
        loss = loss * weight.view(per_class)
    if ignore_index is not None:
        loss = loss.masked_fill(ignored, 0)
    return reduced(loss, reduction)


def _focus(op: str, alpha: float | None, gamma: float) -> tuple[float | None, float]:
    return None if alpha is None else _check.number(op, "alpha", alpha), _check.number(op, "gamma", gamma, minimum=0)


class FocalLoss(FunctionModule):
    """Module form of :func:`focal_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.FocalLoss(0.5, reduction="mean")(torch.zeros(1, 4, 2, 2), torch.zeros(1, 2, 2, dtype=torch.int64))
        tensor(0.0975)
    """

    def __init__(
        self,
        alpha: float | None,
        gamma: float = 2.0,
        reduction: str = "none",
        weight: Tensor | None = None,
        ignore_index: int | None = -100,
    ) -> None:
        super().__init__(alpha=alpha, gamma=gamma, reduction=reduction, weight=weight, ignore_index=ignore_index)

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return focal_loss(pred, target, self.alpha, self.gamma, self.reduction, self.weight, self.ignore_index)


class BinaryFocalLossWithLogits(FunctionModule):
    """Module form of :func:`binary_focal_loss_with_logits`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.BinaryFocalLossWithLogits(0.5, reduction="mean")(torch.zeros(1, 1, 2, 2), torch.ones(1, 1, 2, 2))
        tensor(0.0866)
    """

    def __init__(
        self,
        alpha: float | None,
        gamma: float = 2.0,
        reduction: str = "none",
        pos_weight: Tensor | None = None,
        weight: Tensor | None = None,
        ignore_index: int | None = -100,
    ) -> None:
        super().__init__(
            alpha=alpha,
            gamma=gamma,
            reduction=reduction,
            pos_weight=pos_weight,
            weight=weight,
            ignore_index=ignore_index,
        )

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return binary_focal_loss_with_logits(
            pred, target, self.alpha, self.gamma, self.reduction, self.pos_weight, self.weight, self.ignore_index
        )
