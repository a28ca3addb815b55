"""Key.Net: a learned response for key points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, interpolate

from kvision import _check
from kvision.core.exceptions import TypeCheckError
from kvision.feature._weights import Weights, check_weights, load_weights
from kvision.feature.multi_resolution_detector import MultiResolutionDetector, get_default_detector_config
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
        TypeCheckError: images that are not floating-point tensors.

    Source: A. Barroso-Laguna et al., "Key.Net: Keypoint detection by handcrafted and learned CNN filters" (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.KeyNet(pretrained=False).eval()(torch.rand(1, 1, 32, 48)).shape
        torch.Size([1, 1, 32, 48])
    """

    def __init__(self, pretrained: Weights = True, keynet_conf: dict[str, Any] | None = None) -> None:
        super().__init__()
        if keynet_conf is not None and not isinstance(keynet_conf, Mapping):
            raise TypeCheckError(f"KeyNet: expected keynet_conf to be a dict, got {type(keynet_conf).__name__}")
        config = {**KEYNET_CONFIG, **(keynet_conf or {})}
        filters, levels, kernel_size = (_check.ints("KeyNet", name, config[name], 1)[0] for name in KEYNET_CONFIG)
        self.num_levels = levels
        self.feature_extractor = _FeatureExtractor(filters, kernel_size)
        convolution = nn.Conv2d(filters * levels, 1, kernel_size, padding=kernel_size // 2)
        self.last_conv = nn.Sequential(convolution, nn.ReLU())
        load_weights(self, pretrained)

    def forward(self, x: Tensor) -> Tensor:
        _check.images("KeyNet", "x", x)
        _check.shape("KeyNet", "x", x, "B", 1, "H", "W")
        _check.floating("KeyNet", "x", x)
        check_weights("KeyNet", self, x)
        size, maps = x.shape[2:], []
        for level in range(self.num_levels):
            x = pyrdown(x, factor=1.2) if level else x
            features = self.feature_extractor(x)
            maps.append(interpolate(features, size, mode="bilinear", align_corners=False) if level else features)
        return self._combine(maps)

    def _combine(self, maps: list[Tensor]) -> Tensor:
        convolution = self.last_conv[0]
        if not maps[0].is_cpu or not isinstance(convolution, nn.Conv2d):
            response: Tensor = self.last_conv(torch.cat(maps, 1))
            return response
        # On the CPU torch takes 1.7 times as long, and much more memory, for the channels of all levels together.
        weights = convolution.weight.chunk(len(maps), 1)
        response = conv2d(maps[0], weights[0], convolution.bias, padding=convolution.padding)
        for x, weight in zip(maps[1:], weights[1:]):
            response = response + conv2d(x, weight, padding=convolution.padding)
        return torch.relu(response)


class KeyNetDetector(MultiResolutionDetector):
    """Detect features at the maxima of Key.Net's response on an image and on larger and smaller copies of it.

    Args:
        pretrained: weights of the response, as in `HardNet`.
        num_features: slots of each image, at least 1.
        keynet_conf: the dict of `KeyNet`, which may have "Detector_conf", the config of `MultiResolutionDetector`.
        ori_module: gives frames an orientation, such as LAFOrienter; None for no change.
        aff_module: gives frames an affine shape, such as LAFAffNetShapeEstimator; None for no change.
        compile_model: torch.compile the response and the suppression of pixels that are no maxima.
        score_threshold: responses of features are above it; not negative.

    Its call takes gray images (B, 1, H, W) and a mask, and returns frames (B, num_features, 2, 3) and responses
    (B, num_features), as `MultiResolutionDetector` does.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of the response.
        ShapeError: another shape of an image or of a mask.
        ValueCheckError: `num_features` is below 1, or `score_threshold` negative.

    Example:
        >>> import torch, kvision as K
        >>> detector = K.feature.KeyNetDetector(pretrained=False, num_features=10).eval()
        >>> lafs, responses = detector(torch.rand(1, 1, 64, 80))
        >>> lafs.shape, responses.shape
        (torch.Size([1, 10, 2, 3]), torch.Size([1, 10]))
    """

    def __init__(
        self,
        pretrained: Weights = True,
        num_features: int = 2048,
        keynet_conf: dict[str, Any] | None = None,
        ori_module: nn.Module | None = None,
        aff_module: nn.Module | None = None,
        compile_model: bool = False,
        score_threshold: float = 0.0,
    ) -> None:
        network = KeyNet(False, keynet_conf)
        config = (keynet_conf or {}).get("Detector_conf", get_default_detector_config())
        super().__init__(network, num_features, config, ori_module, aff_module, compile_model, score_threshold)
        load_weights(network, pretrained)  # at last, since it may be a download
