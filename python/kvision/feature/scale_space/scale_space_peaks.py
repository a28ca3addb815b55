"""The strongest peaks of a response over position and scale, refined and filtered: the operator of detectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import as_dtype, compute_dtype
from kvision._ops import on_cuda, register
from kvision.feature import _detection as detection
from kvision.filters.edges.spatial_gradient import spatial_gradient
from kvision.geometry.subpix import conv_quad_interp3d, nms3d_minmax

# Refines the chosen voxels of volumes (B, 1, D, H, W): coordinates (B, 1, 3, D, H, W) and values.
Refine = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]

# --- the definition -------------------------------------------------------------------------------------------------


def _reference(
    levels: Tensor,
    weights: Tensor | None,
    scales: Tensor,
    differences: bool,
    minima: bool,
    count: int,
    levels_of_octave: float,
    margin: float,
    edge_ratio: float,
    threshold: float,
    *refinement: Any,
) -> tuple[Tensor, Tensor]:
    def refine(response: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
        steps, largest_shift, radius, along_scale = refinement
        return conv_quad_interp3d(response, steps, None, largest_shift, chosen, radius, along_scale)

    x = as_dtype(levels, compute_dtype(levels))
    response = x[:, 1:] - x[:, :-1] if differences else x
    filters = (levels_of_octave, margin, edge_ratio, threshold)
    return strongest_peaks(response[:, None], weights, scales, minima, count, *filters, refine)


def strongest_peaks(
    response: Tensor,
    weights: Tensor | None,
    scales: Tensor,
    minima: bool,
    count: int,
    levels_of_octave: float,
    margin: float,
    edge_ratio: float,
    threshold: float,
    refine: Refine,
) -> tuple[Tensor, Tensor]:
    """The operator for a response (B, 1, D, H, W) and any refinement."""
    coords, values, is_peak = _refined(response, minima, refine)
    level, x, y = coords[:, 0].unbind(1)
    height, width = response.shape[3:]
    with torch.no_grad():
        room = margin + scales[:, None, None, None] * torch.exp2(level / levels_of_octave) / 2
        if edge_ratio > 0:
            is_peak = is_peak & _are_off_edges(response, edge_ratio)
        is_peak = is_peak[:, 0] & (x >= room) & (y >= room) & (x + room <= width - 1) & (y + room <= height - 1)
        scores = values.detach()[:, 0]
        if weights is not None:
            allowed = weights[:, None].expand(len(response), -1, -1, -1)
            scores = detection.weighted(scores, allowed)
            is_peak = is_peak & _is_allowed(allowed, x, y)
        is_peak = is_peak & (scores > threshold)
        ranked = torch.where(is_peak, scores, detection.EMPTY).flatten(1)
        voxels = detection.strongest(ranked, count)[1]
        filled = ranked.gather(1, voxels) > detection.EMPTY
    peaks = torch.where(filled[..., None], _at_voxels(coords, values, voxels), 0)
    return _padded(peaks, count, 0), _padded(torch.where(filled, voxels, -1), count, -1)


def _at_voxels(coords: Tensor, values: Tensor, voxels: Tensor) -> Tensor:
    """Coordinates (B, 1, 3, D, H, W) and values (B, 1, D, H, W) of voxels (B, N), as (B, N, 4)."""
    numbers = torch.cat([coords[:, 0], values], 1).flatten(2)
    return numbers.gather(2, voxels[:, None].expand(-1, 4, -1)).mT


def _padded(x: Tensor, count: int, value: int) -> Tensor:
    """With `count` slots along axis 1."""
    missing = count - x.shape[1]
    return torch.cat([x, x.new_full((len(x), missing, *x.shape[2:]), value)], 1) if missing > 0 else x


def _refined(response: Tensor, minima: bool, refine: Refine) -> tuple[Tensor, Tensor, Tensor]:
    """Coordinates (B, 1, 3, D, H, W) in the order level, x, y, values and whether there is a candidate."""
    is_maximum, is_minimum = nms3d_minmax(response)
    if not minima:
        return *refine(response, is_maximum), is_maximum
    coords, values = refine(torch.cat([response, -response]), torch.cat([is_maximum, is_minimum]))
    (upper, lower), (high, low) = coords.chunk(2), values.chunk(2)
    # A minimum counts where its negative value is above the response, which the refinement may move across 0.
    is_minimum = is_minimum & (low > high)
    coords = torch.where(is_minimum[:, :, None], lower, upper)
    return coords, torch.where(is_minimum, low, high), is_maximum | is_minimum


def is_off_edges(xx: Tensor, xy: Tensor, yy: Tensor, ratio: float) -> Tensor:
    """Whether both principal curvatures have the same sign, and the larger is less than `ratio` times the smaller."""
    trace, det = xx + yy, xx * yy - xy * xy
    return (det > 0) & (trace * trace * ratio < (ratio + 1) ** 2 * det)


def _are_off_edges(response: Tensor, ratio: float) -> Tensor:
    """`is_off_edges` for each level of a response (B, 1, D, H, W)."""
    levels = response.detach().transpose(1, 2).flatten(0, 1)
    xx, xy, yy = spatial_gradient(levels, "diff", 2)[:, 0].unbind(1)
    return is_off_edges(xx, xy, yy, ratio).view(response.shape)


def _is_allowed(weights: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Whether the weights (B, 1, H, W) of the four pixels around points are above 0."""
    height, width = weights.shape[2:]
    flat = (weights > 0).flatten(1)
    columns = [v.long().clamp(0, width - 1) for v in (x.floor(), x.ceil())]
    rows = [v.long().clamp(0, height - 1) for v in (y.floor(), y.ceil())]
    allowed = torch.ones_like(x, dtype=torch.bool)
    for row in rows:
        for column in columns:
            allowed = allowed & flat.gather(1, (row * width + column).flatten(1)).view(x.shape)
    return allowed


