"""Intersection over union of boxes, and average precision of detections."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modes import BOX_FORMAT, BOX_FORMAT_NAMES
from kvision._ops import register, vjp
from kvision.core.exceptions import ValueCheckError

BoxFormat: TypeAlias = Literal["xyxy", "xywh", "cxcywh"]
_FORMATS = get_args(BoxFormat)


def mean_iou_bbox(boxes_1: Tensor, boxes_2: Tensor, box_format: BoxFormat = "xyxy") -> Tensor:
    """Compute the intersection over union of every box of one set with every box of another.

    Args:
        boxes_1: (N, 4); integers are computed in float32.
        boxes_2: (M, 4).
        box_format: 'xyxy' for two corners, 'xywh' for the first corner and the size, 'cxcywh' for center and size.

    Returns:
        (N, M), from 0 to 1; NaN for a box whose width or height is not positive, as boxes are not read on the host.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: a shape is not as in Args.
        ValueCheckError: an unknown box_format.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.mean_iou_bbox(torch.tensor([[0.0, 0.0, 2.0, 2.0]]), torch.tensor([[1.0, 1.0, 2.0, 2.0]]))
        tensor([[0.2500]])
    """
    _check.shape("mean_iou_bbox", "boxes_1", boxes_1, "N", 4)
    _check.shape("mean_iou_bbox", "boxes_2", boxes_2, "M", 4)
    _check.same_device("mean_iou_bbox", boxes_1=boxes_1, boxes_2=boxes_2)
    _check.choice("mean_iou_bbox", "box_format", box_format, _FORMATS)
    a, b = floats(boxes_1), floats(boxes_2)
    dtype = torch.promote_types(a.dtype, b.dtype)
    return _box_iou(a.to(dtype)[None], b.to(dtype)[None], BOX_FORMAT[box_format])[0]


def _reference(a: Tensor, b: Tensor, box_format: int) -> Tensor:
    """The intersections over union (B, N, M) of boxes (B, N, 4) and (B, M, 4)."""
    (low_a, high_a), (low_b, high_b) = _corners(a[:, :, None], box_format), _corners(b[:, None], box_format)
    width, height = (torch.minimum(high_a, high_b) - torch.maximum(low_a, low_b)).clamp(min=0).unbind(-1)
    both = width * height
    return both / (_area(high_a - low_a) + _area(high_b - low_b) - both)


def _corners(boxes: Tensor, box_format: int) -> tuple[Tensor, Tensor]:
    first, second = boxes.split(2, -1)
    if BOX_FORMAT_NAMES[box_format] == "xywh":
        return first, first + second
    return (first - second / 2, first + second / 2) if BOX_FORMAT_NAMES[box_format] == "cxcywh" else (first, second)


def _area(size: Tensor) -> Tensor:
    return torch.where((size > 0).all(-1), size[..., 0] * size[..., 1], torch.nan)


def _reference_backward(grad: Tensor, a: Tensor, b: Tensor, box_format: int) -> Tensor:
    """The gradient to the boxes `a` (B, N, 4)."""
    a = a.expand(max(a.shape[0], b.shape[0], grad.shape[0]), -1, -1)
    return vjp(_reference)(grad, a, b, box_format)


def _backward(needs: Sequence[bool], grad: Tensor, a: Tensor, b: Tensor, box_format: int) -> list[Tensor | None]:
    of_a = _box_iou_backward(grad, a, b, box_format).sum_to_size(a.shape) if needs[0] else None
    of_b = _box_iou_backward(grad.mT, b, a, box_format).sum_to_size(b.shape) if needs[1] else None
    return [of_a, of_b]


def _fake(a: Tensor, b: Tensor, box_format: int) -> tuple[int, int, int]:
    return max(a.shape[0], b.shape[0]), a.shape[1], b.shape[1]


def _fake_backward(grad: Tensor, a: Tensor, b: Tensor, box_format: int) -> tuple[int, int, int]:
    return max(a.shape[0], b.shape[0]), a.shape[1], 4


_box_iou = register("box_iou", _reference, fake=_fake, backward=_backward)
_box_iou_backward = register("box_iou_backward", _reference_backward, fake=_fake_backward)


def mean_average_precision(
    pred_boxes: Sequence[Tensor],
    pred_labels: Sequence[Tensor],
    pred_scores: Sequence[Tensor],
    gt_boxes: Sequence[Tensor],
    gt_labels: Sequence[Tensor],
    n_classes: int,
    threshold: float = 0.5,
) -> tuple[Tensor, dict[int, float]]:
    """Compute the average precision of detections for every class, as Pascal VOC 2007 does, and its mean.

    From the best score on, a detection is right when the true box of its class and image that overlaps it most does so by
    more than the threshold, and no earlier detection had that box. The average is over the recalls 0, 0.1, ..., 1.

    Args:
        pred_boxes: for each image the detected boxes (N, 4) as two corners.
        pred_labels: their classes (N,); 0 is the background, which does not count.
        pred_scores: their scores (N,).
        gt_boxes: for each image the true boxes (M, 4).
        gt_labels: their classes (M,).
        n_classes: how many classes there are, with the background.
        threshold: the overlap that a right detection exceeds.

    Returns:
        The mean over the classes that have a true box, -1 where none has one, and the average precision of each class
        from 1 on, -1 for those without a true box. The dict waits for the device.

    Raises:
        TypeCheckError: an argument is of the wrong type.
        ShapeError: boxes, labels and scores whose sizes differ.
        ValueCheckError: lists of different lengths or without images; a label outside [0, n_classes).

    Source: M. Everingham et al., "The Pascal visual object classes challenge" (2010).

    Example:
        >>> import torch, kvision as K
        >>> boxes, labels = [torch.tensor([[0.0, 0.0, 9.0, 9.0]])], [torch.tensor([1])]
        >>> K.metrics.mean_average_precision(boxes, labels, [torch.tensor([0.7])], boxes, labels, 2)
        (tensor(1.), {1: 1.0})
    """
    op = "mean_average_precision"
    lists = {"pred_boxes": pred_boxes, "pred_labels": pred_labels, "pred_scores": pred_scores}
    lists |= {"gt_boxes": gt_boxes, "gt_labels": gt_labels}
    if len(pred_boxes) == 0 or len({len(values) for values in lists.values()}) != 1:
        got = ", ".join(f"{name} of {len(values)}" for name, values in lists.items())
        raise ValueCheckError(f"{op}: expected an entry of every list for each image, got {got}")
    for detected, labels, scores, true, true_labels in zip(*lists.values()):
        _check.shape(op, "pred_boxes", detected, "N", 4)
        _check.shape(op, "gt_boxes", true, "M", 4)
        for name, values, boxes in (("pred_labels", labels, detected), ("pred_scores", scores, detected)):
            _check.shape(op, name, values, boxes.shape[0])
        _check.shape(op, "gt_labels", true_labels, true.shape[0])
    (n_classes,) = _check.ints(op, "n_classes", n_classes, 1, 2)
    threshold = _check.number(op, "threshold", threshold)

    image, true_image = _images(pred_boxes), _images(gt_boxes)
    label, true_label = torch.cat(list(pred_labels)), torch.cat(list(gt_labels))
    all_labels = torch.cat([label, true_label])
    wrong = ((all_labels < 0) | (all_labels >= n_classes)).any()
    order = torch.cat(list(pred_scores)).argsort(descending=True, stable=True)
    detected, label, image = floats(torch.cat(list(pred_boxes)))[order], label[order], image[order]
    right = _right(
        detected,
        floats(torch.cat(list(gt_boxes))),
        (label[:, None] == true_label) & (image[:, None] == true_image),
        threshold,
    )
    precisions = torch.stack([_average(right, label == c, (true_label == c).sum()) for c in range(1, n_classes)])
    valid = precisions >= 0
    mean = torch.where(valid.any(), precisions.where(valid, 0).sum() / valid.sum().clamp_min(1), -1)
    *averages, is_wrong = torch.cat([precisions, wrong[None]]).tolist()  # the only synchronization with the device
    if is_wrong:
        raise ValueCheckError(f"{op}: expected labels in [0, {n_classes})")
    return mean, dict(enumerate(averages, 1))


def _images(boxes: Sequence[Tensor]) -> Tensor:
    return torch.cat([torch.full((len(b),), i, device=b.device) for i, b in enumerate(boxes)])


def _right(detected: Tensor, true: Tensor, possible: Tensor, threshold: float) -> Tensor:
    """Which detections, in descending order of score, are the first to match their true box."""
    if true.shape[0] == 0:
        return torch.zeros_like(detected[:, 0])
    overlap, box = mean_iou_bbox(detected, true).where(possible, -1).max(1)
    matches = overlap > threshold
    rank = torch.arange(len(detected), device=detected.device)
    none = torch.full_like(true[:, 0], len(detected), dtype=rank.dtype)
    first = none.scatter_reduce(0, box, torch.where(matches, rank, len(detected)), "amin")
    return (matches & (first[box] == rank)).to(detected.dtype)


def _average(right: Tensor, is_class: Tensor, count: Tensor) -> Tensor:
    """The mean over eleven recalls of the best precision with at least that recall; -1 without a true box."""
    hits = (right * is_class).cumsum(0)
    precision = torch.where(is_class, hits / is_class.cumsum(0).clamp_min(1), 0)
    recalls = torch.arange(11, device=right.device, dtype=right.dtype)[:, None] / 10
    reached = torch.where(hits / count.clamp_min(1) >= recalls, precision, 0)
    best = reached.amax(1) if len(right) else recalls[:, 0] * 0
    return torch.where(count > 0, best.mean(), -1)
