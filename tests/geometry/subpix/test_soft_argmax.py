"""Peaks: strict maxima, the soft argmax of windows, and places between voxels."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
import raw_calls
from composition_tests import Case, CompositionTests
from kvision._ops import FLOATS
from op_tests import TOLERANCES, OpTests, assert_close, instruction_set

kornia = pytest.importorskip("kornia")
G = K.geometry


class TestNms2d(OpTests):
    function = staticmethod(G.nms2d)
    module = G.NonMaximaSuppression2d
    operators = ("local_maxima", "keep_marked")
    mixed = ("input",)  # flags have a type of their own
    variants = [{"kernel_size": (3, 3)}, {"kernel_size": (5, 5)}, {"kernel_size": (2, 5)}]
    max_size = 9
    errors = [
        ({"kernel_size": (0, 3)}, ValueError, "kernel_size to be an int or 2 ints of at least 1"),
        ({"kernel_size": (3.0, 3)}, TypeError, "kernel_size"),
        ({"mask_only": 1}, TypeError, "mask_only to be a bool"),
    ]

    def test_all_small_sizes(self, variant, sizes, device):
        """Maxima too near the rim are none: nothing is left of images as small as the window."""
        super().test_all_small_sizes(variant, sizes, device)
        x = torch.rand(1, 1, 2, 9, device=device)
        assert not G.nms2d(x, (3, 3)).any()


class TestNms3d(OpTests):
    function = staticmethod(G.nms3d)
    module = G.NonMaximaSuppression3d
    operators = ("local_maxima", "keep_marked")
    mixed = ("input",)  # flags have a type of their own
    variants = [{"kernel_size": (3, 3, 3)}, {"kernel_size": (1, 2, 5)}]
    shape = (2, 3, 5, 9, 12)
    small = (1, 1, 3, 4, 5)
    max_size = 5


class TestConvSoftArgmax2d(OpTests):
    function = staticmethod(G.conv_soft_argmax2d)
    module = G.ConvSoftArgmax2d
    operators = ("soft_argmax", "soft_argmax_backward")
    max_size = 7
    variants = [
        {"kernel_size": (5, 5), "padding": (2, 2), "output_value": True},
        {"normalized_coordinates": False, "temperature": 0.5},
        {"kernel_size": (2, 4), "stride": (2, 3), "padding": (1, 2), "output_value": True},
    ]
    # Numbers of pixels: those of a half have as many digits as its type.
    tolerances = {torch.float32: (2e-5, 5e-6), torch.bfloat16: (1.6e-2, 4e-2), torch.float16: (2e-3, 4e-3)}
    errors = [
        ({"padding": (3, 3)}, ValueError, r"padding of at most half of kernel_size \(5, 5\)"),
        ({"temperature": 0.0}, ValueError, "temperature to be positive"),
        ({"stride": 0}, ValueError, "stride"),
        ({"kernel_size": (40, 3), "padding": 0}, ValueError, "input of at least a window"),
        ({"temperature": lambda x: torch.ones(3)}, ValueError, "temperature of one number"),
    ]


class TestSpatialSoftArgmax2d(OpTests):
    function = staticmethod(G.spatial_soft_argmax2d)
    module = G.SpatialSoftArgmax2d
    operators = ("mean_place", "mean_place_backward")
    mixed = ("input",)  # places of half types are computed in float32
    max_size = 9
    variants = [{}, {"normalized_coordinates": False, "temperature": 0.2}]
    tolerances = TestConvSoftArgmax2d.tolerances
    errors = [({"temperature": -1.0}, ValueError, "temperature to be positive")]


class TestSpatialExpectation2d(OpTests):
    function = staticmethod(G.spatial_expectation2d)
    operators = ("mean_place", "mean_place_backward")
    mixed = ("input",)
    max_size = 9
    variants = [{"normalized_coordinates": True}]
    tolerances = {torch.float32: (2e-5, 1e-4)}  # sums over a thousand weights that do not add up to 1
    errors = [({"normalized_coordinates": 1}, TypeError, "normalized_coordinates to be a bool")]

    test_compile = test_export = test_opcheck = None  # as of the operator's other function


class TestConvSoftArgmax3d(OpTests):
    function = staticmethod(G.conv_soft_argmax3d)
    module = G.ConvSoftArgmax3d
    operators = ("soft_argmax", "soft_argmax_backward")
    shape = (2, 3, 4, 9, 12)
    small = (1, 1, 3, 3, 4)
    max_size = 4
    variants = [{}, {"normalized_coordinates": True, "stride": (1, 2, 1), "output_value": False}]
    tolerances = TestConvSoftArgmax2d.tolerances


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
    operators = ("quadratic_peaks", "quadratic_peaks_backward")
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


IMAGE = (2, 3, 5, 7)
VOLUME = (2, 1, 4, 6, 7)


class TestCompositions(CompositionTests):
    cases = {
        "spatial_softmax2d": Case(G.spatial_softmax2d, (IMAGE,)),
        "spatial_soft_argmax2d": Case(lambda x, t: G.spatial_soft_argmax2d(x, t[0, 0]), (IMAGE, (1, 1)), (1,)),
        "conv_soft_argmax2d": Case(
            lambda x, t: G.conv_soft_argmax2d(x, temperature=t[0, 0], output_value=True)[1], (IMAGE, (1, 1)), (1,)
        ),
        "render_gaussian2d": Case(lambda m, s: G.render_gaussian2d(m, s, (4, 6)), ((3, 2), (3, 2))),
        "nms3d_minmax": Case(lambda x: torch.stack(G.nms3d_minmax(x), 1).float(), (VOLUME,), differentiable=False),
        "nms2d mask": Case(lambda x: G.nms2d(x, (3, 3), mask_only=True).float(), (IMAGE,), differentiable=False),
        "iterative_quad_interp3d": Case(
            lambda x: G.iterative_quad_interp3d(x, max_candidates=2)[1], (VOLUME,), differentiable=False
        ),
    }
    compiled = ("spatial_soft_argmax2d", "conv_soft_argmax2d", "render_gaussian2d", "nms3d_minmax", "nms2d mask")


# --- heat maps of Gaussians -----------------------------------------------------------------------------------------


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
        given = [x.to(dtype).to(device) for x in (mean, std)]
        with K.backend("reference"):
            expected = gaussians(*(x.double() for x in given), size, normalized)
        for a, e in zip(gaussians(*given, size, normalized), expected, strict=True):
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
    maps, *slopes = gaussians(mean, torch.full_like(mean, 1e-3), (6, 7), False)
    places = [int(m.argmax()) for m in maps]
    assert places == [23, 35, 27, 4]
    assert (maps.flatten(1).amax(1) == 1).all() and all(g.isfinite().all() for g in slopes)
    assert G.render_gaussian2d(mean, 0 * mean, (6, 7)).isnan().all()
    assert G.render_gaussian2d(mean[:0], mean[:0], (6, 7)).shape == (0, 6, 7)


def test_gaussians_as_operators(device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    rows = [torch.rand(3, 2, device=device), torch.rand(3, 2, device=device) + 0.5]
    operators = torch.ops.kvision.gaussian_maps.default, torch.ops.kvision.gaussian_maps_backward.default
    grad = torch.rand_like(operators[0](*rows, 4, 6, True))
    for op, given in zip(operators, ([*rows, 4, 6, True], [grad, *rows, True])):
        torch.library.opcheck(op, tuple(given), test_utils=("test_schema", "test_faketensor"))
        wrong = [
            call
            for call in raw_calls.wrong_calls(op, given)
            if str(2**15) not in call[0] and "without rows" not in call[0]
        ]
        taken = raw_calls.taken(op, wrong)
        assert not taken, "\n".join(taken)


# --- against Kornia -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [(3, 3), (5, 5), (7, 7), (2, 3), (4, 5), (1, 1)])
def test_nms_is_kornias(window, device):
    x = torch.rand(2, 2, 17, 19, device=device)
    assert torch.equal(G.nms2d(x, window), kornia.geometry.nms2d(x, window))
    volume = x[:, :, None].repeat(1, 1, 4, 1, 1) + torch.rand(2, 2, 4, 17, 19, device=device)
    for found, expected in zip(G.nms3d_minmax(volume), kornia.geometry.nms3d_minmax(volume)):
        assert torch.equal(found, expected)
    size = (3, *window)
    assert torch.equal(G.nms3d(volume, size, True), kornia.geometry.nms3d(volume, size, True))


def test_equal_neighbours_and_nan_are_no_maxima(device):
    x = torch.zeros(1, 1, 5, 5, device=device)
    x[0, 0, 2, 2:4] = 1
    assert not G.nms2d(x, (3, 3)).any()
    x[0, 0, 2, 3] = float("nan")
    assert not G.nms2d(x, (3, 3)).any()


@pytest.mark.parametrize("normalized", [True, False])
def test_soft_argmax_is_kornias(normalized, device):
    x = (3 * torch.randn(2, 2, 9, 11, dtype=torch.float64, device=device)).requires_grad_()
    for how in [((5, 5), (1, 1), (2, 2), 0.3), ((2, 4), (2, 1), (1, 2), 2.0)]:
        pairs = [module.conv_soft_argmax2d(x, *how, normalized, output_value=True) for module in (G, kornia.geometry)]
        assert_close(*pairs)
        weights = [torch.randn_like(y) for y in pairs[0]]
        assert_close(*(torch.autograd.grad(pair, x, weights)[0] for pair in pairs))
    volume = torch.randn(1, 2, 4, 7, 8, dtype=torch.float64, device=device)
    how = {"stride": (1, 2, 1), "normalized_coordinates": normalized}
    assert_close(G.conv_soft_argmax3d(volume, **how), kornia.geometry.conv_soft_argmax3d(volume, **how))


def test_spatial_is_kornias(device):
    x = torch.randn(2, 3, 6, 9, dtype=torch.float64, device=device)
    mean, std = torch.rand(2, 4, 2, device=device).double() - 0.5, torch.rand(2, 4, 2, device=device).double() + 0.1
    for normalized in (True, False):
        for function in ("spatial_soft_argmax2d", "spatial_expectation2d"):
            found, expected = (
                getattr(module, function)(x, normalized_coordinates=normalized) for module in (G, kornia.geometry)
            )
            assert_close(found, expected)
        assert_close(
            *(module.render_gaussian2d(mean, std, (7, 8), normalized) for module in (G, kornia.geometry.subpix))
        )
    assert_close(G.spatial_softmax2d(x, 0.2), kornia.geometry.subpix.spatial_softmax2d(x, 0.2))


@pytest.mark.parametrize("name", ["conv_quad_interp3d", "iterative_quad_interp3d"])
def test_refined_peaks_are_kornias(name, device):
    x = torch.rand(2, 2, 9, 24, 27, dtype=torch.float64, device=device)
    x = torch.nn.functional.avg_pool3d(torch.nn.functional.avg_pool3d(x, 3, 1), 3, 1).requires_grad_()
    for how in [{}, {"n_iters": 1}, {"n_iters": 10, "max_subpixel_shift": 0.5}, {"allow_scale_steps": False}]:
        pairs = [getattr(module, name)(x, **how) for module in (G, kornia.geometry.subpix)]
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
    places, values = K.ConvQuadInterp3d(10)(volume[None, None])
    expected = torch.tensor([3.1, 3.3, 2.8], dtype=torch.float64, device=device)
    assert_close(places[0, 0, :, 3, 3, 3], expected, 1e-9, 1e-9)
    assert_close(values[0, 0, 3, 3, 3], torch.zeros_like(values[0, 0, 0, 0, 0]), 1e-9, 1e-9)


def test_the_old_bonus_warns():
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
        places, values = G.conv_quad_interp3d(x, precomputed_nms_mask=torch.ones_like(x, dtype=torch.bool))
        (places.sum() + values.sum()).backward()
        assert_close(x.grad, torch.ones_like(x))
