"""Lovász losses: the Jaccard index, 1 - intersection / union, made convex in the errors of the pixels."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._modules import IMAGE, LABELS, PLANE, FunctionModule
from kvision._ops import not_empty, register, vjp
from kvision.core.exceptions import ShapeError
from kvision.losses.reduction import check_labels, checked_weight, selected


def _reference(pred: Tensor, target: Tensor, hinge: bool) -> tuple[Tensor, Tensor]:
    """(B, C): the Lovász extension of the Jaccard loss for the errors of logits (B, C, H, W), for every class; and
    (B, C, H, W): its gradients by the errors. With `hinge` there is one class with label 1; 0 is the background."""
    promoted = pred.to(compute_dtype(pred)).flatten(2)
    first, classes = (1, 2) if hinge else (0, pred.shape[1])
    target = target.expand(pred.shape[0], -1, -1).flatten(1).long()
    index, counts = selected(target, classes, None, promoted.dtype)
    inside = index[:, None] == torch.arange(first, classes, device=pred.device)[:, None]
    labels = inside.to(promoted.dtype)
    errors = (1 - promoted * (2 * labels - 1)).relu() if hinge else (labels - promoted.softmax(1)).abs()
    errors, order = (errors * counts[:, None]).sort(dim=-1, stable=True, descending=True)
    gradient = _lovasz_gradient(labels.gather(-1, order))
    return (errors * gradient).sum(-1), torch.zeros_like(gradient).scatter(-1, order, gradient).view(pred.shape)


def _lovasz_gradient(labels: Tensor) -> Tensor:
    """The increase of the Jaccard loss by each pixel over the pixels before it; `labels` are 1 in the region, or 0."""
    inside = labels.cumsum(-1)
    region, size = inside[..., -1:], torch.arange(1, labels.shape[-1] + 1, device=labels.device, dtype=labels.dtype)
    jaccard = 1 - (region - inside) / (region + size - inside)
    return torch.cat([jaccard[..., :1], jaccard.diff(dim=-1)], -1)


def _fake(pred: Tensor, *_: Any) -> list[Any]:
    dtype = compute_dtype(pred)
    return [pred.new_empty(pred.shape[:2], dtype=dtype), pred.new_empty(pred.shape, dtype=dtype)]


def _backward_reference(grad: Tensor, gradient: Tensor, pred: Tensor, *args: Any) -> Tensor:
    return vjp(lambda pred: _reference(pred, *args)[0])(grad, pred)


register(
    "lovasz_backward",
    _backward_reference,
    fake=lambda grad, gradient, pred, *_: torch.empty_like(pred, memory_format=torch.contiguous_format),
    casts_outputs=True,
)
_lovasz = register(
    "lovasz",
    _reference,
    fake=_fake,
    gradients="pred: lovasz_backward(gradients=result1)",
    non_differentiable=(1,),
    casts_outputs=True,
    supports=not_empty,
)


def _losses(pred: Tensor, target: Tensor, hinge: bool) -> Tensor:
    """The losses (B, C), in the computing type."""
    return _lovasz(pred, target, hinge)[0]


def lovasz_hinge_loss(pred: Tensor, target: Tensor) -> Tensor:
    """Compute the binary Lovász hinge loss of every image, and their mean.

    Args:
        pred: logits (B, 1, H, W), positive inside of the region.
        target: (B, H, W), 1 inside of the region and 0 elsewhere, of any type. Another label makes the loss NaN.

    Returns:
        A number.

    Raises:
        TypeCheckError: pred is not a floating-point tensor, target not a tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: J. Yu, M. Blaschko, "The Lovász hinge" (2015).

    Example:
        >>> import torch, kvision as K
        >>> logits = torch.tensor([[[[2.0, 0.0], [-2.0, -2.0]]]])
        >>> K.losses.lovasz_hinge_loss(logits, torch.tensor([[[1, 1], [0, 0]]]))
        tensor(0.5000)
    """
    _check.shape("lovasz_hinge_loss", "pred", pred, "B", 1, "H", "W")
    _check.floating("lovasz_hinge_loss", "pred", pred)
    b, _, h, w = pred.shape
    _check.shape("lovasz_hinge_loss", "target", target, b, h, w)
    _check.same_device("lovasz_hinge_loss", pred=pred, target=target)
    labels = target if target.dtype == torch.int64 else target.to(torch.uint8)
    return as_dtype(_losses(pred, labels, True).mean(), pred.dtype)


def lovasz_softmax_loss(pred: Tensor, target: Tensor, weight: Tensor | None = None) -> Tensor:
    """Compute the Lovász softmax loss: of every class in every image, and their mean.

    Args:
        pred: logits (B, C, H, W) of at least two classes.
        target: labels (B, H, W) in [0, C), int64. Another label makes the loss NaN, as labels are not read on the host.
        weight: factors of the classes (C,).

    Returns:
        A number.

    Raises:
        TypeCheckError: pred is not a floating-point tensor or target not int64.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: M. Berman et al., "The Lovász-softmax loss" (2018).

    Example:
        >>> import torch, kvision as K
        >>> K.losses.lovasz_softmax_loss(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """
    check_labels("lovasz_softmax_loss", pred, target)
    if pred.shape[1] < 2:
        raise ShapeError(
            f"lovasz_softmax_loss: expected pred of at least 2 classes, got {tuple(pred.shape)}",
            actual_shape=pred.shape,
        )
    weight = checked_weight("lovasz_softmax_loss", "weight", weight, pred)
    losses = _losses(pred, target, False)
    if weight is not None:
        losses = losses.mean(0) * weight
    return as_dtype(losses.mean(), pred.dtype)


class LovaszHingeLoss(FunctionModule):
    """Module form of :func:`lovasz_hinge_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.LovaszHingeLoss()(torch.zeros(1, 1, 2, 2), torch.ones(1, 2, 2))
        tensor(1.)
    """

    samples = PLANE, LABELS

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return lovasz_hinge_loss(pred, target)


class LovaszSoftmaxLoss(FunctionModule):
    """Module form of :func:`lovasz_softmax_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.LovaszSoftmaxLoss()(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """

    samples = IMAGE, LABELS

    def __init__(self, weight: Tensor | None = None) -> None:
        super().__init__(weight=weight)

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return lovasz_softmax_loss(pred, target, self.weight)
