"""TFeat: shallow learned descriptors of patches."""

from __future__ import annotations

from torch import Tensor, nn

from kvision.feature._weights import Weights, load_weights
from kvision.feature.hardnet import PATCH_SIZE, check_patches


class TFeat(nn.Module):
    """Describe patches (B, 1, 32, 32) by (B, 128) numbers in (-1, 1): TFeat, two convolutions trained on triplets.

    Descriptors are compared by Euclidean distance; they have no unit length.

    Args:
        pretrained: as in `HardNet`.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: patches of another shape.
        TypeCheckError: patches that are not floating-point tensors.

    Source: V. Balntas et al., "Learning local feature descriptors with triplets and shallow convolutional neural networks"
    (2016).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.TFeat(pretrained=False)(torch.rand(2, 1, 32, 32)).shape
        torch.Size([2, 128])
    """

    patch_size = PATCH_SIZE

    def __init__(self, pretrained: Weights = True) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.InstanceNorm2d(1), nn.Conv2d(1, 32, 7), nn.Tanh(), nn.MaxPool2d(2), nn.Conv2d(32, 64, 6), nn.Tanh()
        )
        self.descr = nn.Sequential(nn.Linear(64 * 8 * 8, 128), nn.Tanh())
        load_weights(self, pretrained)

    def forward(self, input: Tensor) -> Tensor:
        check_patches(self, input)
        return self.descr(self.features(input).flatten(1))
