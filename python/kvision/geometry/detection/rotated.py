"""Suppression of rotated boxes."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats, promoted
from kvision.core.exceptions import TypeCheckError
from kvision.core.rotated_boxes import rotated_overlap

__all__ = ["nms_rotated"]

_PAIRS = 1 << 20  # whose overlaps are computed at once, which bounds the memory


def nms_rotated(boxes: Tensor, scores: Tensor, iou_threshold: float, idxs: Tensor | None = None) -> Tensor:
    """Non-maximum suppression of rotated boxes, by the overlap of :func:`kvision.metrics.box_iou_rotated`.

    Waits for the device once for each link of the longest chain of boxes that suppress each other, and cannot be traced.

    Args:
        boxes: boxes (cx, cy, w, h, r) of shape (N, 5): middle and size by edges, and the angle in degrees, counter-clockwise in the
            picture, as of :func:`convert_boxes` to "cxcywhr".
        scores: scores of shape (N,).
        iou_threshold: the intersection over union above which the box of the lower score is suppressed. A box without area
            overlaps no other box.
        idxs: classes of shape (N,), integers: a box suppresses those of its own class alone. None for one class.

    Returns:
        The indices of the kept boxes, int64, in descending order of score. Equal scores keep the order of `boxes`.

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> boxes = torch.tensor([[5.0, 5, 8, 2, 0], [5, 5, 8, 2, 10], [5, 5, 8, 2, 90]])
        >>> K.geometry.nms_rotated(boxes, torch.tensor([0.5, 0.9, 0.7]), 0.5)
        tensor([1, 2])
    """
    op = "nms_rotated"
    _check.shape(op, "boxes", boxes, "N", 5)
    _check.numbers(op, "scores", scores)
    count = boxes.shape[0]
    _check.shape(op, "scores", scores, count)
    threshold = _check.number(op, "iou_threshold", iou_threshold)
    _check.same_device(op, boxes=boxes, scores=scores)
    order = scores.detach().argsort(descending=True, stable=True)
    if count == 0:
        return order
    best = promoted(floats(boxes.detach()))[order]
    rows = best.split(max(_PAIRS // count, 1))
    suppresses = torch.cat([rotated_overlap(part[:, None], best) > threshold for part in rows]).triu(1)
    if idxs is not None:
        _check.shape(op, "idxs", idxs, count)
        _check.same_device(op, boxes=boxes, idxs=idxs)
        if idxs.is_floating_point():
            raise TypeCheckError(f"{op}: expected idxs of integers, got {idxs.dtype}", actual_type=idxs.dtype)
        labels = idxs[order]
        suppresses = suppresses & (labels[:, None] == labels)
    # A box stays unless one that stays suppresses it: after k rounds this is decided for chains of k links.
    kept = torch.ones_like(order, dtype=torch.bool)
    while True:
        decided = ~(suppresses & kept[:, None]).any(0)
        if torch.equal(decided, kept):
            return order[kept]
        kept = decided
