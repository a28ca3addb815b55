"""Top-k accuracy of classification."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import SIGNED, floats
from kvision.core.exceptions import ShapeError


def accuracy(pred: Tensor, target: Tensor, topk: Sequence[int] = (1,)) -> list[Tensor]:
    """Compute the percentage of samples whose class is among the k best, for every k.

    Args:
        pred: scores (B, C).
        target: classes, B of them.
        topk: the ks, each at least 1; more than C count as C.

    Returns:
        For each k a tensor with one number.

    Raises:
        TypeCheckError: not two tensors.
        ShapeError: a shape is not as in Args.
        ValueCheckError: a k below 1.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.accuracy(torch.tensor([[0.1, 0.9], [0.8, 0.2]]), torch.tensor([1, 1]))
        [tensor(50.)]
    """
    _check.shape("accuracy", "pred", pred, "B", "C")
    pred = floats(pred) if pred.dtype is torch.bool else pred
    _check.numbers("accuracy", "target", target)
    if target.numel() != pred.shape[0]:
        raise ShapeError(
            f"accuracy: expected target with {pred.shape[0]} classes, got {tuple(target.shape)}",
            actual_shape=target.shape,
        )
    _check.same_device("accuracy", pred=pred, target=target)
    ks = [_check.ints("accuracy", "topk", k, 1)[0] for k in topk]
    best = pred.topk(min(max(ks), pred.shape[1]), 1).indices
    hits = best == (target.long() if target.dtype in SIGNED else target).reshape(-1, 1)
    return [hits[:, :k].sum(dtype=torch.float32) * 100 / pred.shape[0] for k in ks]
