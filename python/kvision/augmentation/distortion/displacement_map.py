"""Maps of lenses, vortices and grids from the numbers of each sample, by one operator."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from kvision._modes import MAP_KIND, MAP_KIND_NAMES
from kvision._ops import register


def _pixels(count: int, like: Tensor) -> Tensor:
    return torch.arange(count, dtype=like.dtype, device=like.device)


def _lens(rows: Tensor, numbers: Sequence[float], height: int, width: int) -> Tensor:
    """By Brown and Conrady: k1 and k2 of each sample; x and y of the center and of the focal length."""
    center_x, center_y, focal_x, focal_y = numbers
    x, y = _pixels(width, rows) - center_x, (_pixels(height, rows) - center_y)[:, None]
    square = (x / focal_x) ** 2 + (y / focal_y) ** 2
    k1, k2 = rows[:, :, None, None].unbind(1)
    more = square * (k1 + square * k2)
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
    """A scale, rows and columns of nodes, and moves along x and y of the most nodes: their rows and columns, and a unit."""
    most_rows, most_columns, unit, _ = numbers
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


_KINDS: dict[str, Callable[[Tensor, Sequence[float], int, int], Tensor]] = {
    "lens": _lens,
    "swirl": _swirl,
    "cells": _cells,
    "triangles": _triangles,
}


def _reference(rows: Tensor, kind: int, numbers: Sequence[float], size: Sequence[int]) -> Tensor:
    """Displacements (B, 2, H, W) of a kind from rows (B, n) of numbers; those of all samples are four."""
    return _KINDS[MAP_KIND_NAMES[kind]](rows, numbers, size[0], size[1])


_displacement_map = register(
    "displacement_map", _reference, fake=lambda rows, kind, numbers, size: (rows.shape[0], 2, *size)
)


def displacement_map(kind: str, rows: Tensor, size: Sequence[int], *numbers: float) -> Tensor:
    """The map (B, 2, H, W) of a kind, as maps.py stores it, from the numbers (B, n) of samples, and those of all."""
    four = [*map(float, numbers), *[0.0] * (4 - len(numbers))]
    y: Tensor = _displacement_map(rows, MAP_KIND[kind], four, list(size))
    return y
