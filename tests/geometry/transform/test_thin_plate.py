import contextlib

import kornia
import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from kvision.geometry.transform.thin_plate import _map, _points, _weights
from op_tests import assert_close, instruction_set
from point_op_tests import SINGLE_AND_DOUBLE, SQUARE, Call, PointOpTests, vector

G = K.geometry


def rand(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def through(image: Tensor, points: Tensor, moves: Tensor) -> Tensor:
    return G.warp_image_tps(image, points, *G.get_tps_transform(points, points + 0.1 * moves))


class TestSplines(CompositionTests):
    cases = {
        "image": Case(through, ((2, 3, 4, 5), (2, 6, 2), (2, 6, 2))),
        "points": Case(G.warp_points_tps, ((2, 5, 2), (2, 4, 2), (2, 4, 2), (2, 3, 2))),
        "weights": Case(lambda p, q: torch.cat(G.get_tps_transform(p, q), 1), ((2, 5, 2), (2, 5, 2))),
    }
    compiled = ("image",)


# --- kernels --------------------------------------------------------------------------------------------------------

# More points than one part has, more centers than are summed at once, and systems that do not fit shared memory.
CALLS = {
    "points": (_points, [(2, 1500, 2), (2, 40, 2), (2, 40, 2), (2, 3, 2)], ()),
    "one_spline": (_points, [(3, 5, 2), (1, 1, 2), (3, 1, 2), (1, 3, 2)], ()),
    "map": (_map, [(2, 33, 2), (2, 33, 2), (1, 3, 2)], ([33, 70], True)),
    "column": (_map, [(1, 2, 2), (1, 2, 2), (1, 3, 2)], ([7, 1], False)),
    "no_centers": (_map, [(1, 0, 2), (1, 0, 2), (1, 3, 2)], ([2, 3], False)),
    "weights": (_weights, [(2, 90, 2), (2, 93, 2)], ()),
    "one_system": (_weights, [(1, 4, 2), (3, 7, 2)], ()),
}


@pytest.mark.native
@pytest.mark.parametrize("isa", ["avx512", "avx2", "baseline"])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
@pytest.mark.parametrize("name", CALLS)
def test_kernels_against_the_reference(name, dtype, isa, device):
    operator, shapes, plain = CALLS[name]
    leaves = [rand(*shape, seed=i).to(dtype).to(device).requires_grad_() for i, shape in enumerate(shapes)]
    with instruction_set(isa) if device.type == "cpu" else contextlib.nullcontext():
        result = operator(*leaves, *plain)
        grad = rand(*result.shape).to(dtype).to(device)
        gradients = torch.autograd.grad(result, leaves, grad)
    wide = [x.detach().double().requires_grad_() for x in leaves]
    with K.backend("reference"):
        expected = operator(*wide, *plain)
        theirs = torch.autograd.grad(expected, wide, grad.double())
    for actual, reference in zip((result, *gradients), (expected, *theirs)):
        size = 1 + reference.abs().max().item() if reference.numel() else 1
        assert_close(actual, reference.to(dtype), 0, (1e-11 if dtype == torch.float64 else 1e-5) * size)


def test_parts_of_larger_tensors(device):
    """The weights and the affine part of `get_tps_transform` are parts of one tensor."""
    both, points = rand(2, 8, 2).to(device), rand(2, 6, 2).to(device)
    parts = both[:, :5], both[:, 5:]
    assert not parts[0].is_contiguous()
    assert_close(_points(points, points[:, :5], *parts), _points(points, *(x.clone() for x in (points[:, :5], *parts))))


# --- values ---------------------------------------------------------------------------------------------------------


def test_weights_solve_the_system_of_a_plane_map(device):
    """An affine map needs no kernels."""
    points, turn = rand(2, 30, 2).to(device), torch.tensor([[0.3, -0.9], [1.1, 0.2]]).double().to(device)
    weights, affine = G.get_tps_transform(points, points @ turn + 0.7)
    assert_close(weights, torch.zeros_like(weights), 0, 1e-10)
    assert_close(affine, torch.cat([torch.full_like(turn[:1], 0.7), turn]).expand(2, 3, 2), 0, 1e-10)


@pytest.mark.parametrize("align_corners", [True, False])
def test_images_of_kornia(align_corners, device):
    image, centers, weights = (rand(*s, seed=i) for i, s in enumerate(((2, 3, 20, 31), (2, 7, 2), (2, 7, 2))))
    affine = torch.eye(3)[:, 1:].double().expand(2, 3, 2)
    # Kornia's align_corners is that of its grid sampling; its pixels always lie from -1 to 1 at the middles.
    ours = G.warp_image_tps(*(x.to(device) for x in (image, centers, 0.1 * weights, affine)), align_corners)
    assert ours.shape == image.shape
    if align_corners:
        theirs = kornia.geometry.transform.warp_image_tps(image, centers, 0.1 * weights, affine, True)
        assert_close(ours.cpu(), theirs)


def test_points_of_any_type(device):
    points = torch.tensor([[[0, 1], [2, 3]]], device=device)
    identity = (torch.zeros(1, 1, 2, device=device), torch.zeros(1, 1, 2, device=device))
    affine = torch.tensor([[[0.0, 0], [1, 0], [0, 1]]], device=device)
    assert_close(G.warp_points_tps(points, *identity, affine), points.float())
    half = G.warp_points_tps(points.half(), *identity, affine)
    assert half.dtype == torch.float16 and torch.equal(half, points.half())


QUAD = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])


def test_splines_go_through_their_points(device):
    p, q = torch.rand(2, 9, 2, device=device) * 2 - 1, torch.rand(2, 9, 2, device=device)
    assert_close(G.warp_points_tps(p, p, *G.get_tps_transform(p, q)), q, 0, 1e-4)


IMAGE = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1)).double()
FUNCTIONS = {
    "spline": (
        lambda x, p, q: G.warp_image_tps(x, p, *G.get_tps_transform(p, q)),
        (IMAGE, 0.3 * QUAD - 0.9, 0.29 * QUAD - 0.83),
    ),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


BAD = [
    (lambda: G.get_tps_transform(QUAD, QUAD[0]), ValueError, "get_tps_transform: expected points_dst of shape"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


SPLINE = vector(4, 2), vector(4, 2), vector(3, 2)


class TestThinPlateOperators(PointOpTests):
    calls = {
        "thin_plate_points": [
            Call(
                (vector(5, 2), *SPLINE), accepted=("points cut along axis -2",), dtypes=SINGLE_AND_DOUBLE, tolerance=20
            )
        ],
        "thin_plate_map": [
            Call(SPLINE, ([3, 4], True), accepted=("grad cut",), dtypes=SINGLE_AND_DOUBLE, tolerance=20)
        ],
        "thin_plate_weights": [
            Call((lambda: SQUARE / 4 + 0.2 * torch.rand(4, 2), vector(7, 2)), dtypes=SINGLE_AND_DOUBLE, tolerance=100)
        ],
    }
