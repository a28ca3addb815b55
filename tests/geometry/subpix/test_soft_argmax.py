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
