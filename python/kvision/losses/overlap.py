"""Losses based on the overlap of regions: Dice and Tversky."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._modules import IMAGE, LABELS, FunctionModule
from kvision._ops import register, vjp
from kvision.losses.reduction import as_arguments, check_labels, checked_weight, masked, segmentation_supports, selected

Average: TypeAlias = Literal["micro", "macro"]
_AVERAGES = get_args(Average)


def _reference(
    pred: Tensor,
    target: Tensor,
    weight: Tensor | None,
    micro: bool,
    alpha: float,
    beta: float,
    eps: float,
    ignored: int,
    ignores: bool,
) -> tuple[Tensor, Tensor]:
    """The losses (losses,) of logits (losses, B, C, H, W), and the sums (losses, B, 3, C) from which they are computed.

    For every class, P[0] is the sum of its probability over pixels with its label, P[1] that over all pixels, and P[2]
    the number of pixels with its label. The score is P[0] / (P[0] + alpha (P[1] - P[0]) + beta (P[2] - P[0]) + eps),
    and 0 if the divisor is 0.
    """
    sums = _sums(pred, target, ignored if ignores else None)
    weight = sums.new_ones(1, pred.shape[2]) if weight is None else weight
    weight = weight[:, None].expand(*sums.shape[:2], -1)
    if micro:
        scores = _score((sums * weight[:, :, None]).sum(3), alpha, beta, eps)
    else:
        weight = torch.where(sums[:, :, 2] == 0, 0, weight)  # classes that do not occur in a sample
        total = weight.sum(2)
        scores = (weight * _score(sums.movedim(2, 3), alpha, beta, eps)).sum(2)
        scores = torch.where(total == 0, 0, scores / torch.where(total == 0, 1, total))
    return (1 - scores).mean(1), sums


def _sums(pred: Tensor, target: Tensor, ignored: int | None) -> Tensor:
    classes, promoted = pred.shape[2], pred.to(compute_dtype(pred)).flatten(0, 1)
    target = target.expand(pred.shape[0], *target.shape[1:]).flatten(0, 1)
    index, counts = selected(target, classes, ignored, promoted.dtype)
    p = masked(promoted, counts).softmax(1) * counts[:, None]
    own = index[:, None] == torch.arange(classes, device=pred.device).view(-1, 1, 1)
    sums = torch.where(own, p, 0).sum((2, 3)), p.sum((2, 3)), torch.where(own, counts[:, None], 0).sum((2, 3))
    return torch.stack(sums, 1).unflatten(0, pred.shape[:2])


def _score(sums: Tensor, alpha: float, beta: float, eps: float) -> Tensor:
    both, predicted, labeled = sums.unbind(-1)
    divisor = both + alpha * (predicted - both) + beta * (labeled - both) + eps
    nothing = divisor == 0
    return torch.where(nothing, 0, both / torch.where(nothing, 1, divisor))


def _fake(pred: Tensor, *_: Any) -> list[Any]:
    losses, batch, classes = pred.shape[:3]
    dtype = compute_dtype(pred)
    return [pred.new_empty(losses, dtype=dtype), pred.new_empty(losses, batch, 3, classes, dtype=dtype)]


def _backward_reference(grad: Tensor, sums: Tensor, pred: Tensor, *args: Any) -> Tensor:
    return vjp(lambda pred: _reference(pred, *args)[0])(grad, pred)


register(
    "overlap_backward",
    _backward_reference,
    fake=lambda grad, sums, pred, *_: torch.empty_like(pred, memory_format=torch.contiguous_format),
    casts_outputs=True,
)
_overlap = register(
    "overlap",
    _reference,
    fake=_fake,
    gradients="pred: overlap_backward(sums=result1); weight: reference",
    non_differentiable=(1,),
    casts_outputs=True,
    supports=segmentation_supports,
)


def _loss(
    op: str,
    pred: Tensor,
    target: Tensor,
    weight: Tensor | None,
    micro: bool,
    alpha: float,
    beta: float,
    eps: float,
    ignore_index: int | None,
) -> Tensor:
    terms = (micro, alpha, beta, eps, *as_arguments(op, ignore_index))
    return as_dtype(_overlap(pred[None], target[None], weight, *terms)[0].squeeze(), pred.dtype)


def dice_loss(
    pred: Tensor,
    target: Tensor,
    average: Average = "micro",
    eps: float = 1e-8,
    weight: Tensor | None = None,
    ignore_index: int | None = -100,
) -> Tensor:
    """Compute the Dice loss 1 - 2 sum(P T) / (sum(P) + sum(T)) of softmax probabilities P and one-hot labels T.

    Args:
        pred: logits (B, C, H, W).
        target: labels (B, H, W) in [0, C), int64. Another label makes the loss NaN, as labels are not read on the host.
        average: 'micro' sums over all classes of a sample first, 'macro' is the mean over the classes that its labels
            have, and 1 where they have none.
        eps: added to the divisor.
        weight: factors of the classes (C,).
        ignore_index: label of the pixels that do not count; None for no such label.

    Returns:
        The mean over the samples, a number.

    Raises:
        TypeCheckError: pred is not a floating-point tensor or target not int64.
        ShapeError: target or weight do not fit pred.
        ValueCheckError: an unknown average, a negative eps.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: F. Milletari et al., "V-Net" (2016).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.dice_loss(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """
    check_labels("dice_loss", pred, target)
    _check.choice("dice_loss", "average", average, _AVERAGES)
    eps = _check.number("dice_loss", "eps", eps, minimum=0)
    weight = checked_weight("dice_loss", "weight", weight, pred)
    weight = None if weight is None else weight[None].to(compute_dtype(pred))
    return _loss("dice_loss", pred, target, weight, average == "micro", 0.5, 0.5, eps / 2, ignore_index)


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
    return _loss("tversky_loss", pred, target, None, False, alpha, beta, eps, ignore_index)


class DiceLoss(FunctionModule):
    """Module form of :func:`dice_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.DiceLoss("macro")(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """

    samples = IMAGE, LABELS

    def __init__(
        self,
        average: Average = "micro",
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

    samples = IMAGE, LABELS

    def __init__(self, alpha: float, beta: float, eps: float = 1e-8, ignore_index: int | None = -100) -> None:
        super().__init__(alpha=alpha, beta=beta, eps=eps, ignore_index=ignore_index)

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return tversky_loss(pred, target, self.alpha, self.beta, self.eps, self.ignore_index)
