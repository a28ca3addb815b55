"""Suppression of boxes that overlap better ones: kernels that decide on the device."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._modes import BOX_DECAY
from kvision._ops import register
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

__all__ = ["batched_nms", "nms", "nms_mask", "soft_nms"]

Decay: TypeAlias = Literal["linear", "gaussian"]
_DECAYS = get_args(Decay)


def _overlap(a: Tensor, b: Tensor) -> Tensor:
    """The intersections over union of edges (B, 4, N) and (B, 4, M), broadcast; NaN for two boxes without area."""
    size = torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])
    both = size.clamp(min=0).prod(1)
    return both / ((a[:, 2:] - a[:, :2]).prod(1) + (b[:, 2:] - b[:, :2]).prod(1) - both)


def _samples(*tensors: Tensor | None) -> int:
    """How many samples tensors have of which some may have one for all."""
    sizes = [x.shape[0] for x in tensors if x is not None]
    return next((n for n in sizes if n != 1), 1)


def _suppress_reference(edges: Tensor, labels: Tensor | None, threshold: float) -> Tensor:
    """Which boxes (B, 4, N), the best first, are kept: uint8 (B, N)."""
    count = edges.shape[-1]
    kept = torch.ones(_samples(edges, labels), count, dtype=torch.bool, device=edges.device)
    for i in range(count):
        removed = _overlap(edges[..., i : i + 1], edges[..., i + 1 :]) > threshold
        if labels is not None:
            removed = removed & (labels[:, i : i + 1] == labels[:, i + 1 :])
        first, later = kept[:, : i + 1], kept[:, i + 1 :]  # nothing in place: vmap may map edges alone
        kept = torch.cat([first, later & ~(removed & first[:, -1:])], 1)
    return kept.to(torch.uint8)


def _soft_suppress_reference(
    edges: Tensor,
    scores: Tensor,
    labels: Tensor | None,
    threshold: float,
    sigma: float,
    min_score: float,
    decay: int,
) -> tuple[Tensor, Tensor]:
    """Boxes (B, 4, N) in the order of their decayed scores (B, N), and these: -1 and 0 for those below `min_score`."""
    count, batch = edges.shape[-1], _samples(edges, scores, labels)
    edges, left = edges.expand(batch, 4, count), torch.where(scores.isnan(), -torch.inf, scores).expand(batch, count)
    order, chosen = [], []
    for _ in range(count):
        best = left.argmax(1, keepdim=True)
        score = left.gather(1, best)
        is_chosen = (score >= min_score) & (score > -torch.inf)
        order.append(torch.where(is_chosen, best, -1))
        chosen.append(torch.where(is_chosen, score, 0))
        overlap = _overlap(edges.gather(2, best[:, None].expand(batch, 4, 1)), edges)
        if decay == BOX_DECAY["linear"]:
            factor = torch.where(overlap > threshold, 1 - overlap, 1)
        else:
            factor = torch.where(overlap > 0, (-overlap.square() / sigma).exp(), 1)
        if labels is not None:
            factor = torch.where(labels == labels.expand(batch, count).gather(1, best), factor, 1)
        left = torch.where(left > -torch.inf, left * factor, left).scatter(1, best, -torch.inf)
    if not count:
        return edges.new_empty(batch, 0, dtype=torch.int64), edges.new_empty(batch, 0)
    return torch.cat(order, 1), torch.cat(chosen, 1)


def _fake(edges: Tensor, labels: Tensor | None, *_: float) -> Tensor:
    return edges.new_empty(_samples(edges, labels), edges.shape[-1], dtype=torch.uint8)


def _soft_fake(edges: Tensor, scores: Tensor, labels: Tensor | None, *_: float) -> list[Tensor]:
    size = (_samples(edges, scores, labels), edges.shape[-1])
    return [edges.new_empty(size, dtype=torch.int64), edges.new_empty(size)]


_suppress = register("suppress_boxes", _suppress_reference, fake=_fake, non_differentiable=(0,), casts_outputs=True)
_soft_suppress = register(
    "soft_suppress_boxes", _soft_suppress_reference, fake=_soft_fake, non_differentiable=(0, 1), casts_outputs=True
)


def nms(boxes: Tensor, scores: Tensor, iou_threshold: float) -> Tensor:
    """Non-maximum suppression: keep boxes in descending order of score, unless they overlap a kept one by more than a threshold.

    The size of the result depends on the values of the boxes. The function therefore waits for the device, once, and cannot be
    traced; :func:`nms_mask` does not wait.

    Args:
        boxes: boxes (x1, y1, x2, y2) of shape (N, 4), whose size is the difference of both corners.
        scores: scores of shape (N,).
        iou_threshold: the intersection over union above which the box of the lower score is suppressed. A box without area
            overlaps no other box.

    Returns:
        The indices of the kept boxes, int64, in descending order of score. Equal scores keep the order of `boxes`.

    Raises:
        TypeError: `boxes` or `scores` is not a tensor of real numbers, or `iou_threshold` is not a number.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> boxes = torch.tensor([[0.0, 0, 10, 10], [1, 0, 11, 10], [20, 0, 30, 10]])
        >>> K.geometry.nms(boxes, torch.tensor([0.5, 0.9, 0.7]), 0.5)
        tensor([1, 2])
    """
    _check.shape("nms", "boxes", boxes, "N", 4)
    order, kept = _kept("nms", boxes[None], scores, iou_threshold, None)
    return order[0][kept[0]]


def batched_nms(boxes: Tensor, scores: Tensor, idxs: Tensor, iou_threshold: float) -> Tensor:
    """Non-maximum suppression within each class: a box suppresses those of its own class alone.

    As :func:`nms`, it waits for the device once.

    Args:
        boxes: boxes (x1, y1, x2, y2) of shape (N, 4), whose size is the difference of both corners.
        scores: scores of shape (N,).
        idxs: classes of shape (N,), integers; any numbers, also negative ones. For boxes of many images, classes of their own
            for every image.
        iou_threshold: the intersection over union above which the box of the lower score is suppressed.

    Returns:
        The indices of the kept boxes of all classes, int64, in descending order of score.

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> boxes = torch.tensor([[0.0, 0, 10, 10], [1, 0, 11, 10], [2, 0, 12, 10]])
        >>> K.geometry.batched_nms(boxes, torch.tensor([0.5, 0.9, 0.7]), torch.tensor([1, 0, 1]), 0.5)
        tensor([1, 2])
    """
    _check.shape("batched_nms", "boxes", boxes, "N", 4)
    order, kept = _kept("batched_nms", boxes[None], scores, iou_threshold, idxs)
    return order[0][kept[0]]


def nms_mask(boxes: Tensor, scores: Tensor, iou_threshold: float, idxs: Tensor | None = None) -> Tensor:
    """Which boxes of every image :func:`nms` keeps, decided on the device: it never waits, and compiles and exports.

    Args:
        boxes: boxes (x1, y1, x2, y2) of shape (N, 4) or (B, N, 4), whose size is the difference of both corners.
        scores: scores of shape (N,) or (B, N). Boxes that pad an image get the lowest scores and no area.
        iou_threshold: the intersection over union above which the box of the lower score is suppressed.
        idxs: classes of shape (N,) or (B, N), integers: a box suppresses those of its own class alone. None for one class.

    Returns:
        A mask of shape (N,) or (B, N), bool, in the order of `boxes`.

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> boxes = torch.tensor([[0.0, 0, 10, 10], [1, 0, 11, 10], [20, 0, 30, 10]])
        >>> K.geometry.nms_mask(boxes, torch.tensor([0.5, 0.9, 0.7]), 0.5)
        tensor([False,  True,  True])
    """
    batch = _batch_of("nms_mask", boxes)
    order, kept = _kept("nms_mask", batch, scores, iou_threshold, idxs)
    mask = torch.zeros_like(kept).scatter(-1, order, kept)
    return mask if boxes.dim() == 3 else mask[0]


def soft_nms(
    boxes: Tensor,
    scores: Tensor,
    iou_threshold: float = 0.3,
    sigma: float = 0.5,
    min_score: float = 1e-3,
    method: Decay = "linear",
    idxs: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Soft non-maximum suppression: scores of boxes decay with their overlap with each better box.

    All rounds run on the device, in one kernel. The size of the result depends on the values, so that the function waits for
    the device once and cannot be traced. It carries no gradient.

    Args:
        boxes: boxes (x1, y1, x2, y2) of shape (N, 4), whose size is the difference of both corners.
        scores: scores of shape (N,).
        iou_threshold: the intersection over union above which 'linear' decays. Not used by 'gaussian'.
        sigma: the width of 'gaussian', above 0.
        min_score: boxes whose score is below it, at first or after a decay, are left out.
        method: 'linear' multiplies scores by 1 - overlap, 'gaussian' by exp(-overlap^2 / sigma).
        idxs: classes of shape (N,), integers: a box decays the scores of its own class alone. None for one class.

    Returns:
        The indices of the boxes, int64, in descending order of their decayed scores, and these, of the type of `scores`.

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: a shape is not as in Args, `method` is unknown, `sigma` is not above 0, or the tensors are on different
            devices.

    Source: N. Bodla et al., "Soft-NMS: improving object detection with one line of code" (2017).

    Example:
        >>> import torch, kvision as K
        >>> boxes = torch.tensor([[0.0, 0, 10, 10], [5, 0, 15, 10], [20, 0, 30, 10]])
        >>> K.geometry.soft_nms(boxes, torch.tensor([0.6, 0.9, 0.7]))
        (tensor([1, 2, 0]), tensor([0.9000, 0.7000, 0.4000]))
    """
    op = "soft_nms"
    _check.shape(op, "boxes", boxes, "N", 4)
    labels = _check_sets(op, boxes[None], scores, idxs)
    threshold, lowest = _check.number(op, "iou_threshold", iou_threshold), _check.number(op, "min_score", min_score)
    width = _check.number(op, "sigma", sigma)
    if not width > 0:
        raise ValueCheckError(f"{op}: expected sigma above 0, got {sigma}", actual_value=sigma)
    _check.choice(op, "method", method, _DECAYS)
    edges = _as_edges(boxes[None])
    values = scores.detach().reshape(1, -1).to(edges.dtype)
    order, decayed = _soft_suppress(edges, values, labels, threshold, width, lowest, BOX_DECAY[method])
    chosen = order[0] >= 0
    return order[0][chosen], decayed[0][chosen].to(scores.dtype if scores.is_floating_point() else decayed.dtype)


