"""Focal losses: cross entropy that looks away from what is already right."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision._ops import as_stored
from kvision.losses.reduction import check_labels, check_weight, masked, reduced, selected


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
    return _focal(pred, weight, target, alpha, gamma, reduction, ignore_index)


@as_stored
def _focal(
    pred: Tensor,
    weight: Tensor | None,
    target: Tensor,
    alpha: float | None,
    gamma: float,
    reduction: str,
    ignore_index: int | None,
) -> Tensor:
    index, counts = selected(target, pred.shape[1], ignore_index, pred.dtype)
    log_p = masked(pred, counts).log_softmax(1).gather(1, index[:, None]).squeeze(1)
    if alpha is not None:
        counts = counts * torch.where(index == 0, 1 - alpha, alpha).to(pred.dtype)
    if weight is not None:
        counts = counts * weight[index]
    loss = -counts * _power(-torch.expm1(log_p), gamma) * log_p
    if reduction == "none":
        return torch.zeros_like(pred).scatter(1, index[:, None], loss[:, None])
    return loss.sum() / pred.numel() if reduction == "mean" else loss.sum()


def _power(x: Tensor, gamma: float) -> Tensor:
    """x ** gamma for x from 0 on, with a finite slope at 0."""
    return x.clamp_min(torch.finfo(x.dtype).tiny) ** gamma


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
    yes = -target * torch.exp(gamma * log_no) * log_yes
    no = -(1 - target) * torch.exp(gamma * log_yes) * log_no
    if alpha is not None:
        yes, no = alpha * yes, (1 - alpha) * no
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
