"""Structural dissimilarity."""

from __future__ import annotations

import math

from torch import Tensor

from kvision import _check
from kvision._choices import Reduction, WindowPadding
from kvision._clamp import clamp
from kvision._dtype import floats
from kvision._modules import IMAGE, VOLUME, FunctionModule
from kvision._ops import with_kernel_casts
from kvision.metrics.ssim import VALID, checked, checked_volumes, dissimilarity, ssim3d_map, ssim_map


@with_kernel_casts
def _dissimilarity(similarity: Tensor) -> Tensor:
    return clamp((1 - similarity) / 2, 0, 1)


def ssim_loss(
    img1: Tensor,
    img2: Tensor,
    window_size: int,
    max_val: float = 1.0,
    eps: float = 1e-12,
    reduction: Reduction = "mean",
    padding: WindowPadding = "same",
) -> Tensor:
    """Compute the structural dissimilarity (1 - ssim) / 2; see :func:`kvision.metrics.ssim`.

    Args:
        img1: image (B, C, H, W); integers are computed in float32.
        img2: image of the same shape; the gradient goes to both.
        window_size: size of the window, odd.
        max_val: largest value that there can be.
        eps: added to both sides of the similarity's fraction.
        reduction: 'none', 'mean' or 'sum'.
        padding: 'same' or 'valid'.

    Returns:
        A number from 0 to 1, or for 'none' a map as that of the similarity.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`kvision.metrics.ssim`; an unknown reduction
            is a NotImplementedError, too.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 1, 8, 8)
        >>> K.losses.ssim_loss(x, x, 5)
        tensor(0.)
    """
    _check.reduction("ssim_loss", reduction)
    if reduction == "none":
        return _dissimilarity(ssim_map("ssim_loss", img1, img2, window_size, max_val, eps, padding))
    arguments = checked("ssim_loss", img1, img2, window_size, max_val, eps, padding)
    return _reduced(img1, img2, window_size, arguments, reduction)


def _reduced(
    x: Tensor, y: Tensor, size: int, arguments: tuple[float, float, float, int], reduction: Reduction
) -> Tensor:
    less = size - 1 if arguments[-1] == VALID else 0
    count = x.shape[0] * x.shape[1]
    for n in x.shape[2:]:
        count *= n - less
    return dissimilarity(floats(x), floats(y), size, *arguments, 0.5, 0.0, _weight(reduction, count))


def _weight(reduction: Reduction, count: int) -> float:
    return 1.0 if reduction == "sum" else 1 / count if count else math.nan


def l1_ssim_loss(
    img1: Tensor,
    img2: Tensor,
    window_size: int = 11,
    ssim_weight: float = 0.2,
    max_val: float = 1.0,
    eps: float = 1e-12,
) -> Tensor:
    """Add absolute differences and structural similarity: (1 - ssim_weight) mean|x - y| + ssim_weight (1 - mean ssim).

    The reconstruction loss of Gaussian splatting, for example. It reads the images once each way and stores no map.

    Args:
        img1: image (B, C, H, W); integers are computed in float32.
        img2: image of the same shape; the gradient goes to both.
        window_size: size of the similarity's window, odd; reflected at the border.
        ssim_weight: weight of the similarity.
        max_val: largest value that there can be.
        eps: added to both sides of the similarity's fraction.

    Returns:
        A number.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`kvision.metrics.ssim`.

    Source: B. Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering" (2023).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 3, 16, 16)
        >>> K.losses.l1_ssim_loss(x, x)
        tensor(0.)
    """
    arguments = checked("l1_ssim_loss", img1, img2, window_size, max_val, eps, "same")
    fraction = _check.number("l1_ssim_loss", "ssim_weight", ssim_weight)
    weight = _weight("mean", img1.numel())
    return dissimilarity(floats(img1), floats(img2), window_size, *arguments, fraction, 1 - fraction, weight)


def ssim3d_loss(
    img1: Tensor,
    img2: Tensor,
    window_size: int,
    max_val: float = 1.0,
    eps: float = 1e-12,
    reduction: Reduction = "mean",
    padding: WindowPadding = "same",
) -> Tensor:
    """Compute the structural dissimilarity (1 - ssim) / 2 of volumes; see :func:`kvision.metrics.ssim3d`.

    Args:
        img1: volume (B, C, D, H, W); integers are computed in float32.
        img2: volume of the same shape.
        window_size: size of the window, odd.
        max_val: largest value that there can be.
        eps: added to both sides of the similarity's fraction.
        reduction: 'none', 'mean' or 'sum'.
        padding: 'same' or 'valid'.

    Returns:
        A number from 0 to 1, or for 'none' a map as that of the similarity.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`ssim_loss`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 1, 6, 7, 8)
        >>> K.losses.ssim3d_loss(x, x, 5)
        tensor(0.)
    """
    _check.reduction("ssim3d_loss", reduction)
    if reduction == "none":
        return _dissimilarity(ssim3d_map("ssim3d_loss", img1, img2, window_size, max_val, eps, padding))
    img1, img2, arguments = checked_volumes("ssim3d_loss", img1, img2, window_size, max_val, eps, padding)
    return _reduced(img1, img2, window_size, arguments, reduction)


class SSIMLoss(FunctionModule):
    """Module form of :func:`ssim_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.SSIMLoss(5)(torch.ones(1, 3, 8, 8), torch.ones(1, 3, 8, 8))
        tensor(0.)
    """

    samples = IMAGE, IMAGE

    def __init__(
        self,
        window_size: int,
        max_val: float = 1.0,
        eps: float = 1e-12,
        reduction: Reduction = "mean",
        padding: WindowPadding = "same",
    ) -> None:
        super().__init__(window_size=window_size, max_val=max_val, eps=eps, reduction=reduction, padding=padding)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return ssim_loss(img1, img2, self.window_size, self.max_val, self.eps, self.reduction, self.padding)


class SSIM3DLoss(FunctionModule):
    """Module form of :func:`ssim3d_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.SSIM3DLoss(3)(torch.ones(1, 1, 4, 5, 6), torch.ones(1, 1, 4, 5, 6))
        tensor(0.)
    """

    samples = VOLUME, VOLUME

    def __init__(
        self,
        window_size: int,
        max_val: float = 1.0,
        eps: float = 1e-12,
        reduction: Reduction = "mean",
        padding: WindowPadding = "same",
    ) -> None:
        super().__init__(window_size=window_size, max_val=max_val, eps=eps, reduction=reduction, padding=padding)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return ssim3d_loss(img1, img2, self.window_size, self.max_val, self.eps, self.reduction, self.padding)


class L1SSIMLoss(FunctionModule):
    """Module form of :func:`l1_ssim_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.L1SSIMLoss()(torch.zeros(1, 3, 16, 16), torch.zeros(1, 3, 16, 16))
        tensor(0.)
    """

    samples = IMAGE, IMAGE

    def __init__(
        self, window_size: int = 11, ssim_weight: float = 0.2, max_val: float = 1.0, eps: float = 1e-12
    ) -> None:
        super().__init__(window_size=window_size, ssim_weight=ssim_weight, max_val=max_val, eps=eps)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return l1_ssim_loss(img1, img2, self.window_size, self.ssim_weight, self.max_val, self.eps)
