"""Overlaps of boxes that also tell how far apart boxes are, and overlaps of rotated boxes."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats, promoted
from kvision._ops import with_kernel_casts
from kvision.core.rotated_boxes import rotated_overlap

__all__ = ["box_iou_rotated", "complete_box_iou", "distance_box_iou", "generalized_box_iou"]

# --- upright boxes --------------------------------------------------------------------------------------------------


def generalized_box_iou(boxes1: Tensor, boxes2: Tensor) -> Tensor:
    """Compute the generalized intersection over union of every box of one set with every box of another.

    It is the intersection over union minus the share of the box around both that neither covers. :func:`mean_iou_bbox` is the
    intersection over union itself.

    Args:
        boxes1: boxes (x1, y1, x2, y2) by their edges, of shape (*, N, 4); integers are computed in float32.
        boxes2: boxes of shape (*, M, 4).

    Returns:
        (*, N, M), from -1 to 1; NaN for a box with a negative width or height, and for two boxes around which there is no area.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: H. Rezatofighi et al., "Generalized intersection over union" (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.generalized_box_iou(torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([[2.0, 0, 4, 2], [0, 0, 2, 1]]))
        tensor([[0.0000, 0.5000]])
    """
    return generalized_overlap(*_pairs("generalized_box_iou", boxes1, boxes2, 4), 0.0)


def distance_box_iou(boxes1: Tensor, boxes2: Tensor, eps: float = 1e-7) -> Tensor:
    """Compute the intersection over union of boxes minus the squared distance of their middles, relative to the box around both.

    Args:
        boxes1: boxes (x1, y1, x2, y2) by their edges, of shape (*, N, 4); integers are computed in float32.
        boxes2: boxes of shape (*, M, 4).
        eps: added to the squared diagonal, by which the squared distance is divided.

    Returns:
        (*, N, M), from -1 to 1; NaN for a box with a negative width or height, and for two boxes without area.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: Z. Zheng et al., "Distance-IoU loss" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.distance_box_iou(torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([[2.0, 0, 4, 2]]))
        tensor([[-0.2000]])
    """
    eps = _check.number("distance_box_iou", "eps", eps)
    return distance_overlap(*_pairs("distance_box_iou", boxes1, boxes2, 4), 0.0, eps)


def complete_box_iou(boxes1: Tensor, boxes2: Tensor, eps: float = 1e-7) -> Tensor:
    """Compute :func:`distance_box_iou` minus a term for the difference of the boxes' aspect ratios.

    The term is alpha v, with v = 4 / pi^2 times the squared difference of atan(width / height), and alpha =
    v / (1 - iou + v + eps), which has no gradient.

    Args:
        boxes1: boxes (x1, y1, x2, y2) by their edges, of shape (*, N, 4); integers are computed in float32.
        boxes2: boxes of shape (*, M, 4).
        eps: added to the squared diagonal and to the denominator of alpha.

    Returns:
        (*, N, M); NaN for a box with a negative width or height, and for two boxes without area.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: Z. Zheng et al., "Distance-IoU loss" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.complete_box_iou(torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([[2.0, 0, 4, 2]]))
        tensor([[-0.2000]])
    """
    eps = _check.number("complete_box_iou", "eps", eps)
    return complete_overlap(*_pairs("complete_box_iou", boxes1, boxes2, 4), 0.0, eps)


def _pairs(op: str, boxes1: Tensor, boxes2: Tensor, numbers: int) -> tuple[Tensor, Tensor]:
    """Both sets with an axis for the other one."""
    _check.trailing_shape(op, "boxes1", boxes1, "N", numbers)
    _check.trailing_shape(op, "boxes2", boxes2, "M", numbers)
    _check.leading_axes(op, 2, boxes1=boxes1, boxes2=boxes2)
    _check.same_device(op, boxes1=boxes1, boxes2=boxes2)
    a, b = floats(boxes1), floats(boxes2)
    dtype = torch.promote_types(a.dtype, b.dtype)
    return a.to(dtype)[..., :, None, :], b.to(dtype)[..., None, :, :]


def _sizes(boxes: Tensor) -> Tensor:
    """Widths and heights (*, 2); NaN where one is negative."""
    sizes = boxes[..., 2:] - boxes[..., :2]
    return torch.where((sizes >= 0).all(-1, keepdim=True), sizes, torch.nan)


def _overlap(a: Tensor, b: Tensor, eps: float) -> tuple[Tensor, Tensor, Tensor]:
    """The intersection over union and the union (*) of boxes (*, 4), and the size (*, 2) of the box around both."""
    both = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    union = _sizes(a).prod(-1) + _sizes(b).prod(-1) - both
    around = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    return both / (union + eps), union, around


@with_kernel_casts
def generalized_overlap(a: Tensor, b: Tensor, eps: float) -> Tensor:
    """Of boxes (*, 4) and (*, 4), pair by pair; the losses' formula."""
    iou, union, around = _overlap(a, b, eps)
    area = around.prod(-1)
    return iou - (area - union) / (area + eps)


@with_kernel_casts
def distance_overlap(a: Tensor, b: Tensor, iou_eps: float, eps: float) -> Tensor:
    """Of boxes (*, 4) and (*, 4), pair by pair; the losses' formula."""
    iou, _, around = _overlap(a, b, iou_eps)
    return iou - _distance(a, b, around, eps)


@with_kernel_casts
def complete_overlap(a: Tensor, b: Tensor, iou_eps: float, eps: float) -> Tensor:
    """Of boxes (*, 4) and (*, 4), pair by pair; the losses' formula."""
    iou, _, around = _overlap(a, b, iou_eps)
    angles = [torch.atan2(*_sizes(x).unbind(-1)) for x in (a, b)]
    v = 4 / math.pi**2 * (angles[0] - angles[1]).square()
    alpha = (v / (1 - iou + v + eps)).detach()
    return iou - _distance(a, b, around, eps) - alpha * v


def _distance(a: Tensor, b: Tensor, around: Tensor, eps: float) -> Tensor:
    """The squared distance of the middles, relative to the diagonal of the box of size `around`."""
    apart = (a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]) / 2
    return apart.square().sum(-1) / (around.square().sum(-1) + eps)


# --- rotated boxes --------------------------------------------------------------------------------------------------


def box_iou_rotated(boxes1: Tensor, boxes2: Tensor) -> Tensor:
    """Compute the intersection over union of every rotated box of one set with every one of another.

    The intersection is exact, also where edges coincide, and computed in float64. Its gradient is that of the polygon, to all five
    numbers of both boxes.

    Args:
        boxes1: boxes (cx, cy, w, h, r) of shape (*, N, 5): middle and size by edges, and the angle in degrees, counter-clockwise in
            the picture, as torchvision's 'cxcywhr'. :func:`kvision.geometry.convert_boxes` converts others to it. Integers are
            computed in float32.
        boxes2: boxes of shape (*, M, 5).

    Returns:
        (*, N, M), from 0 to 1; NaN for a box whose width or height is not positive.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> upright, turned = torch.tensor([[5.0, 5, 4, 2, 0]]), torch.tensor([[5.0, 5, 4, 2, 90]])
        >>> K.metrics.box_iou_rotated(upright, turned)
        tensor([[0.3333]])
    """
    a, b = _pairs("box_iou_rotated", boxes1, boxes2, 5)
    return rotated_overlap(promoted(a), promoted(b)).to(a.dtype)
