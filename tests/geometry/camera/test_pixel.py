"""Pixels and points before a camera."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G, C = K.geometry, K.geometry.camera


class TestPixel(CompositionTests):
    cases = {
        "pixel2cam": Case(G.pixel2cam, ((2, 1, 3, 4), (2, 4, 4), (2, 3, 4, 3))),
        "cam2pixel": Case(G.cam2pixel, ((2, 3, 4, 3), (2, 4, 4))),
    }
    compiled = ()


def rand(*shape: int, seed: int = 4) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) + 0.1


CALLS = [
    ("pixel2cam", (rand(2, 1, 3, 4), rand(2, 4, 4), rand(2, 3, 4, 3))),
    ("cam2pixel", (rand(2, 3, 4, 3), rand(2, 4, 4))),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry.camera
    expected = getattr(theirs, name)(*args)
    assert_close(getattr(C, name)(*(a.to(device) for a in args)).cpu(), expected, 1e-8, 1e-9)


BAD = [
    (lambda: G.pixel2cam(rand(1, 3, 4), rand(1, 4, 4), rand(1, 3, 4, 3)), ValueError, "pixel2cam: expected depth of shape"),
    (lambda: G.cam2pixel(rand(3, 3, 4, 3), rand(2, 4, 4)), ValueError, "cam2pixel: expected dst_proj_src with 1 or 3 matrices"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
