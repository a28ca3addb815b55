"""Dilation and erosion: the kernels' tests."""

from __future__ import annotations

import torch

import kvision as K
from op_tests import OpTests

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

    def call(self, x, kwargs):
        integers = isinstance(x, torch.Tensor) and x.dtype in (torch.uint8, torch.int32)  # which the functions refuse
        return self.function(x.float() if integers else x, **kwargs)


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
