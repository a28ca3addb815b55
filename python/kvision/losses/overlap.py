"""Losses of how much regions overlap: Dice and Tversky."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._modules import FunctionModule
from kvision._ops import register, vjp
from kvision.losses.reduction import check_labels, check_weight, masked, selected


def _reference(pred: Tensor, target: Tensor, ignored: int, ignores: bool) -> Tensor:
    """(B, 3, C): for every class the sum of its probability where it is the label, that everywhere, its pixels."""
    classes, wide = pred.shape[1], pred.to(compute_dtype(pred))
    index, counts = selected(target.expand(pred.shape[0], -1, -1), classes, ignored if ignores else None, wide.dtype)
    p = masked(wide, counts).softmax(1) * counts[:, None]
    own = index[:, None] == torch.arange(classes, device=pred.device).view(-1, 1, 1)
    sums = torch.where(own, p, 0).sum((2, 3)), p.sum((2, 3)), torch.where(own, counts[:, None], 0).sum((2, 3))
    return torch.stack(sums, 1)


def _fake(pred: Tensor, *_: Any) -> Tensor:
    return pred.new_empty((pred.shape[0], 3, pred.shape[1]), dtype=compute_dtype(pred))


def _backward(needs, grad, *args):
    return [_class_sums_backward(grad, *args), None]


_class_sums_backward = register(
    "class_sums_backward",
    vjp(_reference),
    fake=lambda grad, pred, *_: torch.empty_like(pred, memory_format=torch.contiguous_format),
    stores=True,
)
_class_sums = register("class_sums", _reference, fake=_fake, backward=_backward, stores=True)


def _sums_of(pred: Tensor, target: Tensor, ignore_index: int | None) -> Tensor:
    operator = _class_sums if pred.shape[1] <= 1024 else _class_sums.reference  # as many as a block of a GPU holds
    return operator(pred, target, ignore_index or 0, ignore_index is not None)


def dice_loss(
    pred: Tensor,
    target: Tensor,
    average: str = "micro",
    eps: float = 1e-8,
    weight: Tensor | None = None,
    ignore_index: int | None = -100,
) -> Tensor:
    """Compute the Dice loss 1 - 2 sum(P T) / (sum(P) + sum(T)) of softmax probabilities P and one-hot labels T.

    Args:
        pred: logits (B, C, H, W).
        target: labels (B, H, W) in [0, C), int64. Another label makes the loss NaN, as labels are not read on the host.
        average: 'micro' takes all classes of a sample together, 'macro' is the mean over the classes that its labels
            have, and 1 where they have none.
        eps: added to the divisor.
        weight: factors of the classes (C,).
        ignore_index: label of the pixels that do not count; None for no such label.

    Returns:
        The mean over the samples, a number.

    Raises:
        TypeCheckError: pred is no floating-point tensor or target not int64.
        ShapeError: target or weight do not fit pred.
        ValueCheckError: an unknown average, a negative eps.
        DeviceError: tensors on different devices.

    Source: F. Milletari et al., "V-Net" (2016).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.dice_loss(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """
    check_labels("dice_loss", pred, target)
    _check.choice("dice_loss", "average", average, ("micro", "macro"))
    eps = _check.number("dice_loss", "eps", eps, minimum=0)
    check_weight("dice_loss", "weight", weight, pred)
    sums = _sums_of(pred, target, ignore_index)
    weight = sums.new_ones(pred.shape[1]) if weight is None else weight.to(sums.dtype)
    return _dice(sums, weight, average, eps).to(pred.dtype)


def _dice(sums: Tensor, weight: Tensor, average: str, eps: float) -> Tensor:
    both, predicted, labelled = sums.unbind(1)
    if average == "micro":
        return (1 - _ratio(2 * (both * weight).sum(1), ((predicted + labelled) * weight).sum(1), eps)).mean()
    weight = torch.where(labelled == 0, 0, weight)
    loss = 1 - _ratio(2 * both, predicted + labelled, eps)
    total = weight.sum(1)
    return torch.where(total == 0, 1, (loss * weight).sum(1) / torch.where(total == 0, 1, total)).mean()


def _ratio(a: Tensor, b: Tensor, eps: float) -> Tensor:
    """a / (b + eps), and 0 where there is nothing at all."""
    nothing = b == 0
    return torch.where(nothing, 0, a / torch.where(nothing, 1, b + eps))


def tversky_loss(
    pred: Tensor,
    target: Tensor,
    alpha: float = 0.5,
    beta: float = 0.5,
    eps: float = 1e-8,
    ignore_index: int | None = -100,
) -> Tensor:
    """Compute the Tversky loss 1 - TP / (TP + alpha FP + beta FN) of softmax probabilities and labels.

    Args:
        pred: logits (B, C, H, W).
        target: labels (B, H, W) in [0, C), int64. Another label makes the loss NaN, as labels are not read on the host.
        alpha: factor of the false positives.
        beta: factor of the false negatives; alpha = beta = 0.5 is the Dice loss, 1 and 1 that of Jaccard.
        eps: added to the divisor.
        ignore_index: label of the pixels that do not count; None for no such label.

    Returns:
        The mean over the samples of the mean over the classes that their labels have, a number.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`dice_loss`.

    Source: S. Salehi et al., "Tversky loss function for image segmentation" (2017).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.tversky_loss(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """
    check_labels("tversky_loss", pred, target)
    alpha = _check.number("tversky_loss", "alpha", alpha)
    beta = _check.number("tversky_loss", "beta", beta)
    eps = _check.number("tversky_loss", "eps", eps, minimum=0)
    return _tversky(_sums_of(pred, target, ignore_index), alpha, beta, eps).to(pred.dtype)


def _tversky(sums: Tensor, alpha: float, beta: float, eps: float) -> Tensor:
    both, predicted, labelled = sums.unbind(1)
    absent = labelled == 0
    divisor = both + alpha * (predicted - both) + beta * (labelled - both) + eps
    score = torch.where(absent, 0, both / torch.where(absent, 1, divisor))
    return (1 - score.sum(1) / (~absent).sum(1).clamp_min(1)).mean()


class DiceLoss(FunctionModule):
    """Module form of :func:`dice_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.DiceLoss("macro")(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """

    def __init__(
        self,
        average: str = "micro",
        eps: float = 1e-8,
        weight: Tensor | None = None,
        ignore_index: int | None = -100,
    ) -> None:
        super().__init__(average=average, eps=eps, weight=weight, ignore_index=ignore_index)

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return dice_loss(pred, target, self.average, self.eps, self.weight, self.ignore_index)


class TverskyLoss(FunctionModule):
    """Module form of :func:`tversky_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.TverskyLoss(0.3, 0.7)(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """

    def __init__(self, alpha: float, beta: float, eps: float = 1e-8, ignore_index: int | None = -100) -> None:
        super().__init__(alpha=alpha, beta=beta, eps=eps, ignore_index=ignore_index)

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return tversky_loss(pred, target, self.alpha, self.beta, self.eps, self.ignore_index)
