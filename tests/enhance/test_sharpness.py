"""Sharpness: the operator."""

from __future__ import annotations

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

    def input(self, shape, dtype, device):
        return super().input(shape, dtype, device) * 1.2 - 0.1

    test_other_integers_become_float32 = None  # they are refused

    def test_wrong_kinds(self, variant, device):
        """test_all.py; any number of leading axes is right."""
