"""Losses of predicted boxes by their overlap with true ones."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision._dtype import floats
from kvision.core.exceptions import ShapeError
from kvision.losses.reduction import reduced
from kvision.metrics.box_overlap import complete_overlap, distance_overlap, generalized_overlap


def generalized_box_iou_loss(
    boxes1: Tensor, boxes2: Tensor, reduction: Reduction = "none", eps: float = 1e-7
) -> Tensor:
    """Compute 1 - :func:`kvision.metrics.generalized_box_iou` of pairs of boxes.

    Args:
        boxes1: boxes (x1, y1, x2, y2) by their edges, of shape (*, 4); integers are computed in float32.
        boxes2: boxes of the same shape.
        reduction: 'none', 'mean' or 'sum'.
        eps: added to the areas that are divided by.

    Returns:
        The losses (*), or a number: the mean of no boxes is 0. NaN for a box with a negative width or height.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: the shapes differ or are not (*, 4).
        ValueCheckError: an unknown reduction.
        DeviceError: the tensors are on different devices.

    Source: H. Rezatofighi et al., "Generalized intersection over union" (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.generalized_box_iou_loss(torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([[0.0, 0, 2, 1]]))
        tensor([0.5000])
    """
    return _loss("generalized_box_iou_loss", generalized_overlap, boxes1, boxes2, reduction, eps, (eps,))


def distance_box_iou_loss(boxes1: Tensor, boxes2: Tensor, reduction: Reduction = "none", eps: float = 1e-7) -> Tensor:
    """Compute 1 - :func:`kvision.metrics.distance_box_iou` of pairs of boxes.

    Args:
        boxes1: boxes (x1, y1, x2, y2) by their edges, of shape (*, 4); integers are computed in float32.
        boxes2: boxes of the same shape.
        reduction: 'none', 'mean' or 'sum'.
        eps: added to the area and to the squared diagonal that are divided by.

    Returns:
        The losses (*), or a number: the mean of no boxes is 0. NaN for a box with a negative width or height.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: the shapes differ or are not (*, 4).
        ValueCheckError: an unknown reduction.
        DeviceError: the tensors are on different devices.

    Source: Z. Zheng et al., "Distance-IoU loss" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.distance_box_iou_loss(torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([[2.0, 0, 4, 2]]))
        tensor([1.2000])
    """
    return _loss("distance_box_iou_loss", distance_overlap, boxes1, boxes2, reduction, eps, (eps, eps))


def complete_box_iou_loss(boxes1: Tensor, boxes2: Tensor, reduction: Reduction = "none", eps: float = 1e-7) -> Tensor:
    """Compute 1 - :func:`kvision.metrics.complete_box_iou` of pairs of boxes.

    Args:
        boxes1: boxes (x1, y1, x2, y2) by their edges, of shape (*, 4); integers are computed in float32.
        boxes2: boxes of the same shape.
        reduction: 'none', 'mean' or 'sum'.
        eps: added to the area, the squared diagonal and the denominator of alpha that are divided by.

    Returns:
        The losses (*), or a number: the mean of no boxes is 0. NaN for a box with a negative width or height.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: the shapes differ or are not (*, 4).
        ValueCheckError: an unknown reduction.
        DeviceError: the tensors are on different devices.

    Source: Z. Zheng et al., "Distance-IoU loss" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.complete_box_iou_loss(torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([[2.0, 0, 4, 2]]))
        tensor([1.2000])
    """
    return _loss("complete_box_iou_loss", complete_overlap, boxes1, boxes2, reduction, eps, (eps, eps))


def _loss(
    op: str,
    overlap: Callable[..., Tensor],
    boxes1: Tensor,
    boxes2: Tensor,
    reduction: Reduction,
    eps: float,
    epsilons: tuple[float, ...],
) -> Tensor:
    _check.trailing_shape(op, "boxes1", boxes1, 4)
    _check.numbers(op, "boxes2", boxes2)
    if boxes1.shape != boxes2.shape:
        raise ShapeError(f"{op}: expected boxes of one shape, got {tuple(boxes1.shape)} and {tuple(boxes2.shape)}")
    _check.same_device(op, boxes1=boxes1, boxes2=boxes2)
    _check.reduction(op, reduction)
    _check.number(op, "eps", eps, 0)
    a, b = floats(boxes1), floats(boxes2)
    dtype = torch.promote_types(a.dtype, b.dtype)
    loss = 1 - overlap(a.to(dtype), b.to(dtype), *epsilons)
    return loss.sum() if loss.numel() == 0 and reduction == "mean" else reduced(loss, reduction)
