"""Chains of matrices and maps on lists: the coordinates of each image alone, and their gradients."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.transform.composed.composed_warp import composed_coords, link_arguments
from kvision.geometry.transform.composed.link_coords_list import composed_coords_list, link_coords_list
from kvision.geometry.transform.lists.remap_list import packed, unpacked
from op_tests import assert_close

SIZES = ((20, 30), (41, 17), (1, 1), (5, 64), (12, 9))  # of results
BEFORE = ((11, 8), (3, 70), (1, 5), (16, 16), (1, 1))  # of maps
SIDES, SIDES_BEFORE = ([n for size in sizes for n in size] for sizes in (SIZES, BEFORE))


def matrices(device, dtype=torch.float32, count=5):
    scale = torch.tensor([[0.05, 0.05, 2], [0.05, 0.05, 2], [1e-3, 1e-3, 0]])
    return (torch.eye(3) + torch.randn(count, 3, 3) * scale).to(device, dtype)


def maps(sizes, device, dtype=torch.float32):
    return [3 * torch.randn(2, *size, device=device, dtype=dtype) for size in sizes]


def chains(device, dtype=torch.float32):
    """Links of each chain, and the same of each image alone."""
    first, last, matrix = maps(BEFORE, device, dtype), maps(SIZES, device, dtype), matrices(device, dtype)
    links = {"a": (packed(first), SIDES_BEFORE), "z": (packed(last), SIDES), "m": (matrix, ()), "n": (matrix[:1], ())}
    alone = {"a": first, "z": last, "m": matrix, "n": matrix[:1].expand(len(SIZES), 3, 3)}
    names = ("m", "n", "z", "mz", "am", "amz", "az", "mazmn")
    return [([links[i] for i in name], [[alone[i][b] for i in name] for b in range(len(SIZES))]) for name in names]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_coordinates_are_those_of_each_image(dtype, device):
    for links, each in chains(device, dtype):
        read = composed_coords_list(links, SIDES)
        for own, size, alone in zip(unpacked(read, SIDES), SIZES, each, strict=True):
            expected = composed_coords(*link_arguments([link[None] for link in alone], size), list(size))
            assert_close(own[None], expected, 1e-5, 1e-5)
        with K.backend("reference"):
            known = unpacked(composed_coords_list(links, SIDES), SIDES)
        for own, reference in zip(unpacked(read, SIDES), known):
            assert_close(own, reference, 1e-3, 1e-3)


@pytest.mark.derivatives
def test_derivatives(device):
    sizes, before = [2, 3, 4, 1], [3, 2, 2, 2]
    first, last = (packed(maps([(s[0], s[1]), (s[2], s[3])], device, torch.float64)) for s in (before, sizes))
    matrix = matrices(device, torch.float64, 2)

    def read(a: Tensor, m: Tensor, z: Tensor) -> tuple[Tensor, ...]:
        return tuple(unpacked(composed_coords_list([(a, before), (m, ()), (z, sizes)], sizes), sizes))

    assert torch.autograd.gradcheck(read, [x.requires_grad_() for x in (first, matrix, last)])


def test_long_lists_are_those_of_their_parts(device):
    sizes = [(4 + i % 7, 5 + i % 3) for i in range(520)]
    sides, matrix, displaced = [n for size in sizes for n in size], matrices(device, count=520), maps(sizes, device)
    all_of_them = unpacked(composed_coords_list([(matrix, ()), (packed(displaced), sides)], sides), sides)
    part = [(matrix[510:], ()), (packed(displaced[510:]), sides[1020:])]
    assert all(map(torch.equal, all_of_them[510:], unpacked(composed_coords_list(part, sides[1020:]), sides[1020:])))


def test_arguments(device, backend):
    if backend == "reference":
        pytest.skip("the reference has no checks")
    matrix, coordinates = matrices(device), link_coords_list(matrices(device), None, [], SIDES)
    for arguments in (
        (matrix[1:], None, [], SIDES),
        (matrix, coordinates[1:], [], SIDES),
        (matrix, coordinates.double(), [], SIDES),
        (matrix, None, SIDES, SIDES),
        (packed(maps(BEFORE, device)), None, SIDES, SIDES),
        (matrix.half(), None, [], SIDES),
    ):
        with pytest.raises(RuntimeError, match="link_coords_list: expected"):
            torch.ops.kvision.link_coords_list(*arguments)
