"""Drops of rain and stains on a lens, where a layer of smooth noise is above a threshold: the depth of drops, and their relief lit
from a corner.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._limits import FAR_FROM_OUTLINE
from kvision._ops import register
from kvision.geometry.transform.lists.arguments import row
from kvision.geometry.transform.lists.kept_sizes import register_list

# Arguments of the operators: layers (B, 1, H, W), float32 or float64; parameters (B or 1, 3) of their type: mean and deviation, for
# a layer is its mean and its deviation times the numbers that are given, and the threshold.


def _values(layers: Tensor, parameters: Tensor) -> tuple[Tensor, Tensor]:
    """What layers are, and the threshold."""
    mean, deviation, threshold = parameters[:, :, None, None, None].unbind(1)
    return mean + deviation * layers, threshold


def _levels(layers: Tensor, parameters: Tensor) -> Tensor:
    """Levels of drops, whole numbers up to 255, and 0 elsewhere."""
    values, threshold = _values(layers, parameters)
    return torch.where(values < threshold, 0, values).clamp(0, 1).mul(255).floor()


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


def _depths_reference(layers: Tensor, parameters: Tensor) -> Tensor:
    """The mean distance of 3 x 3 pixels from outlines of drops, rounded down, in bytes.

    Pixels of an outline are those of a drop next to one that is none.
    """
    inside = (_levels(layers, parameters) > 0).float()
    least = torch.minimum(*(-F.max_pool2d(-inside, k, 1, (k[0] // 2, k[1] // 2)) for k in ((3, 1), (1, 3))))
    return (_sum_of_nine(_distances(inside > least)) / 9).to(torch.uint8)


drop_depths = register(
    "drop_depths",
    _depths_reference,
    fake=lambda layers, _: layers.new_empty(layers.shape, dtype=torch.uint8),
    non_differentiable=(0,),
    casts_outputs=True,
)


def _reliefs_reference(layers: Tensor, parameters: Tensor, depths: Tensor) -> Tensor:
    """Levels of drops times their light: the slope of depths from the upper left corner, its mean over 3 x 3 pixels."""
    z = _reflected(depths.int())
    light = 2 * (z[..., 2:, 2:] - z[..., :-2, :-2]) + z[..., 1:-1, 1:-1] + z[..., 2:, 1:-1] + z[..., 1:-1, 2:]
    light = (light - z[..., :-2, 1:-1] - z[..., 1:-1, :-2]).clamp(0, 255)
    return ((2 * _sum_of_nine(light) + 9) // 18) * _levels(layers, parameters)


drop_reliefs = register("drop_reliefs", _reliefs_reference, non_differentiable=(0,), layout_of=0)


def _stains_reference(layers: Tensor, parameters: Tensor) -> Tensor:
    """1 where layers are above the threshold, and 0 elsewhere."""
    values, threshold = _values(layers, parameters)
    return (values > threshold).to(layers.dtype)


mark_stains = register("mark_stains", _stains_reference, non_differentiable=(0,), layout_of=0)


def _of_sample(b: int, parameters: Tensor, *depths: Any) -> tuple[Any, ...]:
    """The arguments of a layer of a list, by its number."""
    return row(parameters, b), *(of_list[b][None] for of_list in depths)


register_list("drop_depths_list", drop_depths, _of_sample, dtype=torch.uint8)
register_list("drop_reliefs_list", drop_reliefs, _of_sample)
register_list("mark_stains_list", mark_stains, _of_sample)
