"""Maps from the numbers of samples. Against OpenCV, NumPy and the formulas of their models: test_distortions.py."""

import pytest
import torch

from kvision._modes import MAP_KIND
from kvision.augmentation.distortion.displacement_map import _displacement_map, displacement_map
from op_tests import assert_close
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector


def triangles() -> torch.Tensor:
    """A scale, 3 of at most 4 rows, 2 of at most 3 columns, and moves of all."""
    moves = torch.randn(2 * 4 * 3, dtype=torch.float64)
    return torch.cat([torch.tensor([0.1, 3.0, 2.0], dtype=torch.float64), moves])


def of_kind(kind: str, row: object, numbers: list[float], size: tuple[int, int] = (7, 9)) -> Call:
    return Call(
        (row,),
        (MAP_KIND[kind], numbers, list(size)),
        dtypes=SINGLE_AND_DOUBLE,
        tolerance=20,
        accepted=("rows", "kind 0", "size", "numbers"),
        differentiable=kind != "triangles",  # of which two numbers are whole
    )


class TestDisplacementMapOperators(PointOpTests):
    calls = {
        "displacement_map": [
            of_kind("lens", vector(2), [4.5, 3.5, 9.0, 7.0]),
            of_kind("swirl", vector(4), [0.0] * 4),
            of_kind("cells", vector(10), [1.0, 0.0, 0.0, 0.0]),
            of_kind("cells", vector(6), [0.0] * 4),
            of_kind("triangles", triangles, [4.0, 3.0, 7 / 3, 0.0]),
        ]
    }


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (33, 2), (70, 101)], ids=str)
def test_all_sizes(size, device):
    rows = {
        "lens": (torch.rand(3, 2) - 0.5, (size[1] / 2, size[0] / 2, *size[::-1])),
        "swirl": (torch.rand(3, 4) + 0.1, ()),
        "cells": (torch.rand(3, 14) + 0.1, (1,)),
        "triangles": (torch.stack([triangles().float() for _ in range(3)]), (4, 3, 5.0)),
    }
    for kind, (x, numbers) in rows.items():
        y = displacement_map(kind, x.to(device), size, *numbers).cpu()
        four = [*map(float, numbers), *[0.0] * (4 - len(numbers))]
        expected = _displacement_map.reference(x.double(), MAP_KIND[kind], four, list(size))
        assert_close(y, expected.float(), 1e-5, 1e-4)


def test_scales_and_moves_of_triangles_get_gradients(device):
    row = triangles().to(device)[None]

    def moved(scale: torch.Tensor, moves: torch.Tensor) -> torch.Tensor:
        return displacement_map("triangles", torch.cat([scale, row[:, 1:3], moves], 1), (6, 8), 4, 3, 2.0)

    assert torch.autograd.gradcheck(moved, (row[:, :1].requires_grad_(), row[:, 3:].detach().requires_grad_()))
