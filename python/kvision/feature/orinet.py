"""OriNet: learned orientations of patches."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision.feature._weights import Weights, load_weights
from kvision.feature.hardnet import PATCH_SIZE, check_patches, convolutions, standardized

# The layers that AffNet and OriNet have in common: those of L2-Net with half of the channels.
HALF_L2NET = ((1, 16, 1), (16, 16, 1), (16, 32, 2), (32, 32, 1), (32, 64, 2), (64, 64, 1))


class OriNet(nn.Module):
    """Estimate the orientations of patches (B, 1, 32, 32) in radians, (B,): OriNet.

    Args:
        pretrained: as in `HardNet`.
        eps: added to the components of the direction, so that the gradient is finite where both are 0.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: patches of another shape.
        TypeCheckError: patches that are not floating-point tensors.

    Source: D. Mishkin, F. Radenovic, J. Matas, "Repeatability is not enough: Learning affine regions via discriminability"
    (2018).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.OriNet(pretrained=False).eval()(torch.rand(2, 1, 32, 32)).shape
        torch.Size([2])
    """

    patch_size = PATCH_SIZE

    def __init__(self, pretrained: Weights = True, eps: float = 1e-8) -> None:
        super().__init__()
        self.features = nn.Sequential(
            *convolutions(*HALF_L2NET),
            nn.Dropout(0.25),
            nn.Conv2d(64, 2, 8, padding=1),
            nn.Tanh(),
            nn.AdaptiveAvgPool2d(1),
        )
        self.eps = _check.number("OriNet", "eps", eps)
        load_weights(self, pretrained)

    def forward(self, patch: Tensor) -> Tensor:
        check_patches(self, patch)
        y, x = self.features(standardized(patch)).flatten(1).unbind(1)
        return torch.atan2(y + self.eps, x + self.eps)
