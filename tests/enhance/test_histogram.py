"""Density estimates: their sums, their peaks and their memory."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import kvision as K
import raw_calls
from kvision import _ops
from kvision.enhance.histogram import kernel_counts
from op_tests import assert_close, instruction_set, pairwise, recorded
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector

E = K.enhance


def test_counts_of_a_wide_kernel_sum_to_the_pixels(device):
    """The triangles of neighboring bins add up to one."""
    x = torch.rand(2, 3, 20, 30, device=device) * 200 + 20
    counts, pdf = E.image_histogram2d(x, return_pdf=True)
    assert_close(counts.sum(-1), torch.full((2, 3), 600.0, device=device))
    assert_close(pdf.sum(-1), torch.ones(2, 3, device=device))


def test_narrow_kernels_count_exactly(device):
    x = torch.randint(0, 10, (2, 50), device=device)
    expected = torch.stack([row.bincount(minlength=10) for row in x]) / 50.0
    bins, width = torch.arange(10.0, device=device), torch.tensor(0.05, device=device)
    assert_close(E.histogram(x, bins, width), expected)
    joint = E.histogram2d(x, 9 - x, bins, width)
    assert_close(joint, torch.diag_embed(expected).flip(-1))


def test_numbers_on_bin_edges(device):
    """A value between two centers belongs to both by halves, a value on a center to its bin alone; outside to none."""
    image = torch.tensor([[0.0, 0.5, 1.0, 2.5, 3.0, 4.0, float("nan")]], device=device)
    counts, _ = E.image_histogram2d(image, 0.0, 3.0, 3)
    assert_close(counts, torch.tensor([2.0, 0.5, 1.5], device=device))
    uniform, _ = E.image_histogram2d(image, 0.0, 3.0, 3, kernel="uniform")
    assert_close(uniform, torch.tensor([3.0, 3.0, 2.0], device=device))


@pytest.mark.parametrize("kernel", ["triangular", "uniform", "epanechnikov"])
def test_compact_kernels_reach_few_bins(kernel):
    """The same counts as with the centers given, which takes all bins."""
    x = torch.rand(2, 1, 9, 9, dtype=torch.float64, requires_grad=True)
    centers = (torch.arange(20, dtype=torch.float64) + 0.5) / 20
    few = E.image_histogram2d(x, 0.0, 1.0, 20, kernel=kernel)[0]
    all_bins = E.image_histogram2d(x, 0.0, 1.0, 20, centers=centers, kernel=kernel)[0]
    assert_close(few, all_bins)
    if kernel != "uniform":
        weights = torch.rand_like(few)
        assert_close(*(torch.autograd.grad((y * weights).sum(), x)[0] for y in (few, all_bins)))


def test_gradients_to_bins_and_bandwidth():
    x, y = (torch.rand(2, 7, dtype=torch.float64, requires_grad=True) for _ in range(2))
    bins = torch.rand(5, dtype=torch.float64, requires_grad=True)
    width = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    for check in (torch.autograd.gradcheck, torch.autograd.gradgradcheck):
        assert check(E.histogram, (x, bins, width))
        assert check(E.histogram2d, (x, y, bins, width))


def test_transforms():
    x, bins, width = torch.rand(3, 2, 30), torch.linspace(0, 1, 9), torch.tensor(0.1)
    mapped = torch.func.vmap(lambda s: E.histogram(s, bins, width))(x)
    assert_close(mapped, torch.stack([E.histogram(s, bins, width) for s in x]))
    per_sample = torch.func.vmap(torch.func.grad(lambda s: E.histogram(s, bins, width).square().sum()))(x)
    for s, g in zip(x, per_sample):
        s.requires_grad_()
        assert_close(g, torch.autograd.grad(E.histogram(s, bins, width).square().sum(), s)[0])


class Largest(TorchDispatchMode):
    """The number of elements of the largest tensor that a call makes."""

    numel = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        output = func(*args, **(kwargs or {}))
        self.numel = max(self.numel, *(t.numel() for t in tree_leaves(output) if isinstance(t, torch.Tensor)), 0)
        return output


@pytest.mark.parametrize(
    "call",
    [
        lambda x: E.histogram(x.flatten(1), torch.linspace(0, 1, 256), torch.tensor(0.01)),
        lambda x: E.histogram2d(x.flatten(1), x.flatten(1), torch.linspace(0, 1, 128), torch.tensor(0.01)),
        lambda x: E.image_histogram2d(x, 0.0, 1.0)[0],
        lambda x: E.image_histogram2d(x, 0.0, 1.0, kernel="gaussian")[0],
        lambda x: E.equalize_clahe(x, 2.0, (2, 2), slow_and_differentiable=True),
    ],
)
def test_memory_grows_with_the_pixels_alone(call):
    x = torch.rand(1, 1, 64, 64, requires_grad=True)
    with Largest() as largest:
        call(x).sum().backward()
    assert largest.numel <= 10 * x.numel()
    assert x.grad.isfinite().all()


# --- kernels --------------------------------------------------------------------------------------------------------

OPERATORS = (
    *("histogram", "histogram_backward", "image_histogram2d", "image_histogram2d_backward"),
    *("normalize_counts", "normalize_counts_backward"),
)
CENTERS = {
    "even": torch.linspace(-1, 2, 50),
    "uneven": torch.linspace(0, 1.4, 50) ** 2 - 0.5,
    "unsorted": torch.rand(50, generator=torch.Generator().manual_seed(1)),
    "one": torch.tensor([0.3]),
}


def counts_and_gradient(x: Tensor, centers: Tensor, width: float, weights: Tensor) -> tuple[Tensor, Tensor]:
    x = x.detach().requires_grad_()
    counts = kernel_counts(x, centers, x.new_full((), width), "gaussian")
    return counts.detach(), torch.autograd.grad((counts * weights).sum(), x)[0]


@pytest.mark.native
@pytest.mark.parametrize(
    ("width", "centers", "samples"),
    [
        pytest.param(*case, marks=[pytest.mark.large] if case[2] > 1000 else [])
        for case in pairwise((1e-5, 0.0007, 0.004, 0.02, 0.3, 20.0), list(CENTERS), (1, 100, 1000, 70_000))
    ],
)
def test_counts_against_the_reference(samples, width, centers, device):
    """Few samples and many, in one block and in several; kernels that no grid fits, and those it takes in parts."""
    centers = CENTERS[centers].to(device)
    x = torch.rand(2, samples, device=device) * 1.4 - 0.2
    x[0] = (x[0] * 255).floor() / 255
    x[1, : samples // 2], x[1, -1] = 0.3, torch.nan
    weights = torch.rand(2, len(centers), device=device) - 0.3
    with K.backend("reference"):
        expected = counts_and_gradient(x.double(), centers.double(), width, weights.double())
    for dtype, tolerance in ((torch.float64, 1e-12), (torch.float32, 1e-5)):
        actual = counts_and_gradient(x.to(dtype), centers.to(dtype), width, weights.to(dtype))
        for a, e, unit in zip(actual, expected, (1, 1 / width)):
            if width == 1e-5 and dtype == torch.float32:  # (x - center) / width is not exact, and steep
                tolerance = 2e-2
            assert_close(a, e.to(dtype), 0, tolerance * max(float(e.abs().max()), unit / 100))


def test_extreme_centers_and_bandwidths(device):
    x = torch.rand(2, 300, device=device)
    for centers in ([0.1, torch.nan], [torch.inf, 0.5], [3e38, -3e38], []):
        for width in (0.1, 0.0, -0.1, torch.nan, torch.inf, 1e-44):
            c, h = torch.tensor(centers, device=device), torch.tensor(width, device=device)
            with K.backend("reference"):
                expected = kernel_counts(x, c, h, "gaussian")
            assert_close(kernel_counts(x, c, h, "gaussian"), expected, 1e-4, 1e-3)


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_instruction_sets(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the kernels of the CPU")
    with instruction_set(isa):
        test_counts_against_the_reference(1000, 0.02, "even", device)


@pytest.mark.native
def test_runs_give_the_same_bits(device):
    x, centers = torch.rand(3, 100_000, device=device), torch.linspace(0, 1, 256, device=device)
    weights = torch.rand(3, 256, device=device)
    first, second = (counts_and_gradient(x, centers, 0.004, weights) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second))


def test_operators(device, backend):
    """Native, as torch wants operators to be, and not to be broken by wrong arguments."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x, centers = torch.rand(2, 500, device=device), torch.linspace(0, 1, 9, device=device)
    image = x[:, None].clone().requires_grad_()
    with recorded() as calls, K.backend("native"):
        counts_and_gradient(x, centers, 0.1, torch.rand(2, 9, device=device))
        E.image_histogram2d(image, 0.0, 1.0, 9, return_pdf=True)[1].square().sum().backward()
    assert {name for name, _ in calls} == set(OPERATORS)
    for name, args in calls:
        args = [a.detach() if isinstance(a, Tensor) else a for a in args]
        torch.library.opcheck(getattr(torch.ops.kvision, name).default, tuple(args))
        operator, fine = (
            getattr(torch.ops.kvision, name).default,
            ("without rows", "without columns", "cut along", "bins 32768"),
        )
        wrong = [call for call in raw_calls.wrong_calls(operator, args) if not any(word in call[0] for word in fine)]
        assert not raw_calls.taken([(operator, call) for call in wrong])


