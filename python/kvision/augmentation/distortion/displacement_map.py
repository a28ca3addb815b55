"""Maps of lenses, vortices, grids and splines from the numbers of each sample, by one operator.

The numbers do not depend on the size of the image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from kvision._modes import MAP_KIND, MAP_KIND_NAMES
from kvision._ops import register
from kvision.geometry.linalg import root
from kvision.geometry.transform.lists.remap_list import packed, packed_size
from kvision.geometry.transform.thin_plate import warp_points_tps


def _pixels(count: int, like: Tensor) -> Tensor:
    return torch.arange(count, dtype=like.dtype, device=like.device)


def _camera(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """By Brown and Conrady: k1 and k2 of each sample; the focal lengths are width and height."""
    x, y = _pixels(width, rows) - width / 2, (_pixels(height, rows) - height / 2)[:, None]
    square = (x / width) ** 2 + (y / height) ** 2
    k1, k2 = rows[:, :, None, None].unbind(1)
    return _farther(x, y, square * (k1 + square * k2))


def _fisheye_lens(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """By Kannala and Brandt: k1 of each sample; the corners are at an angle of 1 radian."""
    x, y = _pixels(width, rows) - (width - 1) / 2, (_pixels(height, rows) - (height - 1) / 2)[:, None]
    return _farther(x, y, (x * x + y * y) / ((width * width + height * height) / 4) * rows[:, :, None])


def _farther(x: Tensor, y: Tensor, more: Tensor) -> Tensor:
    """Displacements of pixels at x and y from the center by so many times their distance."""
    return torch.stack([x * more, y * more], 1)


def _swirl(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """Strength, radius as a fraction of the shorter side, x and y of the center as fractions of the sides."""
    strength, radius, center_x, center_y = rows[:, :, None, None].unbind(1)
    x = _pixels(width, rows) - (center_x * width - 0.5)
    y = _pixels(height, rows)[:, None] - (center_y * height - 0.5)
    distance = (x * x + y * y).sqrt()
    angle = strength * (-5 * math.log(2) / (radius * min(height, width)) * distance).exp()
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([x * (cos - 1) - y * sin, x * sin + y * (cos - 1)], 1)


def _cells(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """Factors of columns, then of rows, of equal cells; whether these are divided by their mean."""

    def along(factors: Tensor, size: int) -> Tensor:
        count = factors.shape[1]
        total = factors.sum(1, keepdim=True) if numbers[0] else count
        sides = factors / total  # of what cells show, as fractions of the image
        first = sides.cumsum(1) - sides
        at = (_pixels(size, rows) + 0.5) * (count / size)
        cell = at.floor().long().clamp(max=count - 1)
        return (first[:, cell] + sides[:, cell] * (at - cell) - at / count) * size

    of_columns, of_rows = rows.chunk(2, 1)
    x, y = along(of_columns, width)[:, None], along(of_rows, height)[:, :, None]
    return torch.stack([x.expand(-1, height, -1), y.expand(-1, -1, width)], 1)


def _triangles(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """A scale, rows and columns of nodes, and moves along x and y of the most nodes: their rows and columns, and whether scales
    are in pixels, not fractions of the shorter side.
    """
    most_rows, most_columns, is_absolute = numbers
    unit = (1 if is_absolute else min(height, width)) / 3
    (scale, *counts), moves = rows[:, :3].unbind(1), rows[:, 3:].unflatten(1, (2, int(most_rows), int(most_columns)))
    moves = moves * scale[:, None, None, None] * unit
    at, corners, place = [], [], []
    for count, most, size in zip(counts[::-1], moves.shape[:1:-1], (width, height)):
        count = count[:, None]
        corners.append(_pixels(most, rows) * (size - 1) / (count - 1))  # beyond the image where there are fewer
        pixel = _pixels(size, rows) * ((count - 1) / max(size - 1, 1))
        cell = pixel.floor().minimum(count - 2)
        at.append(cell.long())
        place.append(pixel - cell)
    node_x, node_y = corners[0][:, None], corners[1][:, :, None]
    moved_x = (node_x + moves[:, 0]).clamp(0, width - 1) - node_x
    moved_y = (node_y + moves[:, 1]).clamp(0, height - 1) - node_y
    nodes = torch.stack([moved_x, moved_y], 1)  # (B, 2, R, C)
    u, v = place[0][:, None, None], place[1][:, None, :, None]
    a, b, c, d = (_nodes_at(nodes, at[1] + down, at[0] + right) for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)))
    upper = a + (b - a) * u + (c - a) * v  # of the triangle with a, to the left of the diagonal from b to c
    lower = d + (c - d) * (1 - u) + (b - d) * (1 - v)
    return torch.where(u + v <= 1, upper, lower)


def _nodes_at(nodes: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Values (B, 2, H, W) of nodes (B, 2, R, C) at rows (B, H) and columns (B, W)."""
    at = rows[:, :, None] * nodes.shape[3] + columns[:, None]
    return nodes.flatten(2).gather(2, at.flatten(1)[:, None].expand(-1, 2, -1)).unflatten(2, at.shape[1:])


