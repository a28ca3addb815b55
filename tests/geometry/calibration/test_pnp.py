"""Poses of cameras from points."""

import pytest
import torch

import kvision as K
from composition_tests import Case
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector
from view_tests import CAMERA, Scene, ViewTests, camera, finite_gradients, points, rand

G = K.geometry
SCENE = Scene(1, 8)


class TestPnp(ViewTests):
    cases = {
        "pose, weighted": Case(
            lambda x, k, w: G.solve_pnp_dlt(points(x, SCENE.points), points(x[..., :2], SCENE.x1), camera(x) + k.triu(), w),
            ((2, 8, 3), (2, 3, 3), (2, 8)),
        ),
        "pose": Case(
            lambda x, y: G.solve_pnp_dlt(points(x, SCENE.points), points(y, SCENE.x1), camera(x)),
            ((2, 8, 3), (2, 8, 2)),
        ),
    }  # fmt: skip
    compiled = ()


def test_poses_of_points_in_a_plane_are_nan(device):
    points = rand(1, 9, 3) * torch.tensor([1.0, 1, 0]) + torch.tensor([0.0, 0, 5])
    seen = points[..., :2] / points[..., 2:]
    pose = finite_gradients(
        lambda p: G.solve_pnp_dlt(p, seen.to(device), torch.eye(3).double()[None].to(device)), points.to(device)
    )
    assert pose.isnan().all()


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.solve_pnp_dlt(torch.rand(2, 5, 3), P[:, :5], M), ValueError, "solve_pnp_dlt: expected world_points of at least six"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestPnpOperators(PointOpTests):
    calls = {
        "pose_dlt": [
            Call(
                (near(SCENE.points[0]), near(SCENE.x1[0]), near(CAMERA), weights),
                (1e-9,),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=5000,
            )
            for weights in (vector(8), None)
        ],
    }
