"""Where the pixels of a result are that read an image at given points and within given quadrilaterals.

A map is known at nodes: the pixels of the result, the edges of the outermost ones, and a few nodes outside, farther apart
the farther out they are. Between nodes it is bilinear. Where it folds, several positions read a point: the one that is taken is
nearest to the pixel that reads nearest to the point. So nothing is searched by steps that might not converge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._limits import NEAR_PIXEL
from kvision._modes import NODE_KIND, POSITION_KIND
from kvision._ops import register

OUTSIDE, INSIDE, PIXEL = NODE_KIND.values()  # outside of what the result shows, inside, a pixel that it shows
INVISIBLE, NEAREST_PIXEL, EXACT = POSITION_KIND.values()
_TOLERANCE = 2e-3  # of a position in a cell, in fractions of its size

# --- the operators --------------------------------------------------------------------------------------------------

# preimage_extents takes the corners and the directions of quadrilaterals, (B, N, 8); preimage_points takes points (B, N, 2).
# Arguments of both: coordinates (B, H, W, 2) that nodes read at, their kinds (B, H, W) in uint8, the positions (1, W) of columns
# and (1, H) of rows in the result, and the number of cells at each side of the map that are outside.


def _cells(nodes: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The values (..., H - 1, W - 1) at the corners of cells: of the nodes a, b to the right, c below and d."""
    top, bottom = nodes[:-1], nodes[1:]
    return top[:, :-1], top[:, 1:], bottom[:, :-1], bottom[:, 1:]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _solve(coordinates: Tensor, point: Tensor) -> tuple[Tensor, Tensor]:
    """u and v (2, H - 1, W - 1, 2) at which cells read a point, and which of them are within their cells.

    With e = b - a, f = c - a and g = d - b - f, a cell reads a + e u + f v + g u v. The cross product with f + g u removes v, and a
    quadratic equation of u remains.
    """
    a, b, c, d = _cells(coordinates)
    e, f = b - a, c - a
    g, h = d - b - f, point - a
    k0, k1, k2 = _cross(h, f), _cross(h, g) - _cross(e, f), -_cross(e, g)
    root = (k1 * k1 - 4 * k2 * k0).clamp(min=0).sqrt()
    q = -0.5 * (k1 + torch.where(k1 < 0, -root, root))
    u = torch.stack([k0 / q, q / k2])
    along = f + g * u[..., None]
    rest = h - e * u[..., None]
    v = (rest * along).sum(-1) / along.square().sum(-1)
    miss = (rest - along * v[..., None]).square().sum(-1)
    scale = torch.maximum(e.square().sum(-1), along.square().sum(-1)).clamp(min=1)
    uv = torch.stack([u, v], -1)
    is_within = ((uv >= -_TOLERANCE) & (uv <= 1 + _TOLERANCE)).all(-1) & (miss <= 4 * _TOLERANCE**2 * scale)
    return uv.clamp(0, 1), is_within


def _depths(points: Tensor, quad: Tensor) -> Tensor:
    """How far points (...) are to the inside of the sides of a quadrilateral, (4, ...), in units of their lengths."""
    sides = quad.roll(-1, 0) - quad
    sign = torch.where(_cross(quad[2] - quad[0], quad[3] - quad[1]) < 0, -1.0, 1.0).to(points)
    return torch.stack([sign * _cross(side, points - corner) for side, corner in zip(sides, quad)])


