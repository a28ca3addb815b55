"""Dilation and erosion: the kernels' tests."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import OpTests, assert_close, pairwise

ERRORS = [
    ({"kernel": lambda x: torch.ones(3)}, ValueError, "expected kernel of shape"),
    ({"origin": (3, 0)}, ValueError, "expected an origin in the kernel"),
    ({"border_type": "mirror"}, NotImplementedError, "border_type must be"),
    ({"engine": "fast"}, NotImplementedError, "engine must be"),
]


def ones(height: int, width: int):
    return lambda x: torch.ones(height, width, dtype=torch.int32)


def few(x: torch.Tensor) -> torch.Tensor:
    return torch.tensor([[0, 1, 0, 1], [1, 1, 0, 0], [0, 0, 0, 1]])


def heights(x: torch.Tensor) -> torch.Tensor:
    return torch.linspace(-0.3, 0.4, 12).view(3, 4)


class Morphology(OpTests):
    operators = ("dilation", "dilation_backward")
    errors = ERRORS
    shape = (2, 3, 13, 18)
    small = (1, 2, 3, 4)
    max_size = 17
    bytes = True


class TestDilation(Morphology):
    function = staticmethod(K.morphology.dilation)
    variants = [
        {"kernel": ones(3, 3)},
        {"kernel": ones(5, 4), "border_type": "constant", "border_value": 0.5},
        {"kernel": few, "structuring_element": heights, "origin": (0, 3)},
    ]


class TestErosion(Morphology):
    function = staticmethod(K.morphology.erosion)
    variants = [{"kernel": ones(3, 3)}, {"kernel": ones(1, 7), "origin": (0, 6)}, {"kernel": few}]


@pytest.mark.native
@pytest.mark.parametrize(
    ("size", "function", "flat"),
    pairwise(
        [(3, 3), (7, 7), (15, 15), (8, 7), (1, 9), (7, 1), (31, 2), (9, 70)],
        [K.morphology.dilation, K.morphology.erosion],
        [True, False],
    ),
)
def test_windows_of_many_sizes(size, function, flat, device):
    """Values and gradients of images with many ties, which tiles and strips do not hold as a whole."""
    kernel = torch.ones(size, device=device)
    if not flat:
        kernel[:, 0] = kernel[0, 0] = 0
    more = {} if flat else {"origin": (size[0] - 1, 0), "border_type": "constant", "border_value": 0.5}
    x = torch.rand(1, 2, 69, 261, device=device).mul(20).round().div(20)
    x[0, 1, 5:9, 20] = torch.inf
    weight = torch.rand_like(x) - 0.3
    results = []
    for name, values in (("auto", x), ("reference", x.double())):
        with K.backend(name):
            leaf = values.clone().requires_grad_()
            y = function(leaf, kernel, **more)
            y.backward(weight.to(y.dtype).where(y.isfinite(), 0))
            results.append((y.detach().float(), leaf.grad.float()))
    assert_close(results[0], results[1], 1e-5, 1e-4)