def test_derivatives_of_the_kernels():
    """More samples than are counted directly; float32, as only that has cells."""
    x, weights = torch.rand(1, 600), torch.rand(1, 20)
    centers, width = torch.linspace(0, 1, 20), torch.tensor(0.08)

    def loss(x: Tensor, centers: Tensor, width: Tensor) -> Tensor:
        return (kernel_counts(x, centers, width, "gaussian") / 600 * weights).square().sum()

    actual = torch.func.grad(loss, argnums=(0, 1, 2))(x, centers, width)
    second = torch.func.hessian(loss, argnums=2)(x, centers, width)
    with K.backend("reference"):
        expected = torch.func.grad(loss, argnums=(0, 1, 2))(x, centers, width)
        for a, e in zip(actual, expected):
            assert_close(a, e, 0, 2e-5 * float(e.abs().max()))
        assert_close(second, torch.func.hessian(loss, argnums=2)(x, centers, width), 1e-4, 1e-4)
    per_sample = torch.func.vmap(torch.func.grad(loss), (0, 0, 0))(
        x[None].repeat(3, 1, 1), centers.repeat(3, 1), width.repeat(3)
    )
    assert_close(per_sample[2], actual[0], 0, 2e-5 * float(actual[0].abs().max()))


@pytest.mark.tracing
def test_compile_and_graph(device):
    x, centers = torch.rand(2, 400, device=device), torch.linspace(0, 1, 9, device=device)
    torch._dynamo.reset()
    call = lambda x: E.histogram(x, centers, 0.1)  # noqa: E731
    compiled = torch.compile(call, fullgraph=True, backend="aot_eager")
    a, b = x.clone().requires_grad_(), x.clone().requires_grad_()
    assert_close(compiled(a), call(b))
    compiled(a).square().sum().backward()
    call(b).square().sum().backward()
    assert_close(a.grad, b.grad)
    if device.type == "cuda":
        graph = torch.cuda.CUDAGraph()
        call(x)
        with torch.cuda.graph(graph):
            captured = call(x)
        x.copy_(torch.rand_like(x))
        graph.replay()
        assert_close(captured, call(x))


