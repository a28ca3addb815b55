"""Strict local maxima."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import OpTests
from point_op_tests import Call, PointOpTests, vector

kornia = pytest.importorskip("kornia")
G = K.geometry


class TestNms2d(OpTests):
    function = staticmethod(G.nms2d)
    module = G.NonMaximaSuppression2d
    operators = ("nms", "apply_nms_mask")
    mixed = ("input",)  # flags have a type of their own
    variants = [{"kernel_size": (3, 3)}, {"kernel_size": (5, 5)}, {"kernel_size": (2, 5)}]
    max_size = 9
    errors = [
        ({"kernel_size": (0, 3)}, ValueError, "kernel_size to be an int or 2 ints of at least 1"),
        ({"kernel_size": (3.0, 3)}, TypeError, "kernel_size"),
        ({"mask_only": 1}, TypeError, "mask_only to be a bool"),
    ]

    def test_all_small_sizes(self, variant, sizes, device):
        """Peaks too near the border do not count: images as small as the window have none."""
        super().test_all_small_sizes(variant, sizes, device)
        x = torch.rand(1, 1, 2, 9, device=device)
        assert not G.nms2d(x, (3, 3)).any()


class TestNms3d(OpTests):
    function = staticmethod(G.nms3d)
    module = G.NonMaximaSuppression3d
    operators = ("nms", "apply_nms_mask")
    mixed = ("input",)  # flags have a type of their own
    variants = [{"kernel_size": (3, 3, 3)}, {"kernel_size": (1, 2, 5)}]
    shape = (2, 3, 5, 9, 12)
    small = (1, 1, 3, 4, 5)
    max_size = 5


IMAGE = (2, 3, 5, 7)
VOLUME = (2, 1, 4, 6, 7)


class TestNmsFunctions(CompositionTests):
    cases = {
        "nms3d_minmax": Case(lambda x: torch.stack(G.nms3d_minmax(x), 1).float(), (VOLUME,), differentiable=False),
        "nms2d mask": Case(lambda x: G.nms2d(x, (3, 3), mask_only=True).float(), (IMAGE,), differentiable=False),
    }
    compiled = ("nms3d_minmax", "nms2d mask")


@pytest.mark.parametrize("window", [(3, 3), (5, 5), (7, 7), (2, 3), (4, 5), (1, 1)])
def test_nms_is_kornias(window, device):
    x = torch.rand(2, 2, 17, 19, device=device)
    assert torch.equal(G.nms2d(x, window), kornia.geometry.nms2d(x, window))
    volume = x[:, :, None].repeat(1, 1, 4, 1, 1) + torch.rand(2, 2, 4, 17, 19, device=device)
    for result, expected in zip(G.nms3d_minmax(volume), kornia.geometry.nms3d_minmax(volume)):
        assert torch.equal(result, expected)
    size = (3, *window)
    assert torch.equal(G.nms3d(volume, size, True), kornia.geometry.nms3d(volume, size, True))


def test_equal_neighbors_and_nan_are_no_maxima(device):
    x = torch.zeros(1, 1, 5, 5, device=device)
    x[0, 0, 2, 2:4] = 1
    assert not G.nms2d(x, (3, 3)).any()
    x[0, 0, 2, 3] = float("nan")
    assert not G.nms2d(x, (3, 3)).any()


@pytest.mark.native
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16], ids=str)
@pytest.mark.parametrize("width", [3, 129, 254, 257, 513])
def test_masks_of_rows_that_begin_anywhere(width, dtype, device):
    x = torch.rand(2, 3, 4, 33, width, device=device).to(dtype)
    x[0, 1, 2, 7, width // 2] = float("nan")
    calls = [
        lambda x: G.nms2d(x[:, 0], (3, 3), mask_only=True),
        lambda x: G.nms2d(x[:, 0], (5, 5), mask_only=True),
        lambda x: G.nms3d(x, (3, 3, 3), mask_only=True),
        lambda x: torch.stack(G.nms3d_minmax(x)),
    ]
    for call in calls:
        with K.backend("reference"):
            expected = call(x)
        assert torch.equal(call(x), expected)
        assert width == 3 or expected.any()


class TestNmsOperators(PointOpTests):
    calls = {
        name: [
            Call((vector(3, 6, 7),), ([1, 3, 3], False), differentiable=False, tolerance=0),
            Call((vector(4, 6, 7),), ([3, 3, 3], True), differentiable=False, tolerance=0),
        ]
        for name in ("nms_mask", "nms_minmax_masks")
    }
