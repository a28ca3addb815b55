"""Expectations over images, and heat maps of Gaussians."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from kvision._ops import FLOATS
from op_tests import TOLERANCES, OpTests, assert_close, instruction_set
from point_op_tests import Call, PointOpTests, vector

kornia = pytest.importorskip("kornia")
G = K.geometry


class TestSpatialSoftArgmax2d(OpTests):
    function = staticmethod(G.spatial_soft_argmax2d)
    module = G.SpatialSoftArgmax2d
    operators = ("spatial_expectation", "spatial_expectation_backward")
    mixed = ("input",)  # positions of half types are computed in float32
    max_size = 9
    variants = [{}, {"normalized_coordinates": False, "temperature": 0.2}]
    # Numbers of pixels: those of a half have as many digits as its type.
    tolerances = {torch.float32: (2e-5, 5e-6), torch.bfloat16: (1.6e-2, 4e-2), torch.float16: (2e-3, 4e-3)}
    errors = [({"temperature": -1.0}, ValueError, "temperature to be positive")]


class TestSpatialExpectation2d(OpTests):
    function = staticmethod(G.spatial_expectation2d)
    operators = ("spatial_expectation", "spatial_expectation_backward")
    mixed = ("input",)
    max_size = 9
    variants = [{"normalized_coordinates": True}]
    tolerances = {torch.float32: (2e-5, 1e-4)}  # sums over a thousand weights that do not add up to 1
    errors = [({"normalized_coordinates": 1}, TypeError, "normalized_coordinates to be a bool")]

    test_compile = test_export = test_opcheck = None  # as of the operator's other function


IMAGE = (2, 3, 5, 7)


class TestSpatialFunctions(CompositionTests):
    cases = {
        "spatial_softmax2d": Case(G.spatial_softmax2d, (IMAGE,)),
        "spatial_soft_argmax2d": Case(lambda x, t: G.spatial_soft_argmax2d(x, t[0, 0]), (IMAGE, (1, 1)), (1,)),
        "render_gaussian2d": Case(lambda m, s: G.render_gaussian2d(m, s, (4, 6)), ((3, 2), (3, 2))),
    }
    compiled = ("spatial_soft_argmax2d", "render_gaussian2d")


def test_softmax_of_few_large_planes(device):
    x = 5 * torch.randn(1, 2, 400, 401, dtype=torch.float64, device=device)
    x[..., :9] = -torch.inf
    x.requires_grad_()
    y, expected = G.spatial_softmax2d(x), x.flatten(2).softmax(-1).view(x.shape)
    assert_close(y, expected)
    weights = torch.rand_like(y)
    assert_close(*(torch.autograd.grad((p * weights).sum(), x)[0] for p in (y, expected)), 1e-9, 1e-12)


def gaussians(mean: Tensor, std: Tensor, size: tuple[int, int], normalized: bool) -> list[Tensor]:
    """Maps, and the gradients of a sum of theirs."""
    leaves = [x.detach().requires_grad_() for x in (mean, std)]
    maps = G.render_gaussian2d(*leaves, size, normalized)
    weights = torch.linspace(-1, 1, maps.numel(), dtype=torch.float64).sin().bfloat16().to(maps)
    return [maps.detach(), *torch.autograd.grad((maps * weights.reshape(maps.shape)).sum(), leaves)]


@pytest.mark.parametrize("dtype", FLOATS, ids=str)
@pytest.mark.parametrize("size", [(4, 6), (3, 16), (9, 33), (2, 520), (67, 300)])
def test_gaussians(size, dtype, device):
    """Few pixels, whole vectors and what is beyond them, several pieces; standard deviations of all, of each, of axes."""
    mean = 2 * torch.rand(2, 3, 2, dtype=torch.float64) - 1
    for std, normalized in (
        (torch.rand(2, 3, 2) + 0.2, True),
        (torch.rand(2) + 2, False),
        (torch.rand(3, 2) + 0.5, True),
    ):
        args = [x.to(dtype).to(device) for x in (mean, std)]
        with K.backend("reference"):
            expected = gaussians(*(x.double() for x in args), size, normalized)
        for a, e in zip(gaussians(*args, size, normalized), expected, strict=True):
            relative, absolute = TOLERANCES[dtype]
            assert_close(a, e.to(dtype), 4 * relative, 4 * absolute * max(float(e.abs().max()), 0.02))


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_gaussians_by_instruction_sets(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the CPU's kernels")
    with instruction_set(isa):
        test_gaussians((9, 33), torch.float32, device)


def test_gaussians_far_away_or_narrow(device):
    """All of the weight is on the nearest pixels, and gradients are finite."""
    mean = torch.tensor([[2.0, 3], [-1e6, 1e6], [1e6, 3], [4.0, 0]], device=device)
    maps, *gradients = gaussians(mean, torch.full_like(mean, 1e-3), (6, 7), False)
    positions = [int(m.argmax()) for m in maps]
    assert positions == [23, 35, 27, 4]
    assert (maps.flatten(1).amax(1) == 1).all() and all(g.isfinite().all() for g in gradients)
    assert G.render_gaussian2d(mean, 0 * mean, (6, 7)).isnan().all()
    assert G.render_gaussian2d(mean[:0], mean[:0], (6, 7)).shape == (0, 6, 7)


def test_spatial_is_kornias(device):
    x = torch.randn(2, 3, 6, 9, dtype=torch.float64, device=device)
    mean, std = torch.rand(2, 4, 2, device=device).double() - 0.5, torch.rand(2, 4, 2, device=device).double() + 0.1
    for normalized in (True, False):
        for function in ("spatial_soft_argmax2d", "spatial_expectation2d"):
            result, expected = (
                getattr(module, function)(x, normalized_coordinates=normalized) for module in (G, kornia.geometry)
            )
            assert_close(result, expected)
        assert_close(
            *(module.render_gaussian2d(mean, std, (7, 8), normalized) for module in (G, kornia.geometry.subpix))
        )
    assert_close(G.spatial_softmax2d(x, 0.2), kornia.geometry.subpix.spatial_softmax2d(x, 0.2))


class TestSpatialOperators(PointOpTests):
    calls = {
        "render_gaussian2d": [
            Call((vector(2), lambda: torch.rand(2) + 0.5), (4, 6, normalized), accepted=("32768",))
            for normalized in (True, False)
        ],
    }