GRIDS = [
    ("triangular", 5),
    ("epanechnikov", 5),
    ("uniform", 5),
    ("triangular", 256),
    ("uniform", 256),
    ("triangular", 20_000),
]


@pytest.mark.native
@pytest.mark.parametrize("kernel, bins", GRIDS)
@pytest.mark.parametrize("samples", [1, 700, 40_000])
def test_bins_against_the_reference(samples, kernel, bins, device):
    """In one block and in several, with all bins at once and in parts; on the middles of bins and between."""
    width = 2.0 ** (-(bins.bit_length() - 1))
    x = torch.rand(2, samples, device=device) * (width * bins + 0.2) - 0.1
    x[0] = ((x[0] / width * 2).floor() + 0.5 * (torch.rand(samples, device=device) < 0.5)) / 2 * width
    x[1, : samples // 2], x[1, -1] = 0.3, torch.nan
    weights = torch.rand(2, bins, device=device) - 0.3

    def result(x: Tensor, weights: Tensor) -> tuple[Tensor, ...]:
        x = x.detach().requires_grad_()
        counts = E.image_histogram2d(x[:, None, None], 0.0, width * bins, bins, kernel=kernel)[0][:, 0]
        if kernel == "uniform":  # without a gradient
            return (counts.detach(),)
        return counts.detach(), torch.autograd.grad((counts * weights).sum(), x)[0]

    with K.backend("reference"):
        expected = result(x.double(), weights.double())
    # Kernels add up parts. The reference, where it is what is tested, adds one sample after the other.
    single = 2e-5 if _ops.serves("image_histogram2d", x) == "native" else max(2e-5, samples * 2.0**-24)
    for dtype, tolerance in ((torch.float64, 1e-10), (torch.float32, single)):
        first, second = result(x.to(dtype), weights.to(dtype)), result(x.to(dtype), weights.to(dtype))
        for a, b, e in zip(first, second, expected):
            assert torch.equal(a, b)
            assert_close(a, e.to(dtype), tolerance, tolerance * float(e.abs().max()))


class TestHistogramOperators(PointOpTests):
    calls = {
        "histogram": [
            Call(
                (vector(40), torch.linspace(0, 1, 5)[None], torch.tensor([0.2])),
                tolerance=50,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=(" cut along ",),
            )
        ],
        "image_histogram2d": [
            Call(
                (vector(40),),
                (0.0, 0.25, 5, 0),
                tolerance=50,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=("cut along", "bins 32768"),
            )
        ],
        "normalize_counts": [Call((vector(40),), (0.5,), dtypes=SINGLE_AND_DOUBLE, accepted=("cut along",))],
    }
