"""Maps from the numbers of samples. Against OpenCV, NumPy and the formulas of their models: test_distortions.py."""

import pytest
import torch

from kvision._modes import MAP_KIND
from kvision.augmentation.distortion.displacement_map import MapFormula, _displacement_map, _displacement_map_list
from kvision.geometry.transform.lists.remap_list import unpacked
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
            of_kind("camera", vector(2), [0.0] * 3),
            of_kind("fisheye_lens", vector(1), [0.0] * 3),
            of_kind("swirl", vector(4), [0.0] * 3),
            of_kind("cells", vector(10), [1.0, 0.0, 0.0]),
            of_kind("cells", vector(6), [0.0] * 3),
            of_kind("triangles", triangles, [4.0, 3.0, 0.0]),
            of_kind("fisheye", vector(3), [0.0] * 3),
            of_kind("thin_plate", vector(26), [0.0] * 3),
            of_kind("thin_plate", vector(10), [1.0, 0.0, 0.0]),
        ]
    }


def formulas(count: int) -> list[MapFormula]:
    return [
        MapFormula("camera", torch.rand(count, 2) - 0.5),
        MapFormula("fisheye_lens", torch.rand(count, 1) - 0.5),
        MapFormula("swirl", torch.rand(count, 4) + 0.1),
        MapFormula("cells", torch.rand(count, 14) + 0.1, (1,)),
        MapFormula("triangles", torch.stack([triangles().float() for _ in range(count)]), (4, 3)),
        MapFormula("triangles", torch.stack([triangles().float() for _ in range(count)]), (4, 3, True)),
        MapFormula("fisheye", torch.rand(count, 3) + 0.1),
        MapFormula("fisheye", torch.rand(count, 3) - 1.2),
        MapFormula("thin_plate", torch.randn(count, 26)),
        MapFormula("thin_plate", torch.randn(count, 26), (True,)),
    ]


SIZES = [(1, 1), (1, 40), (33, 2), (70, 101)]


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_all_sizes(size, device):
    for formula in formulas(3):
        y = formula._replace(rows=formula.rows.to(device)).map(size).cpu()
        expected = _displacement_map.reference(formula.rows.double(), *formula._arguments(), list(size))
        assert_close(y, expected.float(), 1e-5, max(1e-4, 1e-5 * float(expected.abs().max())))


@pytest.mark.parametrize("dtype", SINGLE_AND_DOUBLE, ids=str)
def test_maps_of_a_list(dtype, device):
    """The bits of each map alone, 0 where it is not chosen; gradients of all rows."""
    sides, count = [side for size in SIZES for side in size], len(SIZES)
    chosen = torch.tensor([1.0, 0.0, 1.0, 1.0], device=device)
    for formula in formulas(count):
        own = formula._replace(rows=formula.rows.to(device, dtype))
        for is_chosen in (None, chosen):
            each = unpacked(own.maps(sides, is_chosen), sides)
            for b, (of_list, size) in enumerate(zip(each, SIZES)):
                alone = own._replace(rows=own.rows[b : b + 1]).map(size)[0]
                assert torch.equal(of_list, alone if is_chosen is None else alone * chosen[b])
        rows = own.rows.clone().requires_grad_()
        (grad,) = torch.autograd.grad(own._replace(rows=rows).maps(sides, chosen).sin().sum(), rows)
        maps = [own._replace(rows=rows[b : b + 1]).map(size) for b, size in enumerate(SIZES)]
        (alone,) = torch.autograd.grad(sum((y * c).sin().sum() for y, c in zip(maps, chosen)), rows)
        assert_close(grad, alone, 1e-3, 1e-3)


def test_more_maps_than_a_table_has(device):
    rows, sides = torch.rand(1600, 4, device=device) + 0.1, [side for b in range(1600) for side in (1 + b % 3, 2)]
    each = unpacked(MapFormula("swirl", rows).maps(sides), sides)
    for b in (0, 511, 1535, 1536, 1599):
        assert torch.equal(each[b], MapFormula("swirl", rows[b : b + 1]).map(sides[2 * b : 2 * b + 2])[0])


def test_scales_and_moves_of_triangles_get_gradients(device):
    row = triangles().to(device)[None]

    def moved(scale: torch.Tensor, moves: torch.Tensor) -> torch.Tensor:
        return MapFormula("triangles", torch.cat([scale, row[:, 1:3], moves], 1), (4, 3)).map((6, 8))

    assert torch.autograd.gradcheck(moved, (row[:, :1].requires_grad_(), row[:, 3:].detach().requires_grad_()))


def test_arguments_of_maps_of_a_list(backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    with pytest.raises(RuntimeError, match="height and width of 2 maps"):
        _displacement_map_list(torch.rand(2, 4), None, MAP_KIND["swirl"], [0.0] * 3, [3, 4])