# --- the operator ---------------------------------------------------------------------------------------------------


def _fake(levels: Tensor, weights: Tensor | None, scales: Tensor, _1: bool, _2: bool, count: int, *_: Any) -> list[Any]:
    like = levels.new_empty(0, dtype=compute_dtype(levels))
    sizes = (levels.shape[0], count)
    return [like.new_empty(*sizes, 4), like.new_empty(sizes, dtype=torch.int64)]


def _reference_backward(grad: Tensor, levels: Tensor, voxels: Tensor, differences: bool, *refinement: Any) -> Tensor:
    """The gradient to the levels, in the type that computes, of the peaks that voxels are refined to."""
    steps, largest_shift, radius, along_scale = refinement

    def peaks(x: Tensor) -> Tensor:
        response = x[:, 1:] - x[:, :-1] if differences else x
        flat = response.detach().flatten(1)
        at = voxels.clamp(min=0, max=flat.shape[1] - 2)
        is_maximum = flat.gather(1, at) > flat.gather(1, at + 1)
        total: Any = 0
        for sign, selected in ((1, is_maximum & (voxels >= 0)), (-1, ~is_maximum & (voxels >= 0))):
            chosen = torch.zeros_like(flat, dtype=torch.uint8).scatter_reduce(1, at, selected.to(torch.uint8), "amax")
            marked = chosen.view(response.shape)[:, None] != 0
            refined = conv_quad_interp3d(
                sign * response[:, None], steps, None, largest_shift, marked, radius, along_scale
            )
            total = total + torch.where(selected[..., None], _at_voxels(*refined, at), 0)
        return total

    x = as_dtype(levels, compute_dtype(levels)).expand(len(grad), -1, -1, -1)
    return torch.func.vjp(peaks, x)[1](as_dtype(grad, x.dtype))[0]


register(
    "scale_space_peaks_backward",
    _reference_backward,
    fake=lambda grad, levels, *_: levels.new_empty((grad.shape[0], *levels.shape[1:]), dtype=compute_dtype(levels)),
    casts_outputs=True,
    nondeterministic=on_cuda,
)
_peaks = register(
    "scale_space_peaks",
    _reference,
    fake=_fake,
    gradients="levels: scale_space_peaks_backward(voxels=result1)",
    non_differentiable=(1,),
    casts_outputs=True,
)


def scale_space_peaks(levels: Tensor, *args: Any) -> tuple[Tensor, Tensor]:
    """The strongest peaks of levels (B, L, H, W): peaks (B, N, 4), which are level, x, y and value, and voxels (B, N).

    Arguments are those of the operator: weights (B, H, W) or None, which select peaks and order them, scales (B,) of level
    0, and whether level i is the difference of levels i + 1 and i. Voxels are those that were refined; slots without a peak
    have 0 and -1.
    """
    return _peaks(levels, *args)