def _batch_of(op: str, boxes: Tensor) -> Tensor:
    _check.trailing_shape(op, "boxes", boxes, "N", 4)
    if boxes.dim() not in (2, 3):
        raise ShapeError(f"{op}: expected boxes of shape (N, 4) or (B, N, 4), got {tuple(boxes.shape)}")
    return boxes if boxes.dim() == 3 else boxes[None]


def _check_sets(op: str, boxes: Tensor, scores: Tensor, idxs: Tensor | None) -> Tensor | None:
    """Check scores and classes of boxes (B, N, 4); return the classes as int64 (B, N)."""
    batch, count = boxes.shape[:2]
    _check.numbers(op, "scores", scores)
    size = (count,) if scores.dim() == 1 and batch == 1 else (batch, count)
    _check.shape(op, "scores", scores, *size)
    _check.same_device(op, boxes=boxes, scores=scores)
    if idxs is None:
        return None
    _check.shape(op, "idxs", idxs, *size)
    _check.same_device(op, boxes=boxes, idxs=idxs)
    if idxs.is_floating_point():
        raise TypeCheckError(f"{op}: expected idxs of integers, got {idxs.dtype}", actual_type=idxs.dtype)
    return idxs.reshape(batch, count).to(torch.int64)


def _kept(op: str, boxes: Tensor, scores: Tensor, iou_threshold: float, idxs: Tensor | None) -> tuple[Tensor, Tensor]:
    """The order (B, N) of boxes (B, N, 4) by descending score, and which of them in this order are kept."""
    labels = _check_sets(op, boxes, scores, idxs)
    threshold = _check.number(op, "iou_threshold", iou_threshold)
    order = scores.detach().reshape(boxes.shape[:2]).argsort(dim=-1, descending=True, stable=True)
    edges = _as_edges(boxes)
    edges = edges.gather(-1, order[:, None].expand(edges.shape))
    return order, _suppress(edges, None if labels is None else labels.gather(-1, order), threshold).bool()


def _as_edges(boxes: Tensor) -> Tensor:
    """Boxes (B, N, 4) as edges (B, 4, N) in the type that kernels compute with."""
    dtype = torch.float32 if boxes.is_floating_point() and boxes.dtype != torch.float64 else torch.float64
    return boxes.detach().to(dtype).mT
