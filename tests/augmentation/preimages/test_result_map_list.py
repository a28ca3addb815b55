"""Positions of the results of a list that read given points, and the inside of quadrilaterals: as of each by itself."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.augmentation.preimages.result_map import result_map
from kvision.augmentation.preimages.result_map_list import NodeReading, ResultMapList, displaced, result_map_list
from kvision.geometry.linalg import transform_points
from kvision.geometry.transform.lists.remap_list import packed

SIDES = [20, 30, 1, 1, 33, 17, 2, 40]
SIZES = list(zip(SIDES[::2], SIDES[1::2]))
REACHES = [4 * max(size) for size in SIZES]
MOVED = [True, False, True, True]
EVERY, NONE = [True] * 4, [False] * 4
NORMALS = torch.tensor([[-1.0, 0], [1, 0], [0, -1], [0, 1]])


def fields(device: torch.device, dtype: torch.dtype = torch.float32) -> list[Tensor]:
    """Displacements (2, H, W) of those that are moved."""
    sizes = [size for size, own in zip(SIZES, MOVED) if own]
    return [3 * torch.randn(2, h, w, dtype=dtype, device=device) for h, w in sizes]


def matrices(device: torch.device, dtype: torch.dtype = torch.float32) -> Tensor:
    change = torch.randn(4, 3, 3, dtype=dtype, device=device) * torch.tensor([[0.1], [0.1], [1e-3]], device=device)
    return torch.eye(3, dtype=dtype, device=device) + change * torch.tensor([1.0, 1, 20], device=device)


def queries(device: torch.device, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    """Points (B, N, 2) and quadrilaterals (B, N, 4, 2)."""
    points = 40 * torch.rand(4, 50, 2, dtype=dtype, device=device) - 5
    sides = torch.tensor([[0.0, 0], [5, 0], [5, 4], [0, 4]], device=device)
    return points, 30 * torch.rand(4, 9, 1, 2, dtype=dtype, device=device) + sides


def chained(maps: Tensor, matrix: Tensor) -> ResultMapList:
    """A map, then a matrix, then another map."""
    readings = [
        NodeReading(maps, SIDES, MOVED, [True, True, False, True]),
        NodeReading(matrix, SIDES, NONE, EVERY),
        NodeReading(maps, SIDES, MOVED, NONE),
    ]
    return result_map_list(SIDES, REACHES, readings)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_kernels_are_the_reference(dtype: torch.dtype, device: torch.device) -> None:
    maps, matrix, (points, quads) = packed(fields(device, dtype)), matrices(device, dtype), queries(device, dtype)
    found = []
    for backend in ("reference", "native"):
        with K.backend(backend):
            known = chained(maps, matrix)
            positions, kinds = known.positions(points)
            found.append((known.coordinates, known.kinds, positions, kinds, known.extents(quads, NORMALS.to(quads))))
    for reference, native in zip(*found):
        torch.testing.assert_close(native, reference, rtol=1e-4, atol=2e-3, equal_nan=True)


def test_maps_are_those_of_each_result(device: torch.device) -> None:
    """Bit by bit, as nodes are at pixels or beyond the border."""
    own_fields = iter(fields(device))
    each = [next(own_fields) if own else torch.zeros(2, *size, device=device) for size, own in zip(SIZES, MOVED)]
    points, quads = queries(device)
    maps = packed([field for field, own in zip(each, MOVED) if own])
    known = result_map_list(SIDES, REACHES, [NodeReading(maps, SIDES, MOVED, NONE)])
    positions, kinds = known.positions(points)
    extents = known.extents(quads, NORMALS.to(quads))
    for b, (size, field) in enumerate(zip(SIZES, each)):

        def read(nodes: Tensor, margin: int, field: Tensor = field) -> tuple[Tensor, Tensor]:
            beyond = torch.nn.functional.pad(field[None], 4 * [margin], mode="replicate")
            return nodes + beyond.movedim(1, -1), torch.ones(1, *nodes.shape[:2], dtype=torch.bool, device=device)

        own = result_map(size, REACHES[b], points, read)
        of_point, kind = own.positions(points[b : b + 1])
        assert torch.equal(positions[b], of_point[0]) and torch.equal(kinds[b], kind[0])
        assert torch.equal(extents[b], own.extents(quads[b : b + 1], NORMALS.to(quads))[0])


def test_points_are_displaced_as_nodes_are(device: torch.device) -> None:
    maps, matrix = packed(fields(device)), matrices(device)
    known = result_map_list(
        SIDES, REACHES, [NodeReading(matrix, SIDES, NONE, NONE), NodeReading(maps, SIDES, MOVED, NONE)]
    )
    at, begin = transform_points(matrix, torch.zeros(4, 1, 2, device=device)), 0
    moved = displaced(at, maps, SIDES, MOVED)
    for b, ((h, w), reach) in enumerate(zip(SIZES, REACHES)):
        margin = known.margins[b]
        assert 2**margin > reach
        across = w + 2 * margin + 2
        first = known.coordinates[begin + (margin + 1) * (across + 1)]
        torch.testing.assert_close(first, moved[b, 0], rtol=1e-5, atol=1e-4)
        begin += across * (h + 2 * margin + 2)


def test_gradients_of_displaced_points(device: torch.device) -> None:
    maps = packed(fields(device, torch.float64)).requires_grad_()
    points = (0.1 + 0.8 * torch.rand(4, 3, 2, dtype=torch.float64, device=device)).requires_grad_()
    torch.autograd.gradcheck(lambda p, m: displaced(p, m, SIDES, MOVED), (points, maps))


def test_more_results_than_a_launch_has(device: torch.device) -> None:
    count, offset = 600, torch.tensor([2.0, -1.0])
    sides = [3, 4] * count
    maps = packed([offset[:, None, None].expand(2, 3, 4).to(device)] * count)
    known = result_map_list(sides, [9] * count, [NodeReading(maps, sides, [True] * count, [False] * count)])
    points = torch.rand(count, 2, 2, device=device) * torch.tensor([3.0, 2], device=device)
    positions, _ = known.positions(points + offset.to(device))
    torch.testing.assert_close(positions, points, rtol=0, atol=4e-3)


def test_wrong_sizes_are_refused(device: torch.device) -> None:
    maps = torch.zeros(32, device=device)
    with K.backend("native"), pytest.raises(RuntimeError, match="expected maps of 16 numbers"):
        result_map_list([2, 3], [9], [NodeReading(maps, [2, 3], [True], [False])])
    with K.backend("native"), pytest.raises(RuntimeError, match="sizes of results"):
        result_map_list([3, 3], [9], [NodeReading(maps[:16], [2, 3], [True], [False])])
