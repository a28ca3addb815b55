"""HyNet: learned descriptors of patches, with normalization by filter responses."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision.core.exceptions import ValueCheckError
from kvision.feature._weights import Weights, load_weights
from kvision.feature.hardnet import PATCH_SIZE, check_patches
from kvision.feature.sosnet import unit_length


class FilterResponseNorm2d(nn.Module):
    """Divide each channel (B, C, H, W) by the root mean square of its pixels, then scale and shift it.

    Args:
        num_features: C.
        eps: added to the mean square.
        is_bias: whether to shift.
        is_scale: whether to scale.
        is_eps_leanable: whether eps is a parameter. The name is Kornia's.

    Source: S. Singh, S. Krishnan, "Filter response normalization layer" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.FilterResponseNorm2d(1)(torch.full((1, 1, 2, 2), 3.0)).flatten().tolist()
        [0.9999999403953552, 0.9999999403953552, 0.9999999403953552, 0.9999999403953552]
    """

    weight: Tensor
    bias: Tensor
    eps: Tensor

    def __init__(
        self,
        num_features: int,
        eps: float = 1e-6,
        is_bias: bool = True,
        is_scale: bool = True,
        is_eps_leanable: bool = False,
    ) -> None:
        super().__init__()
        (self.num_features,) = _check.ints("FilterResponseNorm2d", "num_features", num_features, 1)
        self.init_eps = _check.number("FilterResponseNorm2d", "eps", eps, 0.0)
        is_bias = _check.switch("FilterResponseNorm2d", "is_bias", is_bias)
        is_scale = _check.switch("FilterResponseNorm2d", "is_scale", is_scale)
        is_eps_leanable = _check.switch("FilterResponseNorm2d", "is_eps_leanable", is_eps_leanable)
        self.is_bias, self.is_scale, self.is_eps_leanable = is_bias, is_scale, is_eps_leanable
        shape = (1, num_features, 1, 1)
        # What is not learned is a buffer, so that the state dict has the same keys; it is not applied.
        for name, value, is_learned in (("weight", 1.0, is_scale), ("bias", 0.0, is_bias)):
            if is_learned:
                self.register_parameter(name, nn.Parameter(torch.full(shape, value)))
            else:
                self.register_buffer(name, torch.full(shape, value))
        if is_eps_leanable:
            self.register_parameter("eps", nn.Parameter(torch.tensor([self.init_eps])))
        else:
            self.register_buffer("eps", torch.tensor([self.init_eps]))

    def extra_repr(self) -> str:
        return f"num_features={self.num_features}, eps={self.init_eps}"

    def forward(self, x: Tensor) -> Tensor:
        _check.shape("FilterResponseNorm2d", "x", x, "B", self.num_features, "H", "W")
        x = x * torch.rsqrt(x.square().mean((2, 3), keepdim=True) + self.eps.abs())
        x = x * self.weight if self.is_scale else x
        return x + self.bias if self.is_bias else x


class TLU(nn.Module):
    """Threshold each channel (B, C, H, W) from below by a learned number: max(x, tau).

    Args:
        num_features: C.

    Source: S. Singh, S. Krishnan, "Filter response normalization layer" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.TLU(1)(torch.tensor([[[[-3.0, 3.0]]]]))[0, 0].tolist()
        [[-1.0, 3.0]]
    """

    def __init__(self, num_features: int) -> None:
        super().__init__()
        (self.num_features,) = _check.ints("TLU", "num_features", num_features, 1)
        self.tau = nn.Parameter(-torch.ones(1, num_features, 1, 1))

    def extra_repr(self) -> str:
        return f"num_features={self.num_features}"

    def forward(self, x: Tensor) -> Tensor:
        _check.shape("TLU", "x", x, "B", self.num_features, "H", "W")
        return torch.maximum(x, self.tau)


class HyNet(nn.Module):
    """Describe patches (B, 1, 32, 32) by unit vectors (B, dim_desc): HyNet, trained with a hybrid similarity.

    Args:
        pretrained: as in `HardNet`.
        is_bias: whether convolutions have a bias.
        is_bias_FRN: whether normalizations have one.
        dim_desc: the length of a descriptor.
        drop_rate: the probability of dropout while training.
        eps_l2_norm: added to a descriptor before it is normalized.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: patches of another shape.
        TypeCheckError: patches that are not floating-point tensors.

    Source: Y. Tian et al., "HyNet: Learning local descriptor with hybrid similarity measure and triplet loss" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.HyNet(pretrained=False).eval()(torch.rand(2, 1, 32, 32)).shape
        torch.Size([2, 128])
    """

    patch_size = PATCH_SIZE

    def __init__(
        self,
        pretrained: Weights = True,
        is_bias: bool = True,
        is_bias_FRN: bool = True,
        dim_desc: int = 128,
        drop_rate: float = 0.3,
        eps_l2_norm: float = 1e-10,
    ) -> None:
        super().__init__()
        is_bias = _check.switch("HyNet", "is_bias", is_bias)
        (dim_desc,) = _check.ints("HyNet", "dim_desc", dim_desc, 1)
        drop_rate = _check.number("HyNet", "drop_rate", drop_rate, minimum=0)
        if drop_rate > 1:
            raise ValueCheckError(f"HyNet: expected drop_rate of at most 1, got {drop_rate}")
        self.dim_desc, self.drop_rate = dim_desc, drop_rate
        self.eps_l2_norm = _check.number("HyNet", "eps_l2_norm", eps_l2_norm)

        def thresholded(channels: int) -> list[nn.Module]:
            return [FilterResponseNorm2d(channels, is_bias=is_bias_FRN), TLU(channels)]

        def layer(channels: int, out_channels: int, stride: int = 1) -> list[nn.Module]:
            convolution = nn.Conv2d(channels, out_channels, 3, stride=stride, padding=1, bias=is_bias)
            return [convolution, *thresholded(out_channels)]

        self.layer1 = nn.Sequential(*thresholded(1), *layer(1, 32))
        self.layer2 = nn.Sequential(*layer(32, 32))
        self.layer3 = nn.Sequential(*layer(32, 64, 2))
        self.layer4 = nn.Sequential(*layer(64, 64))
        self.layer5 = nn.Sequential(*layer(64, 128, 2))
        self.layer6 = nn.Sequential(*layer(128, 128))
        self.layer7 = nn.Sequential(
            nn.Dropout(drop_rate), nn.Conv2d(128, dim_desc, 8, bias=False), nn.BatchNorm2d(dim_desc, affine=False)
        )
        self.desc_norm = unit_length(dim_desc)
        load_weights(self, pretrained)

    def forward(self, x: Tensor) -> Tensor:
        check_patches(self, x)
        for layer in (self.layer1, self.layer2, self.layer3, self.layer4, self.layer5, self.layer6, self.layer7):
            x = layer(x)
        return self.desc_norm(x + self.eps_l2_norm).flatten(1)
