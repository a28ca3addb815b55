"""Error of optical flow."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import FunctionModule
from kvision._ops import as_stored
from kvision.core.exceptions import ShapeError


def aepe(input: Tensor, target: Tensor, reduction: str = "mean") -> Tensor:
    """Compute the average end-point error: the distance of flow vectors from the true ones.

    Args:
        input: flow (*, 2); integers are computed in float32.
        target: true flow in the same shape.
        reduction: 'mean', 'sum' or 'none'.

    Returns:
        A number, or for 'none' (*).

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: not (*, 2), or different shapes.
        ValueCheckError: an unknown reduction, which is a NotImplementedError, too.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.aepe(torch.zeros(4, 3, 2), torch.tensor([3.0, 4.0]).expand(4, 3, 2))
        tensor(5.)
    """
    _check.numbers("aepe", "input", input)
    _check.numbers("aepe", "target", target)
    if input.dim() == 0 or input.shape[-1] != 2:
        raise ShapeError(f"aepe: expected input of shape (*, 2), got {tuple(input.shape)}", actual_shape=input.shape)
    _check.same_shape("aepe", input=input, target=target)
    _check.same_device("aepe", input=input, target=target)
    _check.reduction("aepe", reduction)
    return _aepe(floats(input), floats(target), reduction)


@as_stored
def _aepe(input: Tensor, target: Tensor, reduction: str) -> Tensor:
    tiny = torch.finfo(input.dtype).tiny  # at 0 the root has no slope; that of this even power of 2 is exact
    error = (input - target).square().sum(-1).add(tiny).sqrt() - tiny**0.5
    return error.mean() if reduction == "mean" else error.sum() if reduction == "sum" else error


average_endpoint_error = aepe


class AEPE(FunctionModule):
    """Module form of :func:`aepe`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.AEPE("sum")(torch.zeros(4, 2), torch.ones(4, 2))
        tensor(5.6569)
    """

    def __init__(self, reduction: str = "mean") -> None:
        super().__init__(reduction=reduction)

    def forward(self, input: Tensor, target: Tensor) -> Tensor:
        return aepe(input, target, self.reduction)
