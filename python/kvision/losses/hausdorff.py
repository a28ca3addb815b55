"""Differentiable estimate of the Hausdorff distance, by erosions of the difference."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision._dtype import as_dtype, compute_dtype
from kvision._limits import MAX_EROSIONS
from kvision._modules import IMAGE, VOLUME, FunctionModule, Sample
from kvision._ops import not_empty, register, vjp
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.losses.reduction import selected


def _reference(pred: Tensor, target: Tensor, alpha: float, k: int, summed: bool) -> Tensor:
    """(B, C, *): the sum of (pred - label)^2 after 1 to k soft erosions, the i-th one with weight i ** alpha; labels
    are (B, *). With `summed`, its sums (B, C)."""
    classes, axes = pred.shape[1], tuple(range(2, pred.dim()))
    index, counts = selected(target.expand(pred.shape[0], *target.shape[1:]), classes, None, pred.dtype)
    own = index[:, None] == torch.arange(classes, device=pred.device).view(-1, *(1,) * len(axes))
    bound = (pred - own.to(pred.dtype)).square() * counts[:, None]
    total = torch.zeros_like(bound)
    for i in range(1, k + 1):
        bound = F.relu(_cross_mean(bound, axes) - 0.5)
        low = bound.amin(axes, keepdim=True)
        span = bound.amax(axes, keepdim=True) - low
        flat = span == 0
        bound = torch.where(flat, bound, (bound - low) / torch.where(flat, 1, span))
        total = total + bound * i**alpha
    return total.sum(axes) if summed else total


def _cross_mean(x: Tensor, axes: tuple[int, ...]) -> Tensor:
    """The mean of every pixel and its direct neighbors, zeros out of bounds."""
    total = x
    for axis in axes:
        border = [0, 0] * (x.dim() - 1 - axis) + [1, 1]
        padded = F.pad(x, border)
        n = x.shape[axis]
        total = total + padded.narrow(axis, 0, n) + padded.narrow(axis, 2, n)
    return total / (1 + 2 * len(axes))


def _fake(pred: Tensor, target: Tensor, alpha: float, k: int, summed: bool) -> Tensor:
    return pred.new_empty(pred.shape[:2] if summed else pred.shape)


def _supports(pred: Tensor, target: Tensor, alpha: float, k: int, summed: bool) -> str | None:
    """Predictions have at least one element, and there are at most 1000 erosions."""
    if k > MAX_EROSIONS:
        return f"there is no kernel for {k} erosions, only for up to {MAX_EROSIONS}"
    return not_empty(pred)


register(
    "hausdorff_backward",
    vjp(_reference),
    fake=lambda grad, pred, *_: torch.empty_like(pred, memory_format=torch.contiguous_format),
    casts_outputs=True,
)
_hausdorff = register(
    "hausdorff", _reference, fake=_fake, gradients="pred: hausdorff_backward", casts_outputs=True, supports=_supports
)


def _loss(pred: Tensor, target: Tensor, alpha: float, k: int, reduction: Reduction) -> Tensor:
    promoted = as_dtype(pred, compute_dtype(pred))
    loss = _hausdorff(promoted, target[:, 0], alpha, k, reduction != "none")
    if reduction == "none":
        loss = loss.movedim(1, 0)[:, :, None]
    else:
        loss = loss.sum()
        if reduction == "mean":
            loss = loss / pred.numel() if pred.numel() else loss * float("nan")
    return as_dtype(loss, pred.dtype)


class HausdorffERLoss(FunctionModule):
    """Estimate the Hausdorff distance of predicted and labeled regions by eroding their difference.

    Each class is compared with its own labels: (pred - target)^2 is eroded k times, softly and with a cross. After each
    erosion it is normalized to [0, 1]. The loss sums the results, the i-th one with weight i ** alpha.

    Args:
        alpha: how fast the weight of an erosion grows.
        k: how many erosions, at least 1.
        reduction: 'none', 'mean' or 'sum'.

    Its call takes probabilities pred (B, C, H, W) and labels target (B, 1, H, W) in [0, C), int64; another label makes the
    loss NaN, as labels are not read on the host. It returns a number, or for 'none' (C, B, 1, H, W).

    Raises:
        TypeCheckError: pred is not a floating-point tensor; k is not an int.
        ValueCheckError: target not int64; k below 1; an unknown reduction, which is a NotImplementedError, too.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: D. Karimi, S. Salcudean, "Reducing the Hausdorff distance in medical image segmentation with convolutional
    neural networks" (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.HausdorffERLoss()(torch.ones(1, 1, 8, 8), torch.zeros(1, 1, 8, 8, dtype=torch.int64))
        tensor(0.)
    """

    samples = IMAGE, Sample(1, 256, 256, dtype=torch.int64)

    _axes: tuple[str, ...] = ("H", "W")

    def __init__(self, alpha: float = 2.0, k: int = 10, reduction: Reduction = "mean") -> None:
        op = type(self).__name__
        _check.number(op, "alpha", alpha)
        _check.ints(op, "k", k, 1)
        _check.reduction(op, reduction)
        super().__init__(alpha=alpha, k=k, reduction=reduction)

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        op = type(self).__name__
        _check.shape(op, "pred", pred, "B", "C", *self._axes)
        _check.floating(op, "pred", pred)
        if pred.shape[1] == 0 or 0 in pred.shape[2:]:
            raise ShapeError(f"{op}: expected pred with classes and pixels, got {tuple(pred.shape)}")
        _check.shape(op, "target", target, pred.shape[0], 1, *pred.shape[2:])
        if target.dtype != torch.int64:
            raise ValueCheckError(f"{op}: expected target to hold int64 labels, got {target.dtype}")
        _check.same_device(op, pred=pred, target=target)
        return _loss(pred, target, self.alpha, self.k, self.reduction)


class HausdorffERLoss3D(HausdorffERLoss):
    """Estimate the Hausdorff distance of regions of volumes; see :class:`HausdorffERLoss`.

    Args:
        alpha: how fast the weight of an erosion grows.
        k: how many erosions, at least 1.
        reduction: 'none', 'mean' or 'sum'.

    Its call takes pred (B, C, D, H, W) and target (B, 1, D, H, W), and returns a number, or for 'none' (C, B, 1, D, H, W).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.HausdorffERLoss3D(k=3)(torch.ones(1, 1, 4, 4, 4), torch.zeros(1, 1, 4, 4, 4, dtype=torch.int64))
        tensor(0.)
    """

    samples = VOLUME, Sample(1, 64, 64, 64, dtype=torch.int64)

    _axes = ("D", "H", "W")
