"""Where the pixels of the results of a list are that read its images: result_map.py for results of a size each, together.

The maps of a list are one tensor, one after the other, each as large as its result needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision._ops import register
from kvision.augmentation.labels import is_within
from kvision.augmentation.preimages.result_map import (
    _extents_reference,
    _node_positions,
    _points_reference,
    margin_of,
    shown_nodes,
)
from kvision.geometry.linalg import transform_points
from kvision.geometry.transform.lists.remap_list import packed_size, unpacked

# --- the operators --------------------------------------------------------------------------------------------------

# preimage_extents_list and preimage_points_list take what those of a batch take, but coordinates (N, 2) and kinds (N,) of the nodes
# of all results, and for these height and width and the cells at each side that are outside.


def _axes(size: Sequence[int], margin: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """The positions (1, W) of columns and (1, H) of rows of nodes."""
    y, x = (_node_positions(n, margin, like)[None] for n in size)
    return x, y


def _split(nodes: Tensor, sides: Sequence[int], margins: Sequence[int]) -> list[Tensor]:
    """Numbers (N, ...) of nodes as (H, W, ...) of each result."""
    shapes = [(h + 2 * m + 2, w + 2 * m + 2) for h, w, m in zip(sides[::2], sides[1::2], margins)]
    each = nodes.split([h * w for h, w in shapes])
    return [own.unflatten(0, shape) for own, shape in zip(each, shapes)]


def _maps(coordinates: Tensor, kinds: Tensor, sides: Sequence[int], margins: Sequence[int]) -> list[tuple[Any, ...]]:
    """The arguments of each result by itself."""
    every = zip(_split(coordinates, sides, margins), _split(kinds, sides, margins), sides[::2], sides[1::2], margins)
    return [(at[None], kind[None], *_axes((h, w), m, at), m) for at, kind, h, w, m in every]


def _extents_list_reference(quads: Tensor, directions: Tensor, *nodes: Any) -> Tensor:
    maps = _maps(*nodes)
    each = [_extents_reference(q, d, *own) for q, d, own in zip(quads.split(1), directions.split(1), maps)]
    return torch.cat(each) if each else quads.new_empty(quads.shape)


def _points_list_reference(points: Tensor, *nodes: Any) -> tuple[Tensor, Tensor]:
    each = [_points_reference(p, *own) for p, own in zip(points.split(1), _maps(*nodes))]
    positions, kinds = zip(*each)
    return torch.cat(positions), torch.cat(kinds)


_preimage_extents_list = register(
    "preimage_extents_list",
    _extents_list_reference,
    fake=lambda quads, *_: (*quads.shape[:2], 8),
    flatten=lambda *_: None,  # of a list there is no vmap
    non_differentiable=(0,),
)
_preimage_points_list = register(
    "preimage_points_list",
    _points_list_reference,
    fake=lambda points, *_: [points.new_empty(points.shape), points.new_empty(points.shape[:2], dtype=torch.uint8)],
    casts_outputs=True,
    flatten=lambda *_: None,
    non_differentiable=(0, 1),
)

# Arguments of read_nodes_list: matrices (B, 3, 3) from results to images, or displacements of some images as `remap_list` takes
# them; coordinates and kinds of nodes that another step read, or None and None; height and width of the images; which of them are
# displaced; of which nodes outside show nothing; height and width of results, and the cells at each side that are outside.


def _read_nodes_reference(
    link: Tensor,
    coordinates: Tensor | None,
    kinds: Tensor | None,
    before: Sequence[int],
    moved: Sequence[int],
    bounded: Sequence[int],
    sides: Sequence[int],
    margins: Sequence[int],
) -> tuple[Tensor, Tensor]:
    is_map, of_nodes = link.dim() == 1, []
    displaced_sides = [n for b, own in enumerate(moved) if own for n in before[2 * b : 2 * b + 2]]
    maps = iter(unpacked(link, displaced_sides) if is_map else [])
    given = None if coordinates is None or kinds is None else (coordinates, kinds)
    each = None if given is None else list(zip(*(_split(x, sides, margins) for x in given)))
    for b, margin in enumerate(margins):
        size, image = sides[2 * b : 2 * b + 2], before[2 * b : 2 * b + 2]
        x, y = _axes(size, margin, link)
        if each is not None:
            at, kind = each[b]
        else:
            at = torch.stack([x.expand(y.shape[1], -1), y.mT.expand(-1, x.shape[1])], -1)
            kind = shown_nodes(y.shape[1], x.shape[1], margin, link.device)
        if not is_map:
            at = transform_points(link[b : b + 1], at.flatten(0, 1)[None])[0].unflatten(0, at.shape[:2])
        elif moved[b]:
            at = displaced(at.flatten(0, 1)[None], next(maps).flatten(), image, [True])[0].unflatten(0, at.shape[:2])
        if bounded[b]:
            kind = kind * is_within(at, image, margin=1.0)
        of_nodes.append((at.flatten(0, 1), kind.flatten()))
    at, kind = zip(*of_nodes)
    return torch.cat(at), torch.cat(kind)


def displaced(points: Tensor, maps: Tensor, sides: Sequence[int], moved: Sequence[bool]) -> Tensor:
    """Points (B, N, 2) moved by displacements, which are bilinear between pixels, of those images that have some.

    The maps are as `remap_list` takes them, `sides` height and width of all images.
    """
    begins, end = [], 0
    for height, width, is_own in zip(sides[::2], sides[1::2], moved):
        begins.append(end)
        end += packed_size([height, width]) if is_own else 0
    known = [(n, h, w) if own else (0, 1, 1) for n, h, w, own in zip(begins, sides[::2], sides[1::2], moved)]
    begin, height, width = on_device(torch.tensor(known, device="cpu").mT[..., None], points.device)
    last = torch.stack([width, height], -1) - 1
    inside = points.nan_to_num(0.0).clamp(min=0).minimum(last.to(points))
    first = inside.detach().floor()
    (u, v), (left, top) = (inside - first).unbind(-1), first.long().unbind(-1)
    right, bottom = (left + 1).minimum(width - 1), (top + 1).minimum(height - 1)
    along = []
    for plane in (begin, begin + height * width):
        a, b, c, d = (maps[plane + rows * width + columns] for rows in (top, bottom) for columns in (left, right))
        above = a + u * (b - a)
        along.append(above + v * (c + u * (d - c) - above))
    y = points + torch.stack(along, -1)
    if all(moved):
        return y
    return torch.where(on_device(torch.tensor(moved, device="cpu"), y.device)[:, None, None], y, points)


def _node_count(sides: Sequence[int], margins: Sequence[int]) -> int:
    return sum((h + 2 * m + 2) * (w + 2 * m + 2) for h, w, m in zip(sides[::2], sides[1::2], margins))


def _read_nodes_fake(link: Tensor, *args: Any) -> list[Tensor]:
    count = _node_count(*args[-2:])
    return [link.new_empty(count, 2), link.new_empty(count, dtype=torch.uint8)]


_read_nodes_list = register(
    "read_nodes_list",
    _read_nodes_reference,
    fake=_read_nodes_fake,
    casts_outputs=True,
    flatten=lambda *_: None,
    non_differentiable=(0, 1),
)

# --- maps of results ------------------------------------------------------------------------------------------------


class ResultMapList(NamedTuple):
    """Where the nodes of the results of a list read its images."""

    coordinates: Tensor  # (N, 2)
    kinds: Tensor  # uint8 (N,)
    sides: list[int]  # height and width of each result
    margins: list[int]  # cells at each side that are outside of the result

    def extents(self, quads: Tensor, directions: Tensor) -> Tensor:
        """As those of :class:`ResultMap`."""
        y: Tensor = _preimage_extents_list(quads.flatten(2), directions.expand_as(quads).flatten(2), *self)
        return y.unflatten(2, (2, 4))

    def positions(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """As those of :class:`ResultMap`."""
        positions, kinds = _preimage_points_list(points, *self)
        return positions, kinds


class NodeReading(NamedTuple):
    """How nodes of results read images: a step of the way back."""

    link: Tensor  # matrices (B, 3, 3) from results to images, or displacements of those that are moved
    before: Sequence[int]  # height and width of the images
    moved: Sequence[bool]  # which of these are displaced
    bounded: Sequence[bool]  # of which positions outside show nothing


def result_map_list(sides: Sequence[int], reaches: Sequence[int], readings: Sequence[NodeReading]) -> ResultMapList:
    """The maps of results for height and width of each, from which steps lead to the images, the last one first.

    `reaches` say how many pixels around the results are known as well, at least.
    """
    margins = [margin_of(reach) for reach in reaches]
    nodes: tuple[Tensor | None, Tensor | None] = None, None
    for link, before, moved, bounded in readings:
        flags = [[int(own) for own in each] for each in (moved, bounded)]
        coordinates, kinds = _read_nodes_list(link, *nodes, list(before), *flags, list(sides), margins)
        nodes = coordinates, kinds
    return ResultMapList(coordinates, kinds, list(sides), margins)
