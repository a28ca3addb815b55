"""Density estimates: what they sum to, where they are, and how much memory they take."""

from __future__ import annotations

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import kvision as K
from op_tests import assert_close

E = K.enhance


def test_counts_of_a_wide_kernel_sum_to_the_pixels(device):
    """The triangles of neighbouring bins add up to one."""
    x = torch.rand(2, 3, 20, 30, device=device) * 200 + 20
    counts, pdf = E.image_histogram2d(x, return_pdf=True)
    assert_close(counts.sum(-1), torch.full((2, 3), 600.0, device=device))
    assert_close(pdf.sum(-1), torch.ones(2, 3, device=device))


def test_narrow_kernels_count(device):
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
def test_a_kernel_that_ends_reaches_few_bins(kernel):
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
