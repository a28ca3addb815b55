"""Focal losses: cross entropy that reduces the weight of pixels that are already classified well."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision._dtype import as_dtype, compute_dtype
from kvision._modules import IMAGE, LABELS, FunctionModule
from kvision._ops import match_layout, register, vjp
from kvision.core.exceptions import ShapeError
from kvision.losses.reduction import (
    as_arguments,
    check_labels,
    checked_weight,
    masked,
    segmentation_supports,
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
    losses, classes, promoted = pred.shape[0], pred.shape[2], pred.to(compute_dtype(pred))
    target = target.expand(losses, *target.shape[1:])
    index, counts = selected(target.flatten(0, 1), classes, ignored if ignores else None, promoted.dtype)
    log_p = masked(promoted.flatten(0, 1), counts).log_softmax(1).gather(1, index[:, None]).squeeze(1)
    factor = counts * torch.full_like(counts, other).masked_fill(index == 0, first)
    loss = (-factor * _power(-torch.expm1(log_p), gamma) * log_p).view(target.shape)
    if weight is not None:
        # Indexing instead of gather(), whose gradient is nondeterministic on CUDA.
        of_loss = classes * torch.arange(losses, device=pred.device).view(-1, 1, 1, 1)
        loss = loss * weight.expand(losses, -1).flatten()[index.view(target.shape) + of_loss]
    return loss.sum((1, 2, 3)) if summed else loss


def _power(x: Tensor, gamma: float) -> Tensor:
    """x ** gamma for x >= 0, with a finite derivative at 0."""
    return x.clamp_min(torch.finfo(x.dtype).tiny) ** gamma


def _fake(pred: Tensor, *args: Any) -> Tensor:
    losses, batch, _, h, w = pred.shape
    return pred.new_empty((losses,) if args[-1] else (losses, batch, h, w), dtype=compute_dtype(pred))


register(
    "focal_backward",
    vjp(_reference),
    fake=lambda grad, pred, *_: torch.empty_like(pred, memory_format=torch.contiguous_format),
    casts_outputs=True,
)
_focal = register(
    "focal",
    _reference,
    fake=_fake,
    gradients="pred: focal_backward; weight: reference",
    casts_outputs=True,
    supports=segmentation_supports,
)


def focal_loss(
    pred: Tensor,
    target: Tensor,
    alpha: float | None = 0.5,
    gamma: float = 2.0,
    reduction: Reduction = "none",
    weight: Tensor | None = None,
    ignore_index: int | None = -100,
) -> Tensor:
    """Compute the softmax focal loss -a (1 - p)^gamma log p, where p is the probability of a pixel's label.

    Args:
        pred: logits (B, C, *).
        target: labels (B, *) in [0, C), int64. Another label makes the loss NaN, as labels are not read on the host.
        alpha: a of the classes from 1 on, 1 - alpha that of class 0; None for 1 everywhere.
        gamma: how strongly the weight of well-classified pixels is reduced, at least 0; 0 gives cross entropy.
        reduction: 'none', 'mean' (over all B * C * pixels) or 'sum'.
        weight: factors of the classes (C,).
        ignore_index: label of the pixels that add nothing; None for no such label.

    Returns:
        A number, or for 'none' (B, C, *) with the loss in the slice of a pixel's class and 0 in the others.

    Raises:
        TypeCheckError: pred is not a floating-point tensor or target not int64.
        ShapeError: target or weight do not fit pred.
        ValueCheckError: a negative gamma; an unknown reduction, which is a NotImplementedError, too.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

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
    weight = checked_weight("focal_loss", "weight", weight, pred)
    factor, summed = 1.0, reduction != "none"
    if reduction == "mean":
        count = pred.numel()
        factor = 1 / count if count else float("nan")
    first, other = (factor, factor) if alpha is None else ((1 - alpha) * factor, alpha * factor)
    weight = None if weight is None else weight[None].to(compute_dtype(pred))
    terms = (first, other, gamma, *as_arguments("focal_loss", ignore_index), summed)
    loss = _focal(_as_images(pred, 2)[None], _as_images(target, 1)[None], weight, *terms)
    if summed:
        return as_dtype(loss.squeeze(), pred.dtype)
    index = target.clamp(0, pred.shape[1] - 1)[:, None]
    return match_layout(torch.zeros_like(pred).scatter(1, index, loss.reshape(index.shape).to(pred.dtype)), pred)


