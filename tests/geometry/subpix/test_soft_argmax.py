"""The soft argmax of windows."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import OpTests, assert_close

kornia = pytest.importorskip("kornia")
G = K.geometry


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


class TestConvSoftArgmax3d(OpTests):
    function = staticmethod(G.conv_soft_argmax3d)
    module = G.ConvSoftArgmax3d
    operators = ("soft_argmax", "soft_argmax_backward")
    shape = (2, 3, 4, 9, 12)
    small = (1, 1, 3, 3, 4)
    max_size = 4
    variants = [{}, {"normalized_coordinates": True, "stride": (1, 2, 1), "output_value": False}]
    tolerances = TestConvSoftArgmax2d.tolerances


IMAGE = (2, 3, 5, 7)


class TestSoftArgmaxFunctions(CompositionTests):
    cases = {
        "conv_soft_argmax2d": Case(
            lambda x, t: G.conv_soft_argmax2d(x, temperature=t[0, 0], output_value=True)[1], (IMAGE, (1, 1)), (1,)
        ),
    }
    compiled = ("conv_soft_argmax2d",)


@pytest.mark.parametrize("normalized", [True, False])
def test_soft_argmax_is_kornias(normalized, device):
    x = (3 * torch.randn(2, 2, 9, 11, dtype=torch.float64, device=device)).requires_grad_()
    for options in [((5, 5), (1, 1), (2, 2), 0.3), ((2, 4), (2, 1), (1, 2), 2.0)]:
        modules = (G, kornia.geometry)
        pairs = [module.conv_soft_argmax2d(x, *options, normalized, output_value=True) for module in modules]
        assert_close(*pairs)
        weights = [torch.randn_like(y) for y in pairs[0]]
        assert_close(*(torch.autograd.grad(pair, x, weights)[0] for pair in pairs))
    volume = torch.randn(1, 2, 4, 7, 8, dtype=torch.float64, device=device)
    options = {"stride": (1, 2, 1), "normalized_coordinates": normalized}
    assert_close(G.conv_soft_argmax3d(volume, **options), kornia.geometry.conv_soft_argmax3d(volume, **options))


@pytest.mark.native
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16], ids=str)
@pytest.mark.parametrize("width", [3, 113, 120, 243, 257])
@pytest.mark.parametrize(
    "radius, temperature, output_value", [(1, 1.0, False), (2, 0.7, False), (2, 1.0, True), (1, 0.01, True)]
)
def test_rows_that_begin_anywhere(radius, temperature, output_value, width, dtype, device):
    """Windows around every pixel, which share their exponentials unless numbers differ too much."""
    x = torch.randn(2, 2, 37, width, device=device).to(dtype)
    window, padding = (2 * radius + 1,) * 2, (radius,) * 2

    def call(x):
        result = G.conv_soft_argmax2d(x, window, (1, 1), padding, temperature, True, output_value=output_value)
        return result if output_value else (result,)

    leaf = x.detach().requires_grad_()
    results = call(leaf)
    upstream = [torch.rand_like(y) for y in results]
    gradient = torch.autograd.grad(results, leaf, upstream)[0]
    with K.backend("reference"):
        exact = x.double().requires_grad_()
        expected = call(exact)
        expected_gradient = torch.autograd.grad(expected, exact, [g.double() for g in upstream])[0]
    tolerance = {torch.float32: 2e-5, torch.float16: 2e-3, torch.bfloat16: 1.6e-2}[dtype]
    for result, of_reference in zip(results, expected):
        torch.testing.assert_close(result.double(), of_reference, rtol=tolerance, atol=tolerance)
    scale = float(expected_gradient.abs().max())
    torch.testing.assert_close(gradient.double() / scale, expected_gradient / scale, rtol=tolerance, atol=tolerance)
