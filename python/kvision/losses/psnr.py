"""Peak signal-to-noise ratio as a loss."""

from __future__ import annotations

from torch import Tensor

from kvision._modules import IMAGE, FunctionModule
from kvision.metrics.psnr import decibels_of_ratio


def psnr_loss(image: Tensor, target: Tensor, max_val: float = 1.0) -> Tensor:
    """Compute the negative of :func:`kvision.metrics.psnr`.

    Args:
        image: a tensor of any shape; integers are computed in float32.
        target: another one of the same shape.
        max_val: largest value that there can be, above 0.

    Returns:
        -10 log10(max_val^2 / mean square error) in decibels, a number; minus infinity, with no gradient, for equal
        images.

    Raises:
        TypeCheckError: not two real tensors of one shape.
        ValueCheckError: max_val not above 0.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.psnr_loss(torch.ones(1), 1.2 * torch.ones(1), 2.0)
        tensor(-20.0000)
    """
    return decibels_of_ratio("psnr_loss", image, target, max_val, 10.0)


class PSNRLoss(FunctionModule):
    """Module form of :func:`psnr_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.PSNRLoss(2.0)(torch.ones(1), 1.2 * torch.ones(1))
        tensor(-20.0000)
    """

    samples = IMAGE, IMAGE

    def __init__(self, max_val: float) -> None:
        super().__init__(max_val=max_val)

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        return psnr_loss(image, target, self.max_val)
