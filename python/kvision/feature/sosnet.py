"""SOSNet: learned descriptors of patches."""

from __future__ import annotations

from torch import Tensor, nn

from kvision.feature._weights import Weights, load_weights
from kvision.feature.hardnet import L2NET, PATCH_SIZE, check_patches, convolutions


def unit_length(dimensions: int) -> nn.LocalResponseNorm:
    """Divides (B, dimensions, 1, 1) by their lengths: a window twice as wide as the number of channels contains all of them."""
    return nn.LocalResponseNorm(2 * dimensions, alpha=2 * dimensions, beta=0.5, k=0)


class SOSNet(nn.Module):
    """Describe patches (B, 1, 32, 32) by (B, 128) unit vectors: SOSNet, trained with second-order similarity.

    Args:
        pretrained: as in `HardNet`.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: patches of another shape.
        TypeCheckError: patches that are not floating-point tensors.

    Source: Y. Tian et al., "SOSNet: Second order similarity regularization for local descriptor learning" (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.SOSNet(pretrained=False).eval()(torch.rand(2, 1, 32, 32)).shape
        torch.Size([2, 128])
    """

    patch_size = PATCH_SIZE

    def __init__(self, pretrained: Weights = True) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.InstanceNorm2d(1),
            *convolutions(*L2NET),
            nn.Dropout(0.1),
            nn.Conv2d(128, 128, 8, bias=False),
            nn.BatchNorm2d(128, affine=False),
        )
        self.desc_norm = nn.Sequential(unit_length(128))
        load_weights(self, pretrained)

    def forward(self, input: Tensor, eps: float = 1e-10) -> Tensor:
        check_patches(self, input)
        return self.desc_norm(self.layers(input) + eps).flatten(1)
