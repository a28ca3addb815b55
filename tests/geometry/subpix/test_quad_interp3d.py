"""Peaks between voxels."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import OpTests, assert_close

kornia = pytest.importorskip("kornia")
G = K.geometry


def smooth(shape: tuple[int, ...]) -> Tensor:
    """Volumes whose peaks are not at the edge of a decision: near their voxel, or so far that they wander."""
    if len(shape) == 6:
        return torch.stack([smooth(shape[1:])] * shape[0])
    grid = torch.meshgrid(*[torch.arange(n, dtype=torch.float64) for n in shape[2:]], indexing="ij")
    total = torch.zeros(shape[2:], dtype=torch.float64)
    for i, (z, y, x) in enumerate([(1.2, 2.3, 2.1), (2.3, 5.8, 6.3), (1.7, 2.2, 9.1), (2.8, 7.1, 10.3)]):
        distance = (grid[0] - z) ** 2 + (grid[1] - y) ** 2 + (grid[2] - x) ** 2
        total += (0.7 + 0.1 * i) * torch.exp(-distance / 3)
    scale = 1 + 0.1 * torch.arange(shape[0] * shape[1], dtype=torch.float64)
    return scale.view(*shape[:2], 1, 1, 1) * total


class TestConvQuadInterp3d(OpTests):
    function = staticmethod(G.conv_quad_interp3d)
    module = G.ConvQuadInterp3d
    operators = ("conv_quad_interp3d", "conv_quad_interp3d_backward")
    shape = (2, 2, 5, 10, 13)
    small = (1, 1, 3, 5, 4)
    max_size = 5
    variants = [{}, {"n_iters": 2, "allow_scale_steps": False}]
    tolerances = {torch.float32: (2e-4, 2e-4), torch.float16: (1e-2, 2e-2), torch.bfloat16: (5e-2, 1e-1)}
    errors = [
        ({"n_iters": -1}, ValueError, "n_iters"),
        ({"precomputed_nms_mask": lambda x: torch.ones(2, 2)}, TypeError, "precomputed_nms_mask to be bool"),
    ]

    def input(self, shape, dtype, device):
        if dtype in (torch.uint8, torch.float16, torch.bfloat16):
            # What rounding makes equal is no strict maximum: multiples of a number that all types have.
            x = (smooth(shape) * 8).round()
            return x.to(dtype).to(device)
        return smooth(shape).to(dtype).to(device)

    def test_fuzz(self, device):
        pytest.skip("in float32 another voxel may be the largest")

    @pytest.fixture(autouse=True)
    def same_bits_where_asked(self, device, request):
        """On CUDA gradients are sums by atomics, unless torch is asked for the same bits every run."""
        asks = request.function.__name__ in ("test_threads_and_runs_give_the_same_bits", "test_gradcheck")
        torch.use_deterministic_algorithms(device.type == "cuda" and asks, warn_only=True)
        yield
        torch.use_deterministic_algorithms(False)


VOLUME = (2, 1, 4, 6, 7)


class TestQuadraticFunctions(CompositionTests):
    cases = {
        "iterative_quad_interp3d": Case(
            lambda x: G.iterative_quad_interp3d(x, max_candidates=2)[1], (VOLUME,), differentiable=False
        ),
    }
    compiled = ()


@pytest.mark.parametrize("name", ["conv_quad_interp3d", "iterative_quad_interp3d"])
def test_refined_peaks_are_kornias(name, device):
    x = torch.rand(2, 2, 9, 24, 27, dtype=torch.float64, device=device)
    x = torch.nn.functional.avg_pool3d(torch.nn.functional.avg_pool3d(x, 3, 1), 3, 1).requires_grad_()
    for options in [{}, {"n_iters": 1}, {"n_iters": 10, "max_subpixel_shift": 0.5}, {"allow_scale_steps": False}]:
        pairs = [getattr(module, name)(x, **options) for module in (G, kornia.geometry.subpix)]
        assert_close(*pairs)
        weights = [torch.randn_like(y) for y in pairs[0]]
        assert_close(*(torch.autograd.grad(pair, x, weights)[0] for pair in pairs), 1e-7, 1e-7)


def test_few_candidates_and_masks(device):
    x = smooth((2, 2, 5, 10, 13)).to(device)
    every, none = G.iterative_quad_interp3d(x), G.iterative_quad_interp3d(x, max_candidates=0)
    some = kornia.geometry.subpix.iterative_quad_interp3d(x, max_candidates=2)
    assert_close(G.iterative_quad_interp3d(x, max_candidates=2), some)
    assert torch.equal(none[1], x)
    assert (every[1] != x).sum() == 4 * 4
    assert_close(G.iterative_quad_interp3d(x, precomputed_nms_mask=G.nms3d(x, (3, 3, 3), True)), every)
    assert_close(G.AdaptiveQuadInterp3d("patch")(x), every)
    with pytest.raises(ValueError, match="mode must be one of patch, conv, auto"):
        G.AdaptiveQuadInterp3d("dense")


def test_a_peak_between_voxels_is_found(device):
    z, y, x = torch.meshgrid(*[torch.arange(7, dtype=torch.float64, device=device)] * 3, indexing="ij")
    volume = -((x - 3.3) ** 2 + 2 * (y - 2.8) ** 2 + (z - 3.1) ** 2 + (x - 3.3) * (y - 2.8))
    coords, values = K.ConvQuadInterp3d(10)(volume[None, None])
    expected = torch.tensor([3.1, 3.3, 2.8], dtype=torch.float64, device=device)
    assert_close(coords[0, 0, :, 3, 3, 3], expected, 1e-9, 1e-9)
    assert_close(values[0, 0, 3, 3, 3], torch.zeros_like(values[0, 0, 0, 0, 0]), 1e-9, 1e-9)


def test_strict_maxima_bonus_is_deprecated():
    x = torch.rand(1, 1, 3, 4, 5)
    for call in (
        lambda: G.conv_quad_interp3d(x, strict_maxima_bonus=10.0),
        lambda: K.ConvQuadInterp3d(strict_maxima_bonus=1.0),
        lambda: G.conv_soft_argmax3d(x, strict_maxima_bonus=0.0),
    ):
        with pytest.warns(DeprecationWarning, match="strict_maxima_bonus has no effect"):
            call()


def test_flat_volumes_and_thin_ones_have_finite_gradients(device):
    for shape in [(1, 1, 5, 6, 7), (1, 1, 2, 6, 7), (1, 1, 5, 1, 1)]:
        x = torch.ones(shape, device=device, requires_grad=True)
        coords, values = G.conv_quad_interp3d(x, precomputed_nms_mask=torch.ones_like(x, dtype=torch.bool))
        (coords.sum() + values.sum()).backward()
        assert_close(x.grad, torch.ones_like(x))
