"""Affine maps of points."""

import pytest
import torch

import kvision as K
from composition_tests import Case
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector
from view_tests import ViewTests

G = K.geometry
POINTS = (2, 12, 2)


class TestAffine(ViewTests):
    cases = {
        "affine": Case(lambda x, w: G.find_affine(x, x.square().flip(1), w), (POINTS, (2, 12))),
    }  # fmt: skip
    compiled = ()


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.find_affine(P[:, :2], Q[:, :2]), ValueError, "find_affine: expected points1 of shape .* at least 3"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestAffineOperators(PointOpTests):
    calls = {
        "affine_fit": [
            Call(
                (vector(7, 2), vector(7, 2), weights),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=100,
            )
            for weights in (vector(7), None)
        ],
    }
