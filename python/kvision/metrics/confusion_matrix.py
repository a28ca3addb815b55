"""Confusion matrix of labels, and intersection over union of classes."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._modes import CONFUSION_STATISTIC
from kvision._ops import register
from kvision.core.exceptions import ShapeError, TypeCheckError

COUNTS, RATES, IOU = (CONFUSION_STATISTIC[name] for name in ("counts", "rates", "iou"))


def _reference(pred: Tensor, target: Tensor, classes: int, statistic: int, eps: float) -> Tensor:
    """For labels (B, N): COUNTS (B, classes, classes), RATES of each row, or the IOU (B, classes)."""
    m = classes + 2  # labels below and above the classes are counted as well, then dropped
    pred, target = pred.long().clamp(-1, classes), target.long().clamp(-1, classes)
    cells = torch.add(pred, target, alpha=m) + (m + 1)
    all_counts = torch.zeros(pred.shape[0], m * m, dtype=torch.int64, device=pred.device)
    all_counts = all_counts.scatter_add(1, cells, torch.ones_like(cells))
    counts = all_counts.view(-1, m, m)[:, 1:-1, 1:-1].float()
    if statistic == RATES:
        return counts / (counts.sum(2, keepdim=True) + eps)
    if statistic == COUNTS:
        return counts.contiguous()
    both = counts.diagonal(dim1=1, dim2=2)
    return (both + eps) / (counts.sum(1) + counts.sum(2) - both + eps)


def _fake(pred: Tensor, target: Tensor, classes: int, statistic: int, eps: float) -> Tensor:
    sizes = (classes,) if statistic == IOU else (classes, classes)
    return pred.new_empty(pred.shape[0], *sizes, dtype=torch.float32)


_confusion = register(
    "confusion_matrix", _reference, fake=_fake, non_differentiable=(0,), labels=True, casts_outputs=True
)


def confusion_matrix(pred: Tensor, target: Tensor, num_classes: int, normalized: bool = False) -> Tensor:
    """Count the pixels with each pair of true and predicted classes.

    Args:
        pred: labels (B, *) in [0, num_classes), integers. A pixel with another label, in pred or target, is not counted:
            labels are not read on the host.
        target: true labels in the same shape.
        num_classes: at least 2.
        normalized: divide each row by its sum.

    Returns:
        (B, num_classes, num_classes) of float32, rows for the classes of target and columns for those of pred.

    Raises:
        TypeCheckError: not two tensors of integers.
        ShapeError: different shapes, or no batch.
        ValueCheckError: num_classes below 2.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.confusion_matrix(torch.tensor([[0, 1, 1]]), torch.tensor([[0, 0, 1]]), 2)
        tensor([[[1., 1.],
                 [0., 1.]]])
    """
    pred, target, n = _labels("confusion_matrix", pred, target, num_classes)
    normalized = _check.switch("confusion_matrix", "normalized", normalized)
    return _confusion(pred, target, n, RATES if normalized else COUNTS, 1e-6)


def mean_iou(pred: Tensor, target: Tensor, num_classes: int, eps: float = 1e-6) -> Tensor:
    """Compute the intersection over union of every class in every sample.

    Args:
        pred: labels (B, *) in [0, num_classes), integers; see :func:`confusion_matrix` for others.
        target: true labels in the same shape.
        num_classes: at least 2.
        eps: added to both sides of the fraction, so that a class that nobody has gets 1.

    Returns:
        (B, num_classes).

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`confusion_matrix`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.mean_iou(torch.tensor([[0, 1, 1]]), torch.tensor([[0, 0, 1]]), 2)
        tensor([[0.5000, 0.5000]])
    """
    pred, target, n = _labels("mean_iou", pred, target, num_classes)
    return _confusion(pred, target, n, IOU, _check.number("mean_iou", "eps", eps, minimum=0))


def _labels(op: str, pred: Tensor, target: Tensor, num_classes: int) -> tuple[Tensor, Tensor, int]:
    """Both labels as (B, N), both int64 or both uint8."""
    for name, x in (("pred", pred), ("target", target)):
        _check.numbers(op, name, x)
        if x.is_floating_point() or x.dtype == torch.bool:
            raise TypeCheckError(f"{op}: expected {name} to hold integer labels, got {x.dtype}", actual_type=x.dtype)
    if pred.dim() == 0:
        raise ShapeError(f"{op}: expected pred of shape (B, *), got ()", actual_shape=pred.shape)
    _check.same_shape(op, pred=pred, target=target)
    _check.same_device(op, pred=pred, target=target)
    (n,) = _check.ints(op, "num_classes", num_classes, 1, 2)
    dtype = torch.uint8 if pred.dtype == target.dtype == torch.uint8 else torch.int64
    pred, target = (x.reshape(x.shape[0], -1 if x.numel() else 0).to(dtype) for x in (pred, target))
    return pred, target, n
