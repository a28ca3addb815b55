"""Shared by losses: reduction of a map to a number, and checks and masks of labels."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision._limits import MAX_CLASSES
from kvision._ops import not_empty
from kvision._shared_memory import fitting
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


def reduced(loss: Tensor, reduction: Reduction) -> Tensor:
    """The mean or the sum of a loss, or the loss itself."""
    return loss.mean() if reduction == "mean" else loss.sum() if reduction == "sum" else loss


def check_labels(op: str, pred: Tensor, target: Tensor, images: bool = True) -> None:
    """Raise unless `pred` (B, C, *) are floating-point scores, with `images` (B, C, H, W), and `target` (B, *) their labels."""
    _check.numbers(op, "pred", pred)
    _check.floating(op, "pred", pred)
    _check.numbers(op, "target", target)
    sizes = pred.shape
    if len(sizes) != 4 if images else len(sizes) < 2:
        axes = "(B, C, H, W)" if images else "(B, C, *)"
        raise ShapeError(f"{op}: expected pred of shape {axes}, got {tuple(sizes)}", actual_shape=sizes)
    if sizes[1] < 1:
        raise ShapeError(f"{op}: expected pred with at least one class, got {tuple(sizes)}", actual_shape=sizes)
    expected = (sizes[0], *sizes[2:])
    if target.shape != expected:
        raise ShapeError(
            f"{op}: expected target of shape {expected}, got {tuple(target.shape)}", actual_shape=target.shape
        )
    if target.dtype != torch.int64:
        raise TypeCheckError(
            f"{op}: expected target to hold int64 labels, got {target.dtype}", actual_type=target.dtype
        )
    _check.same_device(op, pred=pred, target=target)


def checked_weight(op: str, name: str, weight: Tensor | None, pred: Tensor) -> Tensor | None:
    """`weight` on the device of `pred`; raise unless it is None or a tensor with a number for each class."""
    if weight is None:
        return None
    _check.shape(op, name, weight, pred.shape[1])
    return _check.to_device_of(op, pred, name, weight, of="pred")


def selected(target: Tensor, classes: int, ignore_index: int | None, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """The labels as indices of `classes`, and the count of each pixel: 1, 0 if ignored, NaN if not a class.

    A label that is no class makes the loss NaN instead of raising an error: reading the labels would wait for their device.
    """
    index = target.clamp(0, classes - 1)
    counts = torch.where(index == target, 1.0, torch.nan).to(dtype)
    return index, counts if ignore_index is None else counts.masked_fill(target == ignore_index, 0)


def segmentation_supports(pred: Tensor, *_: Any) -> str | None:
    """Logits have at least one element and at most 224 classes, or fewer on smaller GPUs."""
    most = fitting(pred, MAX_CLASSES)
    if pred.shape[2] > most:
        return f"there is no kernel for {pred.shape[2]} classes, only for up to {most}"
    return not_empty(pred)


def as_arguments(op: str, ignore_index: int | None) -> tuple[int, bool]:
    """The arguments of operators for the ignored label: its value, and whether there is one."""
    if ignore_index is None:
        return 0, False
    label = _check.scalar(op, "ignore_index", ignore_index)
    if not isinstance(label, (int, float)):
        raise TypeCheckError(f"{op}: expected ignore_index to be an int, got {ignore_index!r}")
    if not -(2**63) <= label < 2**63 or label % 1 != 0:
        raise ValueCheckError(f"{op}: expected ignore_index to be an int of 64 bits, got {ignore_index!r}")
    return int(label), True


def masked(pred: Tensor, counts: Tensor) -> Tensor:
    """Set the scores of ignored pixels to 0, so that not even a NaN of theirs reaches the loss."""
    return pred.masked_fill((counts == 0)[:, None], 0)
