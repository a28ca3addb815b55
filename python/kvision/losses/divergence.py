"""Divergences of probability maps."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision.losses.reduction import reduced
from kvision.metrics.pointwise import sum_of_maps


def kl_div_loss_2d(pred: Tensor, target: Tensor, reduction: Reduction = "mean") -> Tensor:
    """Compute the Kullback-Leibler divergence of predicted probability maps from the true ones.

    It is the sum over the pixels of target * log(target / pred); where target is 0 it adds nothing.

    Args:
        pred: maps (B, N, H, W), each with sum 1.
        target: maps in the same shape.
        reduction: 'none', 'mean' or 'sum', over B and N.

    Returns:
        A number, or for 'none' (B, N).

    Raises:
        TypeCheckError: not two floating-point tensors.
        ShapeError: not (B, N, H, W), or different shapes.
        ValueCheckError: an unknown reduction, which is a NotImplementedError, too.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> pred, target = torch.tensor([[[[0.5, 0.5]]]]), torch.tensor([[[[1.0, 0.0]]]])
        >>> K.losses.kl_div_loss_2d(pred, target)
        tensor(0.6931)
    """
    _check_maps("kl_div_loss_2d", pred, target, reduction)
    return reduced(sum_of_maps("kl", pred, target), reduction).to(pred.dtype)


def js_div_loss_2d(pred: Tensor, target: Tensor, reduction: Reduction = "mean") -> Tensor:
    """Compute the Jensen-Shannon divergence of two probability maps: the mean of their KL divergences from their average.

    Args:
        pred: maps (B, N, H, W), each with sum 1.
        target: maps in the same shape.
        reduction: 'none', 'mean' or 'sum', over B and N.

    Returns:
        A number, or for 'none' (B, N); from 0 to log 2.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`kl_div_loss_2d`.

    Example:
        >>> import torch, kvision as K
        >>> pred, target = torch.tensor([[[[0.0, 1.0]]]]), torch.tensor([[[[1.0, 0.0]]]])
        >>> K.losses.js_div_loss_2d(pred, target)
        tensor(0.6931)
    """
    _check_maps("js_div_loss_2d", pred, target, reduction)
    return reduced(sum_of_maps("js", pred, target), reduction).to(pred.dtype)


def _check_maps(op: str, pred: Tensor, target: Tensor, reduction: Reduction) -> None:
    for name, x in (("pred", pred), ("target", target)):
        _check.shape(op, name, x, "B", "N", "H", "W")
        _check.floating(op, name, x)
    _check.same_shape(op, pred=pred, target=target)
    _check.same_device(op, pred=pred, target=target)
    _check.reduction(op, reduction)