def _clip(depths: Tensor, other: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The part of segments inside a quadrilateral, from 0 to 1, and whether there is one; `depths` are those of their ends."""
    at = depths / (depths - other)
    first = torch.where(depths < 0, at, 0.0).amax(0)
    last = torch.where(other < 0, at, 1.0).amin(0)
    return first, last, ((depths >= 0) | (other >= 0)).all(0) & (first <= last)


def _extents_reference(
    quads: Tensor, directions: Tensor, coordinates: Tensor, kinds: Tensor, x: Tensor, y: Tensor, margin: int
) -> Tensor:
    """The largest products of four directions with the positions that read within quadrilaterals: inside, then anywhere."""
    quads, directions = quads.unflatten(2, (4, 2)), directions.unflatten(2, (4, 2))
    extents = torch.full((*quads.shape[:2], 2, 4), -torch.inf, dtype=quads.dtype, device=quads.device)
    for b, of_sample in enumerate(extents):
        is_inside = torch.stack(_cells(kinds[b] > 0)).all(0)
        corner = torch.stack([x[0, :-1].expand(is_inside.shape), y[0, :-1, None].expand(is_inside.shape)], -1)
        size = torch.stack([x.diff()[0].expand(is_inside.shape), y.diff()[0, :, None].expand(is_inside.shape)], -1)
        for n, extent in enumerate(of_sample):
            quad = quads[b, n]
            found: list[tuple[Tensor, Tensor]] = []  # u and v in all cells, and whether they are positions
            at_a, at_b, at_c, at_d = (_depths(nodes, quad) for nodes in _cells(coordinates[b]))
            for first, last, is_horizontal, other in (
                (at_a, at_b, True, 0.0),
                (at_c, at_d, True, 1.0),
                (at_a, at_c, False, 0.0),
                (at_b, at_d, False, 1.0),
            ):
                *ends, exists = _clip(first, last)
                for end in ends:
                    rest = torch.full_like(end, other)
                    found.append((torch.stack([end, rest] if is_horizontal else [rest, end], -1), exists))
            for point in quad:
                found += list(zip(*_solve(coordinates[b], point)))
            for uv, exists in found:
                position = (corner + size * uv) @ directions[b, n].mT  # (H - 1, W - 1, 4)
                for row, counts in ((0, exists & is_inside), (1, exists)):
                    values = torch.where(counts[..., None], position, -torch.inf).flatten(0, 1).amax(0)
                    extent[row] = torch.maximum(extent[row], values)
    return extents.flatten(2)


def _points_reference(
    points: Tensor, coordinates: Tensor, kinds: Tensor, x: Tensor, y: Tensor, margin: int
) -> tuple[Tensor, Tensor]:
    """The positions that read at points, and their kinds."""
    positions, kinds_of = torch.full_like(points, torch.nan), torch.zeros_like(points[..., 0], dtype=torch.uint8)
    for b, of_sample in enumerate(points):
        is_inside = torch.stack(_cells(kinds[b] > 0)).all(0)
        nodes = torch.stack([x.expand(*kinds.shape[1:]), y.mT.expand(*kinds.shape[1:])], -1)
        size = _cells(nodes)[3] - _cells(nodes)[0]
        for n, point in enumerate(of_sample):
            miss = (coordinates[b] - point).square().sum(-1)
            at = torch.where(kinds[b] == PIXEL, miss, torch.inf).flatten().argmin()
            has_pixel = (kinds[b] == PIXEL).any()
            pixel = torch.where(has_pixel, nodes.flatten(0, 1)[at], 0)
            uv, exists = _solve(coordinates[b], point)
            exact = _cells(nodes)[0] + size * uv
            distance = (exact - pixel).square().sum(-1)
            best = []
            for counts in (exists & is_inside, exists & ~is_inside):
                keys = torch.where(counts, distance, torch.inf).flatten()
                best.append((keys.amin(), exact.flatten(0, 2)[keys.argmin()]))
            (inner, inner_position), (outer, outer_position) = best
            is_exact, is_read = inner <= NEAR_PIXEL**2, inner.isfinite() & has_pixel
            outside = torch.where(has_pixel, pixel + point - coordinates[b].flatten(0, 1)[at], torch.nan)
            outside = torch.where(outer.isfinite(), outer_position, outside)
            positions[b, n] = torch.where(is_exact, inner_position, torch.where(is_read, pixel, outside))
            kinds_of[b, n] = torch.where(is_exact, EXACT, torch.where(is_read, NEAREST_PIXEL, INVISIBLE))
    return positions, kinds_of


_preimage_extents = register(
    "preimage_extents",
    _extents_reference,
    fake=lambda quads, *_: (*quads.shape[:2], 8),
    non_differentiable=(0,),
)
_preimage_points = register(
    "preimage_points",
    _points_reference,
    fake=lambda points, *_: [points.new_empty(points.shape), points.new_empty(points.shape[:2], dtype=torch.uint8)],
    casts_outputs=True,
    non_differentiable=(0, 1),
)


# --- maps of a result -----------------------------------------------------------------------------------------------


class ResultMap(NamedTuple):
    """Where the nodes of a result read an image."""

    coordinates: Tensor  # (B, H, W, 2)
    kinds: Tensor  # uint8 (B, H, W)
    x: Tensor  # (1, W), of columns
    y: Tensor  # (1, H), of rows
    margin: int  # cells at each side that are outside of the result

    def extents(self, quads: Tensor, directions: Tensor) -> Tensor:
        """The largest products of directions (B, N, 4, 2) with the positions that read within quadrilaterals (B, N, 4, 2).

        (B, N, 2, 4): of those that the result shows, and of all; -inf where there are none. The quadrilaterals are convex.
        """
        y: Tensor = _preimage_extents(quads.flatten(2), directions.expand_as(quads).flatten(2), *self)
        return y.unflatten(2, (2, 4))

    def positions(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """The positions (B, N, 2) that read points, and their kinds, uint8 (B, N): INVISIBLE, NEAREST_PIXEL or EXACT."""
        positions, kinds = _preimage_points(points, *self)
        return positions, kinds


def result_map(
    size: Sequence[int], reach: int, like: Tensor, read: Callable[[Tensor, int], tuple[Tensor, Tensor]]
) -> ResultMap:
    """The map of results of a size (H, W).

    Args:
        size: height and width.
        reach: how many pixels around the result are known as well, at least.
        like: a tensor of the type and on the device of the map.
        read: gives for positions (H, W, 2) the coordinates (B, H, W, 2) that they read, and whether they read an image, bool (B,
            H, W). Its second argument is the number of rows and columns before the first pixel.
    """
    margin = margin_of(reach)
    y, x = (_node_positions(n, margin, like) for n in size)
    height, width = len(y), len(x)
    nodes = torch.stack([x.expand(height, width), y[:, None].expand(height, width)], -1)
    coordinates, reads = read(nodes, margin + 1)
    is_shown = shown_nodes(height, width, margin, like.device)
    return ResultMap(coordinates, is_shown * reads, x[None], y[None], margin)


def margin_of(reach: int) -> int:
    """How many cells there are at each side of a result that reach so many pixels from it, at least."""
    return max(int(reach), 1).bit_length() + 1


def shown_nodes(height: int, width: int, margin: int, device: torch.device) -> Tensor:
    """The kinds (H, W) of the nodes of a result, all of which read an image."""
    kinds = torch.zeros(height, width, dtype=torch.uint8, device=device)
    kinds[margin : height - margin, margin : width - margin] = INSIDE
    kinds[margin + 1 : height - margin - 1, margin + 1 : width - margin - 1] = PIXEL
    return kinds


def at_nodes(nodes: Tensor, displacements: Tensor, margin: int) -> Tensor:
    """What nodes (H, W, 2) read by a map, (B, H, W, 2); outside of it displacements are those of its border."""
    return nodes + F.pad(displacements, 4 * [margin], mode="replicate").movedim(1, -1)


def find_positions(displacements: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Where the pixels of a result are that read an image at points (B, N, 2), and the kinds of positions."""
    size = displacements.shape[-2:]

    def read(nodes: Tensor, margin: int) -> tuple[Tensor, Tensor]:
        read_everywhere = torch.ones(len(displacements), *nodes.shape[:2], dtype=torch.bool, device=nodes.device)
        return at_nodes(nodes, displacements, margin), read_everywhere

    return result_map(size, 4 * max(size), displacements, read).positions(points.to(displacements))


def _node_positions(pixels: int, margin: int, like: Tensor) -> Tensor:
    """Positions of nodes along an axis: pixels, the edges of the first and the last one, and `margin` nodes outside."""
    beyond = 0.5 * 2.0 ** torch.arange(1, margin + 1, dtype=like.dtype, device=like.device)
    edge = like.new_full((1,), -0.5)
    pixel = torch.arange(pixels, dtype=like.dtype, device=like.device)
    return torch.cat([edge - beyond.flip(0), edge, pixel, edge + pixels, edge + pixels + beyond])