def _grid(height: int, width: int, like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(2, H, W): the coordinates x and y of the pixels, from -1 to 1 at the centers of the outermost ones; pixels from there."""
    half = [(n - 1) / 2 for n in (width, height)]
    x, y = (_pixels(n, like) - h for n, h in zip((width, height), half))
    pixels = torch.stack([x.expand(height, width), y[:, None].expand(height, width)])
    units = [at / h if h else at - 1 for at, h in zip(pixels, half)]
    return torch.stack(units), pixels, units[0].new_tensor(half)


def _fisheye(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """x and y of the center and gamma: the pixel at g reads the image at g (1 + |g - center| ** gamma)."""
    grid, pixels, _ = _grid(height, width, rows)
    radius = root((grid - rows[:, :2, None, None]).square().sum(1, keepdim=True))
    gamma = rows[:, 2:, None, None]
    nearest = radius.clamp(min=2.0**-10)  # so that the center reads a finite position
    return pixels * torch.where(gamma < 0, nearest, radius) ** gamma


def _thin_plate(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """Centers, their weights and the affine part of a spline; whether -1 and 1 are the centers of the outermost pixels."""
    less = 1 if numbers[0] else 0
    _, pixels, _ = _grid(height, width, rows)
    half = torch.stack([rows.new_full((1, 1), (n - less) / 2) for n in (width, height)])
    grid = torch.where(half > 0, pixels / half, 0.0)
    count = (rows.shape[1] - 6) // 4
    centers, weights, affine = rows.unflatten(1, (-1, 2)).split((count, count, 3), 1)
    points = grid.flatten(1).mT.expand(len(rows), -1, 2)
    moved = warp_points_tps(points, centers, weights, affine).mT.unflatten(2, (height, width))
    return (moved - grid) * half


_KINDS: dict[str, Callable[[Tensor, Sequence[float], int, int], Tensor]] = {
    "camera": _camera,
    "fisheye_lens": _fisheye_lens,
    "swirl": _swirl,
    "cells": _cells,
    "triangles": _triangles,
    "fisheye": _fisheye,
    "thin_plate": _thin_plate,
}


def _reference(rows: Tensor, kind: int, numbers: Sequence[float], size: Sequence[int]) -> Tensor:
    """Displacements (B, 2, H, W) of a kind from rows (B, n) of numbers; those of all samples are three."""
    return _KINDS[MAP_KIND_NAMES[kind]](rows, numbers, size[0], size[1])


def _list_reference(
    rows: Tensor, chosen: Tensor | None, kind: int, numbers: Sequence[float], sides: Sequence[int]
) -> Tensor:
    """Of each row a map of a size of its own, 0 where it is not chosen (B,)."""
    each = [_reference(row, kind, numbers, sides[2 * b : 2 * b + 2])[0] for b, row in enumerate(rows.split(1))]
    if chosen is not None:
        each = [torch.where(is_own != 0, own, 0.0) for is_own, own in zip(chosen, each)]
    return packed(each)


_displacement_map = register(
    "displacement_map", _reference, fake=lambda rows, kind, numbers, size: (rows.shape[0], 2, *size)
)
_displacement_map_list = register(
    "displacement_map_list",
    _list_reference,
    fake=lambda rows, chosen, kind, numbers, sides: (packed_size(sides),),
    flatten=lambda *_: None,  # of a list there is no vmap
)


class MapFormula(NamedTuple):
    """A kind of maps, the numbers (B, n) of samples, and those of all."""

    kind: str
    rows: Tensor
    numbers: tuple[float, ...] = ()

    def map(self, size: Sequence[int]) -> Tensor:
        """The map (B, 2, H, W) as maps.py stores it."""
        y: Tensor = _displacement_map(self.rows, *self._arguments(), list(size))
        return y

    def maps(self, sides: Sequence[int], chosen: Tensor | None = None) -> Tensor:
        """The maps of a list for height and width of each image, as `remap_list` takes them; 0 where not `chosen`, (B,) float32."""
        y: Tensor = _displacement_map_list(self.rows, chosen, *self._arguments(), list(sides))
        return y

    def _arguments(self) -> tuple[int, list[float]]:
        return MAP_KIND[self.kind], [*map(float, self.numbers), *[0.0] * (3 - len(self.numbers))]
