"""Drops of rain on a lens, where a layer of smooth noise is above a threshold: their depth, and their relief lit from a corner."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._limits import FAR_FROM_OUTLINE
from kvision._ops import register


def _levels(layers: Tensor, thresholds: Tensor) -> Tensor:
    """Levels of drops, whole numbers up to 255, and 0 elsewhere."""
    return torch.where(layers < thresholds[:, None, None, None], 0, layers).clamp(0, 1).mul(255).floor()


def _sum_of_nine(x: Tensor) -> Tensor:
    """Sums of 3 x 3 numbers, rows first; borders are reflected."""
    x = _reflected(x)
    rows = x[..., :-2] + x[..., 1:-1] + x[..., 2:]
    return rows[..., :-2, :] + rows[..., 1:-1, :] + rows[..., 2:, :]


def _reflected(x: Tensor) -> Tensor:
    """One pixel more to each side; a side of one pixel repeats it."""
    for axis in (2, 3):
        size = x.shape[axis]
        at = torch.arange(-1, size + 1, device=x.device).abs()
        x = x.index_select(axis, torch.minimum(at, 2 * size - 2 - at).clamp(min=0))
    return x


def _distances(is_marked: Tensor) -> Tensor:
    """The Euclidean distances (B, 1, H, W) to the nearest marked pixel, at most 20: along rows, and then along columns."""
    far = FAR_FROM_OUTLINE
    squares = (~is_marked).float() * far**2
    for pad in ((far, far), (0, 0, far, far)):
        padded, axis = F.pad(squares, pad, value=float(far**2)), 3 if len(pad) == 2 else 2
        for moved in range(-far + 1, far):
            near = padded.narrow(axis, far + moved, squares.shape[axis])
            squares = torch.minimum(squares, near + moved * moved)
    return squares.sqrt()


def _depths_reference(layers: Tensor, thresholds: Tensor) -> Tensor:
    """The mean distance of 3 x 3 pixels from outlines of drops, rounded down, in bytes.

    Pixels of an outline are those of a drop next to one that is none.
    """
    inside = (_levels(layers, thresholds) > 0).float()
    least = torch.minimum(*(-F.max_pool2d(-inside, k, 1, (k[0] // 2, k[1] // 2)) for k in ((3, 1), (1, 3))))
    return (_sum_of_nine(_distances(inside > least)) / 9).to(torch.uint8)


drop_depths = register(
    "drop_depths",
    _depths_reference,
    fake=lambda layers, _: layers.new_empty(layers.shape, dtype=torch.uint8),
    non_differentiable=(0,),
    casts_outputs=True,
)


def _reliefs_reference(layers: Tensor, thresholds: Tensor, depths: Tensor) -> Tensor:
    """Levels of drops times their light: the slope of depths from the upper left corner, its mean over 3 x 3 pixels."""
    z = _reflected(depths.int())
    light = 2 * (z[..., 2:, 2:] - z[..., :-2, :-2]) + z[..., 1:-1, 1:-1] + z[..., 2:, 1:-1] + z[..., 1:-1, 2:]
    light = (light - z[..., :-2, 1:-1] - z[..., 1:-1, :-2]).clamp(0, 255)
    return ((2 * _sum_of_nine(light) + 9) // 18) * _levels(layers, thresholds)


drop_reliefs = register("drop_reliefs", _reliefs_reference, non_differentiable=(0,), layout_of=0)
