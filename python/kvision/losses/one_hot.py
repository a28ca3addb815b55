"""Labels as indicator maps."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError


def one_hot(labels: Tensor, num_classes: int, device: torch.device, dtype: torch.dtype, eps: float = 0.0) -> Tensor:
    """Make a map for every class, 1 where it is the label and 0 elsewhere.

    Args:
        labels: (B, *) in [0, num_classes), int64. Another label is 0 in every map: labels are not read on the host.
        num_classes: how many maps, at least 1.
        device: where the maps live.
        dtype: their type.
        eps: the maps are hot * (1 - eps) + eps, which needs a floating-point dtype.

    Returns:
        (B, num_classes, *).

    Raises:
        TypeCheckError: labels are not int64; eps for a dtype of integers.
        ShapeError: labels without a batch axis.
        ValueCheckError: num_classes below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.one_hot(torch.tensor([[0, 2]]), 3, torch.device("cpu"), torch.int64)
        tensor([[[1, 0],
                 [0, 0],
                 [0, 1]]])
    """
    _check.numbers("one_hot", "labels", labels)
    if labels.dtype != torch.int64:
        raise TypeCheckError(f"one_hot: expected labels of int64, got {labels.dtype}", actual_type=labels.dtype)
    if labels.dim() == 0:
        raise ShapeError("one_hot: expected labels of shape (B, *), got ()", actual_shape=labels.shape)
    (num_classes,) = _check.ints("one_hot", "num_classes", num_classes, 1)
    target_device, eps = _check.device("one_hot", device), _check.number("one_hot", "eps", eps)
    if not isinstance(dtype, torch.dtype):
        raise TypeCheckError(f"one_hot: expected dtype to be a torch.dtype, got {dtype!r}")
    if eps != 0 and not dtype.is_floating_point:
        raise TypeCheckError(f"one_hot: expected a floating-point dtype with eps={eps}, got {dtype}", actual_type=dtype)
    labels = labels.to(target_device)
    classes = torch.arange(num_classes, device=target_device).view(-1, *(1,) * (labels.dim() - 1))
    hot = (labels[:, None] == classes).to(dtype)
    return hot if eps == 0 else hot * (1 - eps) + eps
