"""Affine shapes of patches and of local affine frames, by second moments of gradients."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._constants import constant
from kvision._ops import behind_grad, register, vjp
from kvision.feature._patch_gradient import centered_gaussian, check_patches, patch_gradients, too_large
from kvision.feature.laf import (
    ellipse_to_laf,
    get_laf_orientation,
    get_laf_scale,
    laf_is_valid,
    make_upright,
    scale_laf,
    set_laf_orientation,
)
from kvision.feature.patches import check_frames, extract_patches_from_pyramid

__all__ = ["LAFAffineShapeEstimator", "PatchAffineShapeEstimator"]

# --- the operator ---------------------------------------------------------------------------------------------------


def _reference(patches: Tensor, eps: float) -> Tensor:
    n = patches.shape[-1]
    window = centered_gaussian(n, n / 2**0.5, patches)
    weights = torch.outer(window, window) / window.sum() ** 2
    gx, gy = (g * weights for g in patch_gradients(patches, sobel=True))
    moments = torch.stack([(u * v).mean((1, 2)) for u, v in ((gx, gx), (gx, gy), (gy, gy))], 1)
    is_circle = ((moments.abs() <= eps).sum(1, keepdim=True) >= 2).detach()
    circle = constant((1.0, 0.0, 1.0), moments)
    moments = torch.where(is_circle, circle, moments)
    return moments / torch.maximum(moments[:, :1], moments[:, 2:])


def _supports(patches: Tensor, *_: Any) -> str | None:
    """Patches have at most 88 pixels a side on CUDA."""
    return too_large(patches)


_affine_shape = register(
    "affine_shape",
    _reference,
    fake=lambda patches, eps: (patches.shape[0], 3),
    gradients="patches: affine_shape_backward",
    supports=_supports,
)
register(
    "affine_shape_backward",
    vjp(_reference),
    fake=lambda grad, patches, eps: patches.shape,
    layout_of=1,
    supports=behind_grad(_supports),
)

# --- modules --------------------------------------------------------------------------------------------------------


class PatchAffineShapeEstimator(nn.Module):
    """The second moments of the gradients of square gray patches, as an ellipse.

    (a, b, c) are the means of gx^2, gx gy and gy^2 for Sobel gradients with a Gaussian window of sigma
    patch_size / sqrt 2, divided by the larger of a and c. Where the absolute values of two of them are at most `eps`
    before that, in a flat patch or one of gradients along an axis, the ellipse is the circle (1, 0, 1), with a gradient
    of 0.

    Args:
        patch_size: side of the patches in pixels.
        eps: largest moment that does not count.

    Returns:
        Of patches (B, 1, patch_size, patch_size), ellipses (B, 1, 3).

    Raises:
        TypeError: an argument is of the wrong type; the patches are not tensors of real numbers.
        ValueError: patches of another shape; a number is out of range.

    Source: A. Baumberg, "Reliable feature matching across widely separated views" (2000).

    Example:
        >>> import torch, kvision as K
        >>> diagonal = torch.arange(9.0) + torch.arange(9.0)[:, None]
        >>> K.feature.PatchAffineShapeEstimator(9)(diagonal[None, None]).round(decimals=4)
        tensor([[[1.0000, 0.9585, 1.0000]]])
    """

    def __init__(self, patch_size: int = 19, eps: float = 1e-10) -> None:
        super().__init__()
        _check.ints("PatchAffineShapeEstimator", "patch_size", patch_size, 1)
        self.patch_size = patch_size
        self.eps = _check.number("PatchAffineShapeEstimator", "eps", eps, minimum=0)

    def extra_repr(self) -> str:
        return f"patch_size={self.patch_size}, eps={self.eps}"

    def forward(self, patch: Tensor) -> Tensor:
        x = check_patches("PatchAffineShapeEstimator", "patch", patch, self.patch_size)
        return _affine_shape(x, self.eps)[:, None]


class LAFAffineShapeEstimator(nn.Module):
    """Give local affine frames the affine shape of their patches, one step of Baumberg's iteration.

    The shape is that of the patch of the upright frame; its ellipse is proportional to the inverse of the second moments.
    Centers and scales stay. A frame with no area or that is not finite, and one whose patch has no ellipse, stays as it
    is; if orientations are not kept, it becomes upright, and without area in the first case.

    Args:
        patch_size: side of the patches in pixels.
        affine_shape_detector: a module from patches (n, 1, patch_size, patch_size) to ellipses (n, 1, 3); default:
            :class:`PatchAffineShapeEstimator`.
        preserve_orientation: keep the orientations of the frames. If False, the results are upright.

    Returns:
        Of frames `laf` (B, N, 2, 3) and images `img` (B, 1, H, W), frames (B, N, 2, 3).

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: tensors of another shape.

    Source: A. Baumberg, "Reliable feature matching across widely separated views" (2000).

    Example:
        >>> import torch, kvision as K
        >>> laf = torch.tensor([[[[12.0, 0, 32], [0, 12, 32]]]])
        >>> adapted = K.feature.LAFAffineShapeEstimator()(laf, torch.rand(1, 1, 64, 64))
        >>> K.feature.get_laf_scale(adapted)[0, 0].round()
        tensor([[12.]])
    """

    def __init__(
        self, patch_size: int = 32, affine_shape_detector: nn.Module | None = None, preserve_orientation: bool = True
    ) -> None:
        super().__init__()
        _check.ints("LAFAffineShapeEstimator", "patch_size", patch_size, 1)
        _check.flag("LAFAffineShapeEstimator", "preserve_orientation", preserve_orientation)
        self.patch_size = patch_size
        if affine_shape_detector is not None:
            _check.function("LAFAffineShapeEstimator", "affine_shape_detector", affine_shape_detector)
        self.affine_shape_detector = affine_shape_detector or PatchAffineShapeEstimator(patch_size)
        self.preserve_orientation = preserve_orientation

    def extra_repr(self) -> str:
        return f"patch_size={self.patch_size}, preserve_orientation={self.preserve_orientation}"

    def forward(self, laf: Tensor, img: Tensor) -> Tensor:
        op = "LAFAffineShapeEstimator"
        check_frames(op, img, laf)
        _check.channels(op, "img", img, 1)
        n = self.patch_size
        valid = laf_is_valid(laf)
        frame = make_upright(replace_invalid(laf, valid))
        patches = extract_patches_from_pyramid(img, frame, n).reshape(-1, 1, n, n)
        ellipses = self.affine_shape_detector(patches).reshape(*laf.shape[:2], 3).to(laf.dtype)
        return adapt_shape(laf, valid, frame, ellipses, self.preserve_orientation)


def replace_invalid(laf: Tensor, valid: Tensor) -> Tensor:
    """`laf` with unit frames at 0 instead of those that are not valid (B, N)."""
    unit = torch.eye(2, 3, dtype=laf.dtype, device=laf.device)
    return torch.where(valid[..., None, None], laf, unit)


def adapt_shape(laf: Tensor, valid: Tensor, frame: Tensor, ellipses: Tensor, preserve_orientation: bool) -> Tensor:
    """`frame`, `laf` upright, with the shape of `ellipses` (B, N, 3) in its coordinates, and the scale it has."""
    a, b, c = ellipses.unbind(-1)
    is_ellipse = (a > 0) & (c > 0) & (a - (b / c.abs().sqrt()).square() > 0) & ellipses.isfinite().all(-1)
    circle = constant((1.0, 0.0, 1.0), laf)
    ellipses = torch.where(is_ellipse[..., None], ellipses, circle)
    shape = ellipse_to_laf(torch.cat([torch.zeros_like(ellipses[..., :2]), ellipses], -1))[..., :2]
    scale = get_laf_scale(frame)
    adapted = torch.cat([frame[..., :2] / scale @ shape, frame[..., 2:]], -1)
    is_adapted = valid & is_ellipse & laf_is_valid(adapted)
    adapted = torch.where(is_adapted[..., None, None], adapted, frame)
    adapted = scale_laf(adapted, scale / get_laf_scale(adapted))
    if preserve_orientation:
        adapted = set_laf_orientation(adapted, get_laf_orientation(replace_invalid(laf, valid)))
        return torch.where(is_adapted[..., None, None], adapted, laf)
    empty = torch.cat([torch.zeros_like(laf[..., :2]), laf[..., 2:]], -1)
    return torch.where(valid[..., None, None], adapted, empty)
