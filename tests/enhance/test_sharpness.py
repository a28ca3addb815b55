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
