"""Fundamental matrices."""

import cv2
import pytest
import torch

import kvision as K
from composition_tests import Case
from op_tests import assert_close
from point_op_tests import EYE, SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector
from view_tests import Scene, ViewTests, finite_gradients, on_planes, points

G = K.geometry
# Values of the tests are random in [0.1, 1); these are what they are added to.
X, Y, H = on_planes(1, 12)
X7, Y7, LINES_X, LINES_Y = X[:, :7], Y[:, :7], X.view(6, 2, 2), Y.view(6, 2, 2)
POINTS = (2, 12, 2)


class TestFundamental(ViewTests):
    cases = {
        "fundamental": Case(lambda x, y: G.find_fundamental(x, points(y, X)), (POINTS, POINTS)),
        "seven": Case(
            lambda x: G.find_fundamental(points(x, X7), points(x, Y7).flip(1), None, "7POINT").sum(1),
            ((2, 7, 2),),
        ),
        "fundamental, weighted": Case(lambda x, w: G.find_fundamental(x, points(x.flip(1), X), w), (POINTS, (2, 12))),
    }  # fmt: skip
    compiled = ()


def test_fundamental_matrices_of_degenerate_points(device):
    """Exact ones, of points in a plane, which leave several, on a line, and all at one position."""
    scene, plane = Scene(1, 9), on_planes(1, 9)
    line = torch.arange(9.0).double()[None, :, None].expand(1, 9, 2)
    for x, y in ((scene.x1, scene.x2), plane[:2], (line, line), (torch.ones_like(line), torch.ones_like(line))):
        weights = torch.ones(1, 9).double().to(device)
        result = finite_gradients(G.find_fundamental, x.to(device), y.to(device), weights)
        result = result.cpu()
        assert result.isfinite().all() and torch.linalg.det(result).abs() < 1e-9 * result.norm() ** 3 + 1e-12


def test_opencv_fundamental():
    scene = Scene(1, 30, noise=0.3)
    expected = torch.from_numpy(cv2.findFundamentalMat(scene.x1[0].numpy(), scene.x2[0].numpy(), cv2.FM_8POINT)[0])
    assert_close(G.find_fundamental(scene.x1, scene.x2)[0], expected, 1e-5, 1e-8)


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.find_fundamental(P[:, :7], Q[:, :7]), ValueError, "find_fundamental: expected points1 of shape .* at least 8"),
    (lambda: G.find_fundamental(P, Q, method="7POINT"), ValueError, r"find_fundamental: expected points1 of shape \(B, 7, 2\)"),
    (lambda: G.find_fundamental(P, Q, method="RANSAC"), ValueError, "find_fundamental: method must be one of 8POINT, 7POINT"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestFundamentalOperators(PointOpTests):
    calls = {
        "fundamental_from_essential": [Call((vector(3, 3), near(EYE), near(EYE)))],
        "fundamental_from_projections": [Call((vector(3, 4),) * 2)],
        "normalize_line": [Call((vector(3),))],
    }


SIGHTS = [lambda x=x: x[0] + 0.5 * torch.rand_like(x[0]) for x in (Scene(1, 12).x1, Scene(1, 12).x2)]


class TestFundamentalDltOperators(PointOpTests):
    calls = {
        "fundamental_dlt": [
            Call(
                (*SIGHTS, vector(12)),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=2000,
            ),
            Call(
                (*SIGHTS, None), broadcasts=False, accepted=("another dtype",), dtypes=SINGLE_AND_DOUBLE, tolerance=2000
            ),
        ],
    }


@pytest.mark.parametrize(
    "lines, points", [((7, 3), (2, 7, 2)), ((2, 7, 3), (2, 7, 3)), ((2, 1, 3), (7, 2)), ((0, 3), (0, 2))]
)
def test_perpendicular_lines(lines, points, device):
    lines, points = torch.randn(lines, device=device).double(), torch.randn(points, device=device).double()
    result = G.get_perpendicular(lines, points)
    homogeneous = torch.cat([points, torch.ones_like(points)], -1)[..., :3]
    assert result.shape == (*torch.broadcast_shapes(lines.shape[:-1], points.shape[:-1]), 3)
    assert_close((result * homogeneous).sum(-1), torch.zeros_like(result[..., 0]), 0, 1e-12)  # through the point
    turned = homogeneous[..., 2:] * torch.stack([-lines[..., 1], lines[..., 0]], -1)
    assert_close(result[..., :2], turned.expand_as(result[..., :2]), 0, 1e-12)
    inputs = lines.requires_grad_(), points.requires_grad_()
    torch.autograd.gradcheck(G.get_perpendicular, inputs, check_forward_ad=True)
    torch.autograd.gradgradcheck(G.get_perpendicular, inputs)
    of_vmap = torch.func.vmap(G.get_perpendicular)(lines.expand(3, *lines.shape), points.expand(3, *points.shape))
    assert_close(of_vmap, result.expand_as(of_vmap), 0, 1e-12)


def test_second_gradients_of_lines_without_direction(device):
    """A point at an epipole has no epipolar line: (0, 0, c), whose gradients of both orders are finite."""
    F = torch.eye(3, device=device).double()[None].requires_grad_()
    at_epipole = torch.zeros(1, 2, 2, device=device).double().requires_grad_()
    lines = G.compute_correspond_epilines(at_epipole, F)
    (grad,) = torch.autograd.grad(lines.square().sum(), at_epipole, create_graph=True)
    seconds = torch.autograd.grad(grad.square().sum() + grad.sum(), (at_epipole, F))
    assert grad.isfinite().all() and all(second.isfinite().all() for second in seconds)