def _as_images(x: Tensor, first: int) -> Tensor:
    """Flatten to two axes, from `first` on."""
    if x.dim() == first + 2:
        return x
    x = x.flatten(first) if x.dim() > first else x.unsqueeze(first)
    return x.unsqueeze(first)


def binary_focal_loss_with_logits(
    pred: Tensor,
    target: Tensor,
    alpha: float | None = 0.25,
    gamma: float = 2.0,
    reduction: Reduction = "none",
    pos_weight: Tensor | None = None,
    weight: Tensor | None = None,
    ignore_index: int | None = -100,
) -> Tensor:
    """Compute the binary focal loss of C independent labels, from logits.

    With p = sigmoid(pred) and the target t it is -alpha (1 - p)^gamma t log p - (1 - alpha) p^gamma (1 - t) log(1 - p).

    Args:
        pred: logits (B, C, *).
        target: 0 or 1, or a probability, in the shape of pred.
        alpha: factor of the positive term, 1 - alpha that of the negative one; None for 1 in both.
        gamma: how strongly the weight of well-classified pixels is reduced, at least 0.
        reduction: 'none', 'mean' or 'sum'.
        pos_weight: more factors of the positive terms: (C,), or of any shape that broadcasts to pred.
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
    pos_weight = _pos_weight(op, pos_weight, pred)
    weight = checked_weight(op, "weight", weight, pred)
    factor, summed = 1.0, reduction != "none"
    if reduction == "mean":
        factor = 1 / pred.numel() if pred.numel() else float("nan")
    yes, no = (factor, factor) if alpha is None else (alpha * factor, (1 - alpha) * factor)
    ignored, ignores = as_arguments(op, ignore_index)
    terms = (yes, no, gamma, float(ignored), ignores, summed)
    target = as_dtype(target, pred.dtype)
    if weight is None and pos_weight is None:
        row = (1, pred.numel())
        if not summed and pred.dim() == 4 and pred.shape[1] > 1 and pred.stride(1) == 1:  # in the order of the memory
            pred, target = pred.movedim(1, -1), target.movedim(1, -1)
            loss = _binary(pred.reshape(row), target.reshape(row), None, None, *terms)
            return loss.view(pred.shape).movedim(-1, 1)
        loss = _binary(pred.reshape(row), target.reshape(row), None, None, *terms)
    else:
        rows, axes = pred.shape[0] * pred.shape[1], (1,) * (pred.dim() - 2)
        pixels = pred.numel() // rows if rows else 0
        of_no = pred.new_ones(pred.shape[1], dtype=compute_dtype(pred)) if weight is None else weight
        of_no = as_dtype(of_no, compute_dtype(pred)).reshape(-1, *axes)
        of_yes = of_no if pos_weight is None else of_no * as_dtype(pos_weight, of_no.dtype)
        if of_yes.shape[of_yes.dim() - len(axes) :].numel() != 1:  # one factor a pixel: each is a row
            rows, pixels, axes = pred.numel(), 1, pred.shape[2:]
        factors = (w.expand(*pred.shape[:2], *axes).reshape(-1) for w in (of_yes, of_no))
        loss = _binary(pred.reshape(rows, pixels), target.reshape(rows, pixels), *factors, *terms)
    return as_dtype(loss.sum() if summed else loss.view(pred.shape), pred.dtype)


def _pos_weight(op: str, pos_weight: Tensor | None, pred: Tensor) -> Tensor | None:
    """`pos_weight` as it broadcasts to `pred` (B, C, *): a vector of C numbers has one for each class."""
    if pos_weight is None:
        return None
    _check.numbers(op, "pos_weight", pos_weight)
    sizes, classes = pos_weight.shape, pred.shape[1]
    if sizes[:1] == (classes,) and pos_weight.numel() == classes:
        pos_weight = pos_weight.reshape(classes, *(1,) * (pred.dim() - 2))
    elif len(sizes) > pred.dim() or any(n not in (1, m) for n, m in zip(reversed(sizes), reversed(pred.shape))):
        raise ShapeError(
            f"{op}: expected pos_weight of shape ({classes},), or one that broadcasts to {tuple(pred.shape)}, "
            f"got {tuple(sizes)}",
            actual_shape=sizes,
        )
    return _check.to_device_of(op, pred, "pos_weight", pos_weight, of="pred")


def _binary_reference(
    pred: Tensor,
    target: Tensor,
    yes: Tensor | None,
    no: Tensor | None,
    of_yes: float,
    of_no: float,
    gamma: float,
    ignored: float,
    ignores: bool,
    summed: bool,
) -> Tensor:
    """(rows, size) losses of logits and targets of that shape, or their sums (rows,); the tensors are factors of the rows."""
    x, t = (z.to(compute_dtype(pred)) for z in (pred, target))
    if ignores:
        x = x.masked_fill(t == ignored, 0)
    log_yes, log_no = F.logsigmoid(x), F.logsigmoid(-x)
    positive = -of_yes * t * torch.exp(gamma * log_no) * log_yes
    negative = of_no * (t - 1) * torch.exp(gamma * log_yes) * log_no
    if yes is not None:
        positive = positive * yes[:, None]
    if no is not None:
        negative = negative * no[:, None]
    loss = positive + negative
    if ignores:
        loss = loss.masked_fill(t == ignored, 0)
    return loss.sum(1) if summed else loss.to(pred.dtype)


def _binary_fake(pred: Tensor, *args: Any) -> Tensor:
    return pred.new_empty(pred.shape[0], dtype=compute_dtype(pred)) if args[-1] else pred.new_empty(pred.shape)


def _binary_backward_reference(grad: Tensor, pred: Tensor, target: Tensor, *args: Any) -> Tensor:
    *terms, by_target = args
    rows = (x.expand(grad.shape[0], -1) for x in (pred, target))
    vjp_fn = torch.func.vjp(lambda pred, target: _binary_reference(pred, target, *terms), *rows)[1]
    return vjp_fn(grad)[by_target]


_MIN_PIXELS = 64  # per class; shorter rows leave a CUDA block too little work


def _binary_supports(pred: Tensor, target: Tensor, yes: Tensor | None, no: Tensor | None, *_: Any) -> str | None:
    """Weights of classes require at least 64 pixels per class."""
    if (yes is None and no is None) or pred.shape[1] >= _MIN_PIXELS:
        return None
    return f"there is no kernel for factors of classes with {pred.shape[1]} pixels each, only from {_MIN_PIXELS} on"


register(
    "binary_focal_backward",
    _binary_backward_reference,
    fake=lambda grad, pred, *_: pred.new_empty(grad.shape[0], pred.shape[1]),
    casts_outputs=True,
)
_binary = register(
    "binary_focal",
    _binary_reference,
    fake=_binary_fake,
    gradients="pred: binary_focal_backward(by_target=False); target: binary_focal_backward(by_target=True); yes, no: reference",
    casts_outputs=True,
    supports=_binary_supports,
)


def _focus(op: str, alpha: float | None, gamma: float) -> tuple[float | None, float]:
    return None if alpha is None else _check.number(op, "alpha", alpha), _check.number(op, "gamma", gamma, minimum=0)


class FocalLoss(FunctionModule):
    """Module form of :func:`focal_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.FocalLoss(0.5, reduction="mean")(torch.zeros(1, 4, 2, 2), torch.zeros(1, 2, 2, dtype=torch.int64))
        tensor(0.0975)
    """

    samples = IMAGE, LABELS

    def __init__(
        self,
        alpha: float | None,
        gamma: float = 2.0,
        reduction: Reduction = "none",
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

    samples = IMAGE, IMAGE

    def __init__(
        self,
        alpha: float | None,
        gamma: float = 2.0,
        reduction: Reduction = "none",
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
