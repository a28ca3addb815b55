"""Grids of pixels."""

import itertools

import pytest
import torch

import kvision as K
from op_tests import assert_close

G = K.geometry


@pytest.mark.parametrize("sizes", [(3, 4), (1, 5), (4, 1)])
def test_grids_are_those_of_kornia(sizes, device):
    theirs = pytest.importorskip("kornia").geometry
    kinds = {"device": device, "dtype": torch.float64}
    for normalized, corners in itertools.product((True, False), repeat=2):
        expected = theirs.create_meshgrid(*sizes, normalized, dtype=torch.float64, align_corners=corners)
        assert_close(G.create_meshgrid(*sizes, normalized, **kinds, align_corners=corners).cpu(), expected, 0, 1e-15)
        expected = theirs.create_meshgrid3d(2, *sizes, normalized, dtype=torch.float64)
        assert_close(G.create_meshgrid3d(2, *sizes, normalized, **kinds).cpu(), expected, 0, 1e-15)
        expected = theirs.normal_transform_pixel(*sizes, dtype=torch.float64, align_corners=corners)
        assert_close(G.normal_transform_pixel(*sizes, **kinds, align_corners=corners).cpu(), expected, 0, 1e-15)
    expected = theirs.normal_transform_pixel3d(2, *sizes, dtype=torch.float64)
    assert_close(G.normal_transform_pixel3d(2, *sizes, **kinds).cpu(), expected, 0, 1e-15)


BAD = [
    (lambda: G.create_meshgrid(0, 3), ValueError, "create_meshgrid: expected height to be an int of at least 1"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
