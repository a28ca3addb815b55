"""Projection matrices and cameras."""

import cv2
import pytest
import torch

import kvision as K
from composition_tests import Case
from op_tests import assert_close
from point_op_tests import EYE34, Call, PointOpTests, near
from view_tests import Scene, ViewTests

G = K.geometry
SCENE = Scene(1, 8)


class TestProjection(ViewTests):
    cases = {
        "camera": Case(lambda p: torch.cat(G.KRt_from_projection(p), -1), ((2, 3, 4),)),
        "cameras": Case(lambda f: G.projections_from_fundamental(f).square(), ((2, 3, 3),)),
    }  # fmt: skip
    compiled = ("camera",)


def test_opencv_decomposition():
    camera, R, center = cv2.decomposeProjectionMatrix(SCENE.P2.numpy())[:3]
    result = G.KRt_from_projection(SCENE.P2[None])
    assert_close(result[0][0] / result[0][0, 2, 2], torch.from_numpy(camera), 1e-9, 1e-9)
    assert_close(result[1][0], torch.from_numpy(R), 1e-9, 1e-9)
    assert_close(-result[1][0].T @ result[2][0], torch.from_numpy(center[:3] / center[3]), 1e-9, 1e-9)


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.projection_from_KRt(M, M[0], M[..., :1]), ValueError, "projection_from_KRt: expected K, R and t with as many axes"),
    (lambda: G.intrinsics_like(0.0, torch.rand(1, 1, 2, 2)), ValueError, "intrinsics_like: expected focal above 0"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestProjectionOperators(PointOpTests):
    calls = {
        "decompose_projection": [Call((near(EYE34),)), Call((near(-EYE34),))],
    }


def test_focal_lengths_of_images(device):
    """A tensor of one number or one a sample, with gradient, from any device; a number where all agree."""
    images = torch.zeros(2, 3, 20, 30, dtype=torch.float64, device=device)
    focal = torch.tensor([100.0, 50.0], requires_grad=True)
    result = G.intrinsics_like(focal, images)
    expected = torch.cat([G.intrinsics_like(f, images[:1]) for f in (100.0, 50.0)])
    assert_close(result, expected)
    result.sum().backward()
    assert focal.grad.tolist() == [2, 2]
    assert_close(G.intrinsics_like(torch.tensor(100), images)[0], expected[0])
    with pytest.raises(ValueError, match=r"intrinsics_like: expected focal of shape \(\) or \(2,\), got \(3,\)"):
        G.intrinsics_like(torch.ones(3), images)
