"""The strongest features of images by one operator: scale space, response and peaks of all octaves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._backend import backend
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import DERIVATIVE_MODE_NAMES
from kvision._ops import register
from kvision.feature import _detection as detection
from kvision.feature.laf import laf_of_peak
from kvision.feature.responses import hessian_response
from kvision.feature.scale_space.scale_space_peaks import scale_space_peaks
from kvision.filters.smoothing.gaussian import gaussian_blur2d, gaussian_levels
from kvision.geometry.transform.resize import resize

DIFFERENCES = -1  # the mode of differences of Gaussians; other modes are derivative modes of the Hessian

# --- the definition -------------------------------------------------------------------------------------------------


def _reference(image: Tensor, *args: Any) -> tuple[Tensor, Tensor]:
    with backend("reference"):
        return _by_operators(image, *args)


def _by_operators(
    image: Tensor,
    sizes: Sequence[int],
    windows: Sequence[int],
    sigmas: Sequence[float],
    next_level: int,
    blurs: Sequence[float],
    mode: int,
    minima: bool,
    count: int,
    scale: float,
    levels_of_octave: float,
    *filters: Any,
) -> tuple[Tensor, Tensor]:
    batch, _, height, width = image.shape
    scores, lafs = ([x] for x in detection.no_candidates(as_dtype(image, compute_dtype(image))))
    first_level = image
    for o, (h, w) in enumerate(zip(sizes[::2], sizes[1::2])):
        window, *others = windows[o * len(sigmas) : (o + 1) * len(sigmas)]
        if first_level.shape[2:] != (h, w):
            first_level = resize(first_level, (h, w), align_corners=True)
        if window:
            first_level = gaussian_blur2d(first_level, window, sigmas[0])
        octave = gaussian_levels(first_level, others, list(sigmas[1:]))
        first_level, levels = octave[:, :, next_level], octave[:, 0]
        if mode != DIFFERENCES:
            level_sigmas = image.new_tensor(blurs).repeat(batch)
            grads_mode: Any = DERIVATIVE_MODE_NAMES[mode]
            response = hessian_response(levels.reshape(-1, 1, h, w), grads_mode, level_sigmas)
            levels = response.reshape(levels.shape)
        first_scale = image.new_full((batch,), scale, dtype=compute_dtype(image))
        options = (mode == DIFFERENCES, minima, count, levels_of_octave, *filters)
        peaks, voxels = scale_space_peaks(levels, None, first_scale, *options)
        to_x, to_y = (width - 1) / (w - 1), (height - 1) / (h - 1)
        lafs.append(laf_of_peak(peaks, first_scale, levels_of_octave, to_x, to_y))
        scores.append(torch.where(voxels < 0, detection.EMPTY, peaks[..., 3]))
    scores_of_slots, frames = detection.filled_slots(image, torch.cat(scores, 1), torch.cat(lafs, 1), count)
    return frames, scores_of_slots


# --- the operator ---------------------------------------------------------------------------------------------------


def _fake(image: Tensor, *args: Any) -> list[Tensor]:
    count = args[7]
    like = image.new_empty(0, dtype=compute_dtype(image))
    return [like.new_empty(image.shape[0], count, 2, 3), like.new_empty(image.shape[0], count)]


# From images (B, 1, H, W) to frames (B, N, 2, 3) and scores (B, N), in the compute type.
scale_space_features = register("scale_space_features", _reference, fake=_fake, casts_outputs=True)
