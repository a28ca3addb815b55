"""AffNet: learned affine shapes of local affine frames."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kvision import _check
from kvision.feature._weights import Weights, load_weights
from kvision.feature.hardnet import PATCH_SIZE, convolutions, standardized
from kvision.feature.laf import (
    get_laf_center,
    get_laf_orientation,
    get_laf_scale,
    laf_is_valid,
    make_upright,
    scale_laf,
    set_laf_orientation,
)
from kvision.feature.orinet import HALF_L2NET
from kvision.feature.patches import check_frames, extract_patches_from_pyramid


class LAFAffNetShapeEstimator(nn.Module):
    """Give local affine frames (B, N, 2, 3) the affine shapes of their patches: AffNet.

    Its call takes frames and gray images (B, 1, H, W), and returns frames of the same centers and scales. A frame that is
    not finite or has no area, such as an empty slot, stays as it is.

    Args:
        pretrained: as in `HardNet`.
        preserve_orientation: whether frames keep their orientation; otherwise it is 0.

    Raises:
        RuntimeError: weights that cannot be downloaded, or are not those of this network.
        ShapeError: frames or images of another shape.
        TypeCheckError: arguments that are not floating-point tensors.

    Source: D. Mishkin, F. Radenovic, J. Matas, "Repeatability is not enough: Learning affine regions via discriminability"
    (2018).

    Example:
        >>> import torch, kvision as K
        >>> lafs = K.feature.laf_from_center_scale_ori(torch.full((1, 2, 2), 30.0), torch.full((1, 2, 1, 1), 8.0))
        >>> K.feature.LAFAffNetShapeEstimator(pretrained=False).eval()(lafs, torch.rand(1, 1, 64, 64)).shape
        torch.Size([1, 2, 2, 3])
    """

    patch_size = PATCH_SIZE

    def __init__(self, pretrained: Weights = True, preserve_orientation: bool = True) -> None:
        super().__init__()
        self.features = nn.Sequential(
            *convolutions(*HALF_L2NET), nn.Dropout(0.25), nn.Conv2d(64, 3, 8), nn.Tanh(), nn.AdaptiveAvgPool2d(1)
        )
        self.preserve_orientation = _check.switch(type(self).__name__, "preserve_orientation", preserve_orientation)
        load_weights(self, pretrained)

    def forward(self, laf: Tensor, img: Tensor) -> Tensor:
        op = "LAFAffNetShapeEstimator"
        check_frames(op, img, laf)
        _check.shape(op, "img", img, "B", 1, "H", "W")
        if laf.shape[1] == 0:
            return laf
        is_valid = laf_is_valid(laf)[..., None, None]
        unit = torch.eye(2, 3, dtype=laf.dtype, device=laf.device)
        safe = torch.where(is_valid, laf, unit)
        patches = extract_patches_from_pyramid(img, make_upright(safe), PATCH_SIZE, True)
        a, b, c = self.features(standardized(patches.flatten(0, 1))).view(*laf.shape[:2], 3).unbind(-1)
        shape = torch.stack([1 + a, torch.zeros_like(a), b, 1 + c], -1).view(*laf.shape[:2], 2, 2)
        adapted = torch.cat([shape.to(laf.dtype), get_laf_center(safe)[..., None]], -1)
        adapted = scale_laf(make_upright(adapted), get_laf_scale(safe) / get_laf_scale(adapted))
        if self.preserve_orientation:
            adapted = set_laf_orientation(adapted, get_laf_orientation(safe))
        return torch.where(is_valid, adapted, laf)
