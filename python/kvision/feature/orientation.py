"""Dominant orientations of patches and of local affine frames."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import as_dtype
from kvision._limits import MAX_ORIENTATION_BINS
from kvision._ops import behind_grad, no_derivative, register, vjp
from kvision.feature._patch_gradient import (
    angular_votes,
    centered_gaussian,
    check_patches,
    patch_gradients,
    to_polar,
    too_large,
)
from kvision.feature.laf import _rotate_reference, rotate_laf
from kvision.feature.patches import check_frames, extract_patches_from_pyramid

__all__ = ["LAFOrienter", "PatchDominantGradientOrientation"]

_SMOOTHING = (0.29962780949740747, 0.2311235920177775, 0.11906250323351877)  # of bins 0, 1 and 2 away: exp(-s) I_k(s)

# --- the operator ---------------------------------------------------------------------------------------------------


def _reference(patches: Tensor, bins: int, eps: float, peaks: int, threshold: float) -> Tensor:
    n = patches.shape[-1]
    magnitude, angle = to_polar(*patch_gradients(patches, sobel=True), eps)
    window = centered_gaussian(n, n / 6, patches)
    votes = angular_votes(magnitude * torch.outer(window, window), angle, bins, bins / 2)
    return math.pi - 2 * math.pi / bins * _peaks(votes.flatten(2).sum(2), peaks, threshold)


def peak_of(histogram: Tensor) -> Tensor:
    """The position in bins of the peak of histograms (B, bins) around the circle, (B,); without a peak the first bin."""
    return _peaks(histogram, 1, 1.0)[:, 0]


def _peaks(histogram: Tensor, count: int, threshold: float) -> Tensor:
    """The positions (B, count) of the largest bin and of the next local maxima of at least `threshold` times that.

    Where there are fewer, the first is repeated.
    """
    bins = histogram.shape[1]
    smoothed = _SMOOTHING[0] * histogram
    for distance in (1, 2):
        both = histogram.roll(distance, 1) + histogram.roll(-distance, 1)
        smoothed = smoothed + _SMOOTHING[distance] * both
    values = smoothed.detach()
    first = values.argmax(1, keepdim=True)
    is_peak = (
        (values > values.roll(1, 1)) & (values >= values.roll(-1, 1)) & (values >= threshold * values.amax(1, True))
    )
    ranked, index = (
        torch.where(is_peak, values, -1).scatter(1, first, math.inf).sort(dim=1, descending=True, stable=True)
    )
    peak = torch.where(ranked >= 0, index, first)[:, :count]
    left, middle, right = (smoothed.gather(1, (peak + k) % bins) for k in (-1, 0, 1))
    bend = left + right - 2 * middle
    has_peak = bend != 0
    return peak + torch.where(has_peak, (left - right) / torch.where(has_peak, bend, 1) / 2, 0)


def _supports(patches: Tensor, bins: int, *_: Any) -> str | None:
    """Patches have at most 88 pixels a side on CUDA, histograms at most 64 bins."""
    return f"no kernel has {bins} bins" if bins > MAX_ORIENTATION_BINS else too_large(patches)


_orientation = register(
    "orientation",
    _reference,
    fake=lambda patches, bins, eps, peaks, threshold: (patches.shape[0], peaks),
    gradients="patches: orientation_backward",
    supports=_supports,
)
register(
    "orientation_backward",
    vjp(_reference),
    fake=lambda grad, patches, *_: patches.shape,
    layout_of=1,
    supports=behind_grad(_supports),
)


def dominant_orientations(
    patches: Tensor, count: int, bins: int = 36, eps: float = 1e-8, threshold: float = 0.8
) -> Tensor:
    """The angles (B, count) in radians of the largest peaks of the histograms of patches (B, 1, n, n).

    The first is that of :class:`PatchDominantGradientOrientation`. The others have at least `threshold` times its bin; where
    there are fewer peaks, the first angle is repeated.
    """
    op = "dominant_orientations"
    _check.images(op, "patches", patches)
    x = check_patches(op, "patches", patches, patches.shape[3])
    return _orientation(x, bins, eps, count, threshold)


# --- one slot for each orientation ----------------------------------------------------------------------------------


def _slots_reference(laf: Tensor, responses: Tensor, angles: Tensor) -> tuple[Tensor, Tensor]:
    count, peaks = laf.shape[1], angles.shape[2]
    is_peak = torch.cat([torch.ones_like(angles[..., :1], dtype=torch.bool), angles[..., 1:] != angles[..., :1]], 2)
    is_feature = ((laf != 0).flatten(2).any(2)[..., None] & is_peak).flatten(1)
    order = (~is_feature).to(torch.uint8).sort(dim=1, stable=True)[1][:, :count]
    filled = is_feature.gather(1, order)
    # Each rotated frame is gathered once, so that gradients are added in a fixed order.
    frames, scores = (x[:, :, None].expand(-1, -1, peaks, *x.shape[2:]).flatten(1, 2) for x in (laf, responses))
    rotated = _rotate_reference(frames, torch.rad2deg(angles.flatten(1)))
    rotated = rotated.gather(1, order[..., None, None].expand(-1, -1, 2, 3))
    return torch.where(filled[..., None, None], rotated, 0), torch.where(filled, scores.gather(1, order), 0)


_slots = register(
    "orientation_slots",
    _slots_reference,
    fake=lambda laf, responses, _: [laf.new_empty(laf.shape), responses.new_empty(responses.shape)],
    casts_outputs=True,
    supports=no_derivative,
)


def orientation_slots(laf: Tensor, responses: Tensor, angles: Tensor) -> tuple[Tensor, Tensor]:
    """Frames (B, N, 2, 3) and responses (B, N) of features with several angles (B, N, K), one slot for each angle.

    A feature is rotated by each of its angles, in radians, except those that repeat its first one. Features and the angles of
    each feature keep their order, and the first N are kept. So features that are sorted by response stay sorted.
    """
    frames, scores = _slots(laf, as_dtype(responses, laf.dtype), as_dtype(angles, laf.dtype))
    return frames, as_dtype(scores, responses.dtype)


# --- modules --------------------------------------------------------------------------------------------------------


class PatchDominantGradientOrientation(nn.Module):
    """The direction of the strongest gradients of square gray patches.

    Sobel gradients vote, weighted by a Gaussian window of sigma patch_size / 6, for the bins of a histogram of angles,
    which is smoothed; a parabola through its largest bin gives the angle within a degree. Angles are counter-clockwise
    as seen in the image: brightness that grows to the right gives 0, brightness that grows upwards pi / 2. OpenCV counts
    the angles of its key points clockwise.

    A flat patch gives pi, with a gradient of 0. A gradient that is not finite counts as none. The choice of the largest
    bin is not differentiated.

    Args:
        patch_size: side of the patches in pixels.
        num_angular_bins: number of bins of the histogram, at least 3.
        eps: added to the squared gradients under the root.

    Returns:
        Of patches (B, 1, patch_size, patch_size), angles (B,) in radians, from -pi - pi / num_angular_bins to
        pi + pi / num_angular_bins.

    Raises:
        TypeError: an argument is of the wrong type; the patches are not tensors of real numbers.
        ValueError: patches of another shape; a number is out of range.

    Example:
        >>> import torch, kvision as K
        >>> upwards = -torch.arange(9.0)[:, None].expand(1, 1, 9, 9)
        >>> K.feature.PatchDominantGradientOrientation(9)(upwards)
        tensor([1.5708])
    """

    def __init__(self, patch_size: int = 32, num_angular_bins: int = 36, eps: float = 1e-8) -> None:
        super().__init__()
        op = "PatchDominantGradientOrientation"
        _check.ints(op, "patch_size", patch_size, 1)
        _check.ints(op, "num_angular_bins", num_angular_bins, 1, minimum=3)
        self.patch_size = patch_size
        self.num_ang_bins = num_angular_bins
        self.eps = _check.number(op, "eps", eps, minimum=0)

    def extra_repr(self) -> str:
        return f"patch_size={self.patch_size}, num_ang_bins={self.num_ang_bins}, eps={self.eps}"

    def forward(self, patch: Tensor) -> Tensor:
        x = check_patches("PatchDominantGradientOrientation", "patch", patch, self.patch_size)
        return _orientation(x, self.num_ang_bins, self.eps, 1, 1.0)[:, 0]


class LAFOrienter(nn.Module):
    """Rotate local affine frames onto the dominant gradients of their patches.

    The angle that the detector finds in the patch of a frame is added to the orientation of the frame; center and ellipse
    stay. Frames that are not finite and empty slots stay as they are.

    Args:
        patch_size: side of the patches in pixels.
        num_angular_bins: number of bins of the default detector.
        angle_detector: a module from patches (n, 1, patch_size, patch_size) to angles (n,) in radians; default:
            :class:`PatchDominantGradientOrientation`.

    Returns:
        Of frames `laf` (B, N, 2, 3) and images `img` (B, 1, H, W), frames (B, N, 2, 3).

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: tensors of another shape.

    Example:
        >>> import torch, kvision as K
        >>> upwards = -torch.arange(64.0)[:, None].expand(1, 1, 64, 64)
        >>> laf = torch.tensor([[[[12.0, 0, 32], [0, 12, 32]]]])
        >>> K.feature.get_laf_orientation(K.feature.LAFOrienter()(laf, upwards)).round()
        tensor([[[90.]]])
    """

    def __init__(
        self, patch_size: int = 32, num_angular_bins: int = 36, angle_detector: nn.Module | None = None
    ) -> None:
        super().__init__()
        op = "LAFOrienter"
        _check.ints(op, "patch_size", patch_size, 1)
        _check.ints(op, "num_angular_bins", num_angular_bins, 1, minimum=3)
        self.patch_size = patch_size
        self.num_ang_bins = num_angular_bins
        if angle_detector is not None:
            _check.function(op, "angle_detector", angle_detector)
        self.angle_detector = angle_detector or PatchDominantGradientOrientation(patch_size, num_angular_bins)

    def extra_repr(self) -> str:
        return f"patch_size={self.patch_size}"

    def forward(self, laf: Tensor, img: Tensor) -> Tensor:
        op = "LAFOrienter"
        check_frames(op, img, laf)
        _check.channels(op, "img", img, 1)
        n = self.patch_size
        patches = extract_patches_from_pyramid(img, laf, n).reshape(-1, 1, n, n)
        degrees = torch.rad2deg(self.angle_detector(patches)).reshape(laf.shape[:2])
        return rotate_laf(laf, degrees)
