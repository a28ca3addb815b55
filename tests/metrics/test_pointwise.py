"""Losses element by element and their sums: the kernels' tests."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.metrics import pointwise
from op_tests import OpTests, assert_close

DIFFERENCES = ("charbonnier", "welsch", "cauchy", "geman_mcclure", "square")
DIVERGENCES = ("kl", "js")


def other(x: Tensor) -> Tensor:
    """Partly close to x and partly not, with zeros."""
    noise = torch.rand(x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).to(x.device)
    return ((x.double() + noise * (noise > 0.5)) * (noise > 0.1)).to(
        torch.float64 if x.dtype == torch.float64 else torch.float32
    )


class Pointwise(OpTests):
    shape = (3, 3, 7, 12)
    max_size = 6

    def call(self, x, kwargs):
        integers = isinstance(x, Tensor) and x.dtype in (torch.uint8, torch.int32)  # which the losses refuse
        return self.function(x.float() if integers else x, **kwargs)


class TestMap(Pointwise):
    function = staticmethod(K.losses.charbonnier_loss)
    operators = ("pointwise_loss", "pointwise_loss_backward")
    variants = [{"img2": other}]


class TestSum(Pointwise):
    function = staticmethod(K.losses.cauchy_loss)
    operators = ("pointwise_sum", "pointwise_sum_backward")
    variants = [{"img2": other, "reduction": "mean"}]


class TestDivergence(Pointwise):
    function = staticmethod(K.losses.js_div_loss_2d)
    operators = ("pointwise_sum", "pointwise_sum_backward")
    variants = [{"target": lambda x: other(x) + 0.5, "reduction": "none"}]

    def input(self, shape, dtype, device):
        return (super().input(shape, dtype, device) + 1).to(dtype)  # derivatives of logarithms have no bound at 0


class TestDecibels(Pointwise):
    function = staticmethod(K.metrics.psnr)
    operators = ("pointwise_sum", "pointwise_sum_backward")
    variants = [{"target": other, "max_val": 2.0}]

    test_wrong_kinds = None  # other shapes are a TypeError, as in Kornia: tests/metrics/test_metrics.py


@pytest.mark.parametrize("loss", [K.losses.welsch_loss, lambda x, y, _: K.metrics.psnr(x, y, 1.0)])
def test_mean_of_empty_tensors(loss, device):
    x = torch.rand(0, 3, device=device)
    assert loss(x, x, "mean").isnan()


@pytest.mark.parametrize("kind", DIFFERENCES + DIVERGENCES)
@pytest.mark.parametrize("size", [3, 8192, 20001])
def test_kinds_of_losses(kind, size, device):
    """Values and both gradients, of small and of large differences, and of probabilities with zeros."""
    x, y = torch.rand(2, size, dtype=torch.float64, device=device)
    if kind in DIVERGENCES:
        x, y = x * (x > 0.1), y * (y < 0.9)
    else:
        x = (x - 0.5) * torch.logspace(-6, 3, size, dtype=torch.float64, device=device)
        y = y * 1e-9
    x, y = x.float().double(), y.float().double()  # numbers that float32 has, too
    with K.backend("reference"):
        leaves = x.clone().requires_grad_(), y.clone().requires_grad_()
        expected = pointwise.pointwise(kind, *leaves, "none")
        gradients = torch.autograd.grad(expected.nan_to_num(0, 0, 0).sum(), leaves)
    for dtype, tolerance in ((torch.float64, 1e-11), (torch.float32, 3e-6)):
        leaves = x.to(dtype).requires_grad_(), y.to(dtype).requires_grad_()
        loss = pointwise.pointwise(kind, *leaves, "none")
        small = tolerance if kind in DIVERGENCES else 0.0
        assert_close(loss.detach(), expected.detach().to(dtype), tolerance, small)
        result = torch.autograd.grad(loss.nan_to_num(0, 0, 0).sum(), leaves)
        assert_close(result, tuple(s.to(dtype) for s in gradients), tolerance, 3 * tolerance)
        total = pointwise.pointwise(kind, x.to(dtype), y.to(dtype), "mean")
        assert_close(total, expected.detach().mean().to(dtype), 10 * tolerance, 1e-9)


@pytest.mark.parametrize("kind", DIFFERENCES)
def test_differences_out_of_all_proportion(kind, device):
    """Squares that no float32 holds, and NaN."""
    x = torch.tensor([1e30, -1e30, 1e12, math.nan], device=device)
    result = pointwise.pointwise(kind, x, torch.zeros_like(x), "none")
    with K.backend("reference"):
        assert_close(result, pointwise.pointwise(kind, x, torch.zeros_like(x), "none"))


@pytest.mark.parametrize("kind", DIVERGENCES)
def test_probabilities_out_of_range(kind, device):
    x = torch.tensor([0.0, 0.0, -1.0, math.nan, 0.5, 0.0], device=device)
    y = torch.tensor([0.0, 0.5, 0.0, 0.0, 0.0, -1.0], device=device)
    result = pointwise.pointwise(kind, x, y, "none")
    with K.backend("reference"):
        assert_close(result, pointwise.pointwise(kind, x, y, "none"))


class TestEndpointError(OpTests):
    """Of flow (B, 2, H, W), permuted as its caller has it."""

    @staticmethod
    def aepe(x, target, reduction="mean"):
        return K.metrics.aepe(x.permute(0, 2, 3, 1), target.permute(0, 2, 3, 1), reduction)

    function = aepe
    operators = ("endpoint_error", "endpoint_error_backward")
    mixed = ("input", "grad")  # the sums of half types are float32
    channels = 2
    shape = (2, 2, 13, 18)
    small = (1, 2, 3, 4)
    max_size = 9
    variants = [
        {"target": lambda x: torch.rand(x.shape)},
        {"target": lambda x: torch.rand(x.shape), "reduction": "none"},
    ]
    errors = [({"reduction": "max"}, ValueError, "reduction must be")]

    test_wrong_kinds = None  # tests/metrics/test_metrics.py
