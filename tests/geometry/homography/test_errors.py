"""Errors of correspondences under a homography."""

from functools import partial

import pytest
import torch

import kvision as K
from composition_tests import Case
from kvision._modes import CORRESPONDENCE_ERROR
from point_op_tests import EYE, SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector
from view_tests import ViewTests, finite_gradients, on_planes

G = K.geometry
# Values of the tests are random in [0.1, 1); these are what they are added to.
X, Y, H = on_planes(1, 12)
POINTS = (2, 12, 2)


class TestErrors(ViewTests):
    cases = {
        "transfer": Case(lambda x, h: G.symmetric_transfer_error(x, x.flip(1), h), (POINTS, (2, 3, 3))),
        "one way": Case(lambda x, h: G.oneway_transfer_error(x, x.flip(1), h[:1], False), ((2, 7, 3), (2, 3, 3))),
        "distance": Case(lambda x, h: G.sampson_homography_distance(x, x.flip(1), h, False), (POINTS, (2, 3, 3))),
        "segments": Case(lambda x, h: G.line_segment_transfer_error_one_way(x, x.flip(1), h), ((2, 5, 2, 2), (2, 3, 3))),
    }  # fmt: skip
    compiled = ()


def test_transfer_to_infinity(device):
    H = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [1, 0, 0]]], device=device)  # x = 0 goes to infinity
    x = torch.tensor([[[0.0, 1], [1, 1]]], device=device)
    error = finite_gradients(lambda x, h: G.oneway_transfer_error(x, x, h), x, H)
    assert error.tolist() == [[float("inf"), 0]]
    assert (finite_gradients(lambda x, h: G.symmetric_transfer_error(x, x, h), x, H) == torch.finfo(x.dtype).max).all()
    for distance in (G.sampson_homography_distance, G.sampson_epipolar_distance, G.symmetrical_epipolar_distance):
        assert finite_gradients(distance, x, x, 0 * H).isinf().all()
    for distance in (G.oneway_transfer_error, G.sampson_homography_distance):
        exact = finite_gradients(partial(distance, squared=False), x, x, torch.eye(3, device=device)[None])
        assert (exact == 0).all()


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.oneway_transfer_error(P, Q, M[0]), ValueError, r"oneway_transfer_error: expected H of shape \(\*, B, 3, 3\)"),
    (lambda: G.symmetric_transfer_error(P, torch.rand(2, 8, 4), M), ValueError, r"symmetric_transfer_error: expected pts2 of"),
    (lambda: G.sample_is_valid_for_homography(P[:, :3], Q[:, :3]), ValueError, "sample_is_valid_for_homography: expected points1"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestErrorsOperators(PointOpTests):
    calls = {
        "correspondence_errors": [
            Call(
                (vector(9, 2), vector(9, 2), near(EYE)),
                (CORRESPONDENCE_ERROR[kind], squared),
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=200,
            )
            for kind, squared in (("transfer", True), ("symmetric_transfer", True), ("sampson_transfer", True))
        ],
    }
