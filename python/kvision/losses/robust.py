"""Robust losses of differences, which reduce the influence of outliers."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision._modules import IMAGE, FunctionModule
from kvision.metrics.pointwise import pointwise


def charbonnier_loss(img1: Tensor, img2: Tensor, reduction: Reduction | None = "none") -> Tensor:
    """Compute the Charbonnier loss sqrt(d^2 + 1) - 1 of differences d.

    Args:
        img1: a tensor of any shape.
        img2: another one of the same shape.
        reduction: 'none', 'mean' or 'sum'; None is 'none'.

    Returns:
        A number, or for 'none' the loss of every element.

    Raises:
        TypeCheckError: not two floating-point tensors.
        ShapeError: different shapes.
        ValueCheckError: an unknown reduction, which is a NotImplementedError, too.
        DeviceError: the tensors are on different devices.

    Source: J. T. Barron, "A general and adaptive robust loss function" (2019), as the other three.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.charbonnier_loss(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor([0.0000, 2.1623])
    """
    return _loss("charbonnier", img1, img2, reduction)


def welsch_loss(img1: Tensor, img2: Tensor, reduction: Reduction | None = "none") -> Tensor:
    """Compute the Welsch loss 1 - exp(-d^2 / 2) of differences d.

    Args:
        img1: a tensor of any shape.
        img2: another one of the same shape.
        reduction: 'none', 'mean' or 'sum'; None is 'none'.

    Returns:
        A number, or for 'none' the loss of every element.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`charbonnier_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.welsch_loss(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor([0.0000, 0.9889])
    """
    return _loss("welsch", img1, img2, reduction)


def cauchy_loss(img1: Tensor, img2: Tensor, reduction: Reduction | None = "none") -> Tensor:
    """Compute the Cauchy loss log(d^2 / 2 + 1) of differences d.

    Args:
        img1: a tensor of any shape.
        img2: another one of the same shape.
        reduction: 'none', 'mean' or 'sum'; None is 'none'.

    Returns:
        A number, or for 'none' the loss of every element.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`charbonnier_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.cauchy_loss(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor([0.0000, 1.7047])
    """
    return _loss("cauchy", img1, img2, reduction)


def geman_mcclure_loss(img1: Tensor, img2: Tensor, reduction: Reduction | None = "none") -> Tensor:
    """Compute the Geman-McClure loss 2 d^2 / (d^2 + 4) of differences d.

    Args:
        img1: a tensor of any shape.
        img2: another one of the same shape.
        reduction: 'none', 'mean' or 'sum'; None is 'none'.

    Returns:
        A number, or for 'none' the loss of every element.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`charbonnier_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.geman_mcclure_loss(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor([0.0000, 1.3846])
    """
    return _loss("geman_mcclure", img1, img2, reduction)


def _loss(kind: str, img1: Tensor, img2: Tensor, reduction: Reduction | None) -> Tensor:
    op = f"{kind}_loss"
    reduction = "none" if reduction is None else reduction
    for name, x in (("img1", img1), ("img2", img2)):
        _check.numbers(op, name, x)
        _check.floating(op, name, x)
    _check.same_shape(op, img1=img1, img2=img2)
    _check.same_device(op, img1=img1, img2=img2)
    _check.reduction(op, reduction)
    return pointwise(kind, img1, img2, reduction)


class CharbonnierLoss(FunctionModule):
    """Module form of :func:`charbonnier_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.CharbonnierLoss("mean")(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor(1.0811)
    """

    samples = IMAGE, IMAGE

    def __init__(self, reduction: Reduction | None = "none") -> None:
        super().__init__(reduction=reduction)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return charbonnier_loss(img1, img2, self.reduction)


class WelschLoss(FunctionModule):
    """Module form of :func:`welsch_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.WelschLoss("mean")(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor(0.4944)
    """

    samples = IMAGE, IMAGE

    def __init__(self, reduction: Reduction | None = "none") -> None:
        super().__init__(reduction=reduction)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return welsch_loss(img1, img2, self.reduction)


class CauchyLoss(FunctionModule):
    """Module form of :func:`cauchy_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.CauchyLoss("mean")(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor(0.8524)
    """

    samples = IMAGE, IMAGE

    def __init__(self, reduction: Reduction | None = "none") -> None:
        super().__init__(reduction=reduction)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return cauchy_loss(img1, img2, self.reduction)


class GemanMcclureLoss(FunctionModule):
    """Module form of :func:`geman_mcclure_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.GemanMcclureLoss("mean")(torch.tensor([0.0, 3.0]), torch.zeros(2))
        tensor(0.6923)
    """

    samples = IMAGE, IMAGE

    def __init__(self, reduction: Reduction | None = "none") -> None:
        super().__init__(reduction=reduction)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return geman_mcclure_loss(img1, img2, self.reduction)
