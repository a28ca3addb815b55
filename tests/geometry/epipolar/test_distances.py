"""Distances to epipolar lines."""

import torch

import kvision as K
from composition_tests import Case
from kvision._modes import CORRESPONDENCE_ERROR
from op_tests import assert_close
from point_op_tests import EYE, SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector
from view_tests import ViewTests, rand

G = K.geometry
POINTS = (2, 12, 2)


class TestDistances(ViewTests):
    cases = {
        "from one line": Case(
            lambda x, y, f: G.left_to_right_epipolar_distance(x, y, f) + G.right_to_left_epipolar_distance(y, x, f),
            ((2, 7, 3), (2, 7, 2), (2, 3, 3)),
        ),
        "sampson": Case(lambda x, f: G.sampson_epipolar_distance(x, x.flip(1), f, False), (POINTS, (2, 3, 3))),
        "symmetrical": Case(lambda x, f: G.symmetrical_epipolar_distance(x, x.flip(1), f), (POINTS, (2, 3, 3))),
    }  # fmt: skip
    compiled = ()


def test_errors_of_many_correspondences_of_one_matrix(device):
    """Their gradients are sums of sums; bits do not depend on the run."""
    x, y, F = (v.to(device) for v in (rand(2, 9, 2, 3, seed=1), rand(2, 5000, 2, seed=2), rand(1, 3, 3, seed=3)))
    x = x.flatten(2)[:, :, :2].repeat(1, 556, 1)[:, :5000]
    results = []
    for backend in ("auto", "auto", "reference"):
        leaf = F.clone().requires_grad_()
        with K.backend(backend):
            errors = G.symmetrical_epipolar_distance(x, y, leaf)
            results.append([errors.detach(), *torch.autograd.grad(errors.sum(), leaf)])
    assert all(torch.equal(a, b) for a, b in zip(*results[:2]))
    assert_close(results[0], results[2], 1e-10, 1e-10)


class TestDistancesOperators(PointOpTests):
    calls = {
        "correspondence_errors": [
            Call(
                (vector(9, 2), vector(9, 2), near(EYE)),
                (CORRESPONDENCE_ERROR[kind], squared),
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=200,
            )
            for kind, squared in (("sampson", True), ("symmetrical", True), ("right", True), ("left", True))
        ],
    }
