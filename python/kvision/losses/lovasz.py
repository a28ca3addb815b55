"""Lovász losses: the Jaccard index, 1 - intersection / union, made convex in the errors of the pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision._ops import as_stored
from kvision.core.exceptions import ShapeError
from kvision.losses.reduction import check_labels, check_weight, selected


def _extension(errors: Tensor, labels: Tensor) -> Tensor:
    """The Lovász extension of the Jaccard loss along the last axis: errors from the largest on, each times what its pixel
    adds to the loss of the set of those before it. `labels` are 1 in the region and 0 elsewhere."""
    errors, order = errors.sort(-1, descending=True)
    inside = labels.gather(-1, order).cumsum(-1)
    region, size = inside[..., -1:], torch.arange(1, labels.shape[-1] + 1, device=labels.device, dtype=labels.dtype)
    jaccard = 1 - (region - inside) / (region + size - inside)
    return (errors * torch.cat([jaccard[..., :1], jaccard.diff(dim=-1)], -1)).sum(-1)


def lovasz_hinge_loss(pred: Tensor, target: Tensor) -> Tensor:
    """Compute the binary Lovász hinge loss of every image, and their mean.

    Args:
        pred: logits (B, 1, H, W), positive inside of the region.
        target: (B, H, W), 1 inside of the region and 0 elsewhere, of any type.

    Returns:
        A number.

    Raises:
        TypeCheckError: pred is no floating-point tensor, target no tensor.
        ShapeError: other shapes.
        DeviceError: tensors on different devices.

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
    return _hinge(pred, target)


@as_stored
def _hinge(pred: Tensor, target: Tensor) -> Tensor:
    labels = target.flatten(1).to(pred.dtype)
    errors = 1 - pred.flatten(1) * (2 * labels - 1)
    return _extension(errors.relu(), labels).mean()


def lovasz_softmax_loss(pred: Tensor, target: Tensor, weight: Tensor | None = None) -> Tensor:
    """Compute the Lovász softmax loss: of every class in every image, and their mean.

    Args:
        pred: logits (B, C, H, W) of at least two classes.
        target: labels (B, H, W) in [0, C), int64. Another label makes the loss NaN, as labels are not read on the host.
        weight: factors of the classes (C,).

    Returns:
        A number.

    Raises:
        TypeCheckError: pred is no floating-point tensor or target not int64.
        ShapeError: other shapes.
        DeviceError: tensors on different devices.

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
    check_weight("lovasz_softmax_loss", "weight", weight, pred)
    return _lovasz_softmax(pred, weight, target)


@as_stored
def _lovasz_softmax(pred: Tensor, weight: Tensor | None, target: Tensor) -> Tensor:
    index, counts = selected(target.flatten(1), pred.shape[1], None, pred.dtype)
    own = index[:, None] == torch.arange(pred.shape[1], device=pred.device)[:, None]
    errors = (own.to(pred.dtype) - pred.flatten(2).softmax(1)).abs() * counts[:, None]
    loss = _extension(errors, own.to(pred.dtype)).mean(0)
    return (loss if weight is None else loss * weight).mean()


class LovaszHingeLoss(FunctionModule):
    """Module form of :func:`lovasz_hinge_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.LovaszHingeLoss()(torch.zeros(1, 1, 2, 2), torch.ones(1, 2, 2))
        tensor(1.)
    """

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return lovasz_hinge_loss(pred, target)


class LovaszSoftmaxLoss(FunctionModule):
    """Module form of :func:`lovasz_softmax_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.LovaszSoftmaxLoss()(torch.zeros(1, 2, 2, 2), torch.tensor([[[0, 0], [1, 1]]]))
        tensor(0.5000)
    """

    def __init__(self, weight: Tensor | None = None) -> None:
        super().__init__(weight=weight)

    def forward(self, pred: Tensor, target: Tensor) -> Tensor:
        return lovasz_softmax_loss(pred, target, self.weight)
