"""Triangulation of points."""

import cv2
import pytest
import torch

import kvision as K
from composition_tests import Case
from op_tests import assert_close
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, near
from view_tests import Scene, ViewTests, finite_gradients, on_planes, rand

G = K.geometry
# Values of the tests are random in [0.1, 1); these are what they are added to.
X, Y, H = on_planes(1, 12)


class TestTriangulation(ViewTests):
    cases = {
        "triangulated": Case(
            lambda x, p: G.triangulate_points(p, p.flip(-1), x, x.flip(1)), ((2, 4, 2), (2, 3, 4))
        ),
    }  # fmt: skip
    compiled = ("triangulated",)


def test_points_at_infinity(device):
    P1, P2 = torch.eye(3, 4, device=device), torch.eye(3, 4, device=device)
    P2[0, 3] = -1
    x = torch.tensor([[0.5, 0.25], [0.5, 0.25]], device=device)
    y = torch.tensor([[0.5, 0.25], [0.25, 0.25]], device=device)
    result = finite_gradients(lambda x, y: G.triangulate_points(P1, P2, x, y), x, y)
    assert result[0].isnan().all()
    assert_close(result[1], torch.tensor([2.0, 1, 4], device=device), 1e-5, 1e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_cameras_without_a_baseline(dtype, device):
    """The same camera twice, or turned about its center, of the first and third pairs; the others tell distances."""
    scene = Scene(4, 20, noise=0.5)
    x1, x2 = (v.to(device, dtype) for v in (scene.x1, scene.x2))
    P1, P2 = (P.expand(4, 3, 4).to(device, dtype).clone() for P in (scene.P1, scene.P2))
    turned = G.liegroup.So3.exp(torch.tensor([0.1, -0.2, 0.3]).double()).matrix().to(device, dtype)
    P2[0], P2[2] = P1[0], turned @ P1[2]
    x2[0, :10] = x1[0, :10]
    backends = [finite_gradients(lambda *x: G.triangulate_points(*x), P1, P2, x1, x2)]
    with K.backend("reference"):
        backends.append(G.triangulate_points(P1, P2, x1, x2))
    for X in (*backends, G.triangulate_points(P1, P2, x1, x2, homogeneous=True)):
        assert X[::2].isnan().all() and X[1::2].isfinite().all()


def test_homogeneous_points(device):
    """cv2.triangulatePoints up to the sign, which tells the side of the first camera; points at infinity have gradients."""
    scene = Scene(1, 40, noise=0.5)
    args = scene.P1, scene.P2, scene.x1[0], scene.x2[0]
    theirs = torch.from_numpy(cv2.triangulatePoints(*(x.numpy() for x in args[:2]), *(x.T.numpy() for x in args[2:])).T)
    ours = G.triangulate_points(*(x.to(device) for x in args), homogeneous=True).cpu()
    assert_close(ours, theirs * (theirs @ scene.P1[2]).sign()[:, None], 1e-6, 1e-6)
    assert_close(ours[:, :3] / ours[:, 3:], G.triangulate_points(*args), 1e-9, 1e-9)

    P1, P2 = torch.eye(3, 4, device=device), torch.eye(3, 4, device=device)
    P2[0, 3] = -1
    x = torch.tensor([[0.5, 0.25], [0.5, 0.25]], device=device)
    y = torch.tensor([[0.5, 0.25], [0.75, 0.25]], device=device)  # far away, and behind both cameras
    result = finite_gradients(lambda x, y: G.triangulate_points(P1, P2, x, y, homogeneous=True), x, y)
    assert result[0, 3].abs() < 1e-6 and result[0, 2] > 0
    assert result[1, 3] < 0
    assert_close(result[1, :3] / result[1, 3], torch.tensor([-2.0, -1, -4], device=device), 1e-5, 1e-5)
    assert torch.autograd.gradcheck(
        lambda x, y: G.triangulate_points(P1.double(), P2.double(), x, y, homogeneous=True),
        (x.double().requires_grad_(), y.double().requires_grad_()),
    )


def test_triangulation_of_many_points_of_one_pair(device):
    """The gradients to their projections are sums of sums."""
    scene = Scene(1, 2500, noise=0.5)
    weights = rand(1, 2500, 3, seed=4).to(device)
    results = []
    for backend in ("auto", "auto", "reference"):
        leaves = [x.to(device).requires_grad_() for x in (scene.P1, scene.P2, scene.x1, scene.x2)]
        with K.backend(backend):
            result = G.triangulate_points(*leaves)
            results.append([result.detach(), *torch.autograd.grad(result, leaves, weights)])
    assert all(torch.equal(a, b) for a, b in zip(*results[:2]))
    assert_close(results[0], results[2], 1e-8, 1e-8)


def test_opencv_triangulation():
    scene = Scene(1, 40, noise=0.5)
    X = cv2.triangulatePoints(scene.P1.numpy(), scene.P2.numpy(), scene.x1[0].T.numpy(), scene.x2[0].T.numpy())
    expected = torch.from_numpy((X[:3] / X[3]).T)
    assert_close(G.triangulate_points(scene.P1, scene.P2, scene.x1[0], scene.x2[0]), expected, 1e-6, 1e-6)


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.triangulate_points(M, M, P, Q), ValueError, r"triangulate_points: expected P1 of shape \(\*, 3, 4\)"),
    (lambda: G.triangulate_points(torch.rand(3, 4), torch.rand(3, 4), P, Q, "qr"), NotImplementedError, "triangulate_points:"),
    (lambda: G.triangulate_points(torch.rand(3, 3, 4), torch.rand(3, 4), P, Q), ValueError, "triangulate_points: expected shapes"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


SCENE = Scene(1, 4)


class TestTriangulationOperators(PointOpTests):
    calls = {
        "triangulate": [
            Call(
                (near(SCENE.x1[0]), near(SCENE.x2[0]), near(SCENE.P1, 0.01), near(SCENE.P2, 0.01)),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=2000,
            )
        ],
    }
