"""HardNet and HardNet8: learned descriptors of patches."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

from kvision import _check
from kvision.feature._weights import Weights, check_weights, load_weights

PATCH_SIZE = 32


def check_patches(network: nn.Module, x: Tensor) -> None:
    """Raise unless `x` is a batch of gray 32 x 32 patches of the type of a network's weights."""
    op = type(network).__name__
    _check.shape(op, "input", x, "B", 1, PATCH_SIZE, PATCH_SIZE)
    _check.floating(op, "input", x)
    check_weights(op, network, x)


def standardized(patches: Tensor, eps: float = 1e-6) -> Tensor:
    """Every patch with mean 0 and, unless it is constant, standard deviation 1, in the layout that convolutions read best."""
    deviation, mean = torch.std_mean(patches, (1, 2, 3), keepdim=True)
    x = (patches - mean.detach()) / (deviation.detach() + eps)
    # On the CPU torch's float32 convolutions reorder images of other layouts, before and after each layer.
    return x.to(memory_format=torch.channels_last) if x.is_cpu and x.dtype == torch.float32 else x


def convolutions(*layers: tuple[int, int, int], **norm: bool) -> list[nn.Module]:
    """3 x 3 convolutions (channels in, out, stride), each with batch normalization and ReLU."""
    modules: list[nn.Module] = []
    for channels, out_channels, stride in layers:
        convolution = nn.Conv2d(channels, out_channels, 3, stride=stride, padding=1, bias=False)
        modules += [convolution, nn.BatchNorm2d(out_channels, affine=False), nn.ReLU()]
    return modules


# The layers that HardNet, HardNet8 and SOSNet have in common; they are those of L2-Net.
L2NET = ((1, 32, 1), (32, 32, 1), (32, 64, 2), (64, 64, 1), (64, 128, 2), (128, 128, 1))


class HardNet(nn.Module):
    """Describe patches (B, 1, 32, 32) by (B, 128) unit vectors: HardNet.

    A patch is standardized first, so brightness and contrast do not matter. The gradient goes to the patch through the
    network, with mean and deviation of the patch as constants.

    Args:
        pretrained: True for the published weights, which torch.hub downloads once; the path of a file; a state dict; False
            for random weights.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: patches of another shape.
        TypeCheckError: patches that are not floating-point tensors.

    Source: A. Mishchuk et al., "Working hard to know your neighbor's margins: Local descriptor learning loss" (2017).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.HardNet(pretrained=False).eval()(torch.rand(2, 1, 32, 32)).shape
        torch.Size([2, 128])
    """

    patch_size = PATCH_SIZE

    def __init__(self, pretrained: Weights = True) -> None:
        super().__init__()
        self.features = nn.Sequential(
            *convolutions(*L2NET),
            nn.Dropout(0.3),
            nn.Conv2d(128, 128, 8, bias=False),
            nn.BatchNorm2d(128, affine=False),
        )
        load_weights(self, pretrained)

    def forward(self, input: Tensor) -> Tensor:
        check_patches(self, input)
        return normalize(self.features(standardized(input)).flatten(1))


class HardNet8(nn.Module):
    """Describe patches (B, 1, 32, 32) by (B, 128) unit vectors: HardNet of 8 layers, 512 numbers reduced by PCA.

    A patch is standardized first, so brightness and contrast do not matter.

    Args:
        pretrained: as in `HardNet`.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: patches of another shape.
        TypeCheckError: patches that are not floating-point tensors.

    Source: M. Pultar, "Improving the HardNet descriptor" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.HardNet8(pretrained=False).eval()(torch.rand(2, 1, 32, 32)).shape
        torch.Size([2, 128])
    """

    patch_size = PATCH_SIZE
    mean: Tensor
    components: Tensor

    def __init__(self, pretrained: Weights = True) -> None:
        super().__init__()
        layers = (*L2NET, (128, 256, 1))
        self.features = nn.Sequential(
            *convolutions(*layers),
            nn.Dropout(0.3),
            nn.Conv2d(256, 512, 8, bias=False),
            nn.BatchNorm2d(512, affine=False),
        )
        for module in self.features:
            if isinstance(module, nn.Conv2d):
                nn.init.orthogonal_(module.weight, gain=0.6)
        self.register_buffer("components", torch.eye(512, 128))
        self.register_buffer("mean", torch.zeros(512))
        load_weights(self, pretrained)

    def forward(self, input: Tensor) -> Tensor:
        check_patches(self, input)
        x = normalize(self.features(standardized(input, 1e-7)).flatten(1))
        return normalize((x - self.mean) @ self.components)
