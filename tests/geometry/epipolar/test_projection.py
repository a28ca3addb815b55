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


@pytest.mark.parametrize("factor", [0.3, 0.5, 1.0, 1.5, 3.0])
def test_scaled_cameras_see_resized_images(factor, device):
    """The pixel at which a camera of the resized image sees a point shows what the pixel of the first one shows."""
    y, x = (v.double() for v in torch.meshgrid(torch.arange(40), torch.arange(60), indexing="ij"))
    ramps = torch.stack([x, y])[None].to(device)  # each pixel shows its coordinates
    camera = torch.tensor([[50.0, 2, 28.3], [0, 45, 21.7], [0, 0, 1]], dtype=torch.float64, device=device)
    points = torch.tensor([[0.1, -0.05, 1.0], [-0.3, 0.2, 1.5]], dtype=torch.float64, device=device)
    small = G.resize(ramps, (round(40 * factor), round(60 * factor)))

    def shown(camera):
        pixels = G.convert_points_from_homogeneous(points @ camera.mT)
        return G.remap(small, *(pixels[None, None, :, i] for i in (0, 1)), align_corners=True)[0, :, 0].mT

    truth = G.convert_points_from_homogeneous(points @ camera.mT)
    scaled = G.scale_intrinsics(camera, factor, pixel_centers=True)
    assert_close(shown(scaled), truth, 0, 1e-6)
    each = torch.tensor([factor, 1.0], device=device)
    assert_close(G.scale_intrinsics(camera[None], each, pixel_centers=True)[0], scaled, 0, 1e-5)
    intrinsics = torch.eye(4, dtype=torch.float64, device=device)[None].repeat(2, 1, 1)
    intrinsics[:, :3, :3] = camera
    size = intrinsics.new_full((2,), 40)
    pinhole = G.PinholeCamera(intrinsics, intrinsics, size, size)
    assert_close(pinhole.scale(factor, pixel_centers=True).camera_matrix[1], scaled)
    assert_close(pinhole.scale(each.double(), pixel_centers=True).camera_matrix[1], camera)
    # The center of an image stays its center.
    centers = (G.intrinsics_like(1.0, image, pixel_centers=True)[0, :2, 2] for image in (ramps, small))
    center, resized = centers
    moved = torch.eye(3, dtype=torch.float64, device=device)
    moved[:2, 2] = center
    assert_close(G.scale_intrinsics(moved, factor, pixel_centers=True)[:2, 2], resized, 0, 1e-6)


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
