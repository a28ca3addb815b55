"""Sharpness: the operator."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import OpTests


class TestSharpness(OpTests):
    """Some pixels are outside [0, 1], where there is no gradient."""

    function = staticmethod(K.enhance.sharpness)
    operators = ("sharpness", "sharpness_backward")
    variants = [
        {"factor": 1.7},
        {"factor": lambda x: 2 * torch.rand(x.shape[0])},
        {"factor": lambda x: 2 * torch.rand(x.shape[:2])},
    ]
    shape = (2, 3, 19, 70)
    max_size = 12
    bytes = True
    tolerances = {torch.uint8: (0, 1)}  # a sum just above or below a half of a level

    def input(self, shape, dtype, device):
        x = super().input(shape, dtype, device)
        return x if dtype == torch.uint8 else x * 1.2 - 0.1

    def test_other_integers_become_float32(self, variant, device):
        with pytest.raises(K.core.exceptions.TypeCheckError, match="floating point or uint8"):
            K.enhance.sharpness(torch.zeros(1, 3, 4, 4, dtype=torch.int32, device=device), 0.5)

    test_wrong_kinds = None  # test_all.py; any number of leading axes is right


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("size", [(2, 3, 19, 70), (1, 1, 37, 9), (1, 2, 5, 33), (1, 3, 2, 40), (2, 3, 41, 64)], ids=str)
def test_bytes_are_rounded_once(size, layout, device):
    """To a neighbor of the exact result where that is halfway between two."""
    x = torch.randint(0, 256, size, generator=torch.Generator().manual_seed(0)).to(torch.uint8)
    x = x.to(device).contiguous(memory_format=layout)
    for factor in (0.0, 0.4, 1.0, 1.5, 3.0, torch.arange(size[0] * size[1], device=device).reshape(size[:2]) / 2):
        y = K.enhance.sharpness(x, factor)
        assert y.dtype == torch.uint8 and y.is_contiguous(memory_format=layout)
        exact = 255 * K.enhance.sharpness(x.double() / 255, factor)
        assert (y - exact).abs().max() <= 0.5 + 1e-4
