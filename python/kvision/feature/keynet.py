"""Key.Net: a learned response for key points."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from kvision import _check
from kvision.feature._weights import Weights, load_weights
from kvision.filters import spatial_gradient
from kvision.geometry.transform import pyrdown

KEYNET_CONFIG: dict[str, Any] = {"num_filters": 8, "num_levels": 3, "kernel_size": 5}


class _HandcraftedBlock(nn.Module):
    """Products of first and second derivatives, as Harris' and Hessian detectors have them: (B, 1, H, W) to (B, 10, H, W)."""

    def forward(self, x: Tensor) -> Tensor:
        dx, dy = spatial_gradient(x).unbind(2)
        dxx, dxy = spatial_gradient(dx).unbind(2)
        dyy = spatial_gradient(dy)[:, :, 1]
        products = (dx, dy, dx * dx, dy * dy, dx * dy, dxy, dxy * dxy, dxx, dyy, dxx * dyy)
        return torch.cat(products, 1)


class _LearnableBlock(nn.Module):
    def __init__(self, filters: int, kernel_size: int) -> None:
        super().__init__()

        def block(channels: int) -> nn.Sequential:
            convolution = nn.Conv2d(channels, filters, kernel_size, padding=kernel_size // 2)
            return nn.Sequential(convolution, nn.BatchNorm2d(filters), nn.ReLU())

        self.conv0, self.conv1, self.conv2 = block(10), block(filters), block(filters)

    def forward(self, x: Tensor) -> Tensor:
        return self.conv2(self.conv1(self.conv0(x)))


class _FeatureExtractor(nn.Module):
    def __init__(self, filters: int, kernel_size: int) -> None:
        super().__init__()
        self.hc_block, self.lb_block = _HandcraftedBlock(), _LearnableBlock(filters, kernel_size)

    def forward(self, x: Tensor) -> Tensor:
        return self.lb_block(self.hc_block(x))


class KeyNet(nn.Module):
    """Map gray images (B, 1, H, W) to responses (B, 1, H, W) that are high where key points are: Key.Net.

    Handcrafted derivatives of the image at three scales, 1.2 apart, go through the same learned filters; the maps are
    resized and combined. The response is at least 0.

    Args:
        pretrained: as in `HardNet`.
        keynet_conf: a dict with "num_filters", "num_levels" and "kernel_size", of which others than the defaults 8, 3 and 5
            need other weights.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: images of another shape.
        TypeCheckError: images that are no floating-point tensor.

    Source: A. Barroso-Laguna et al., "Key.Net: Keypoint detection by handcrafted and learned CNN filters" (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.KeyNet(pretrained=False).eval()(torch.rand(1, 1, 32, 48)).shape
        torch.Size([1, 1, 32, 48])
    """

    def __init__(self, pretrained: Weights = True, keynet_conf: dict[str, Any] | None = None) -> None:
        super().__init__()
        config = {**KEYNET_CONFIG, **(keynet_conf or {})}
        filters, levels, kernel_size = (config[name] for name in KEYNET_CONFIG)
        self.num_levels = levels
        self.feature_extractor = _FeatureExtractor(filters, kernel_size)
        convolution = nn.Conv2d(filters * levels, 1, kernel_size, padding=kernel_size // 2)
        self.last_conv = nn.Sequential(convolution, nn.ReLU())
        load_weights(self, pretrained)

    def forward(self, x: Tensor) -> Tensor:
        _check.images("KeyNet", "x", x)
        _check.shape("KeyNet", "x", x, "B", 1, "H", "W")
        _check.floating("KeyNet", "x", x)
        size, maps = x.shape[2:], []
        for level in range(self.num_levels):
            x = pyrdown(x, factor=1.2) if level else x
            features = self.feature_extractor(x)
            maps.append(interpolate(features, size, mode="bilinear", align_corners=False) if level else features)
        return self.last_conv(torch.cat(maps, 1))
