"""Camera models beside those of Kornia and OpenCV: parallel rays, pinhole and fisheye lenses, stereo pairs."""

import itertools

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests, on
from op_tests import assert_close

G, C = K.geometry, K.geometry.camera
FISHEYE = torch.tensor([190.0, 180, 160, 120, 0.05, -0.03, 0.02, -0.004], dtype=torch.float64)


def lens(k: Tensor) -> Tensor:
    """Parameters near those of a lens from random ones."""
    return on(k.device, FISHEYE) * (0.9 + 0.2 * k)


def pair(shift: Tensor) -> G.StereoCamera:
    left = torch.zeros(*shift.shape, 3, 4, dtype=shift.dtype, device=shift.device)
    left = left + torch.eye(3, 4, dtype=shift.dtype, device=shift.device)
    right = torch.cat(
        [left[..., :3], -shift[:, None, None] * torch.eye(3, 1, dtype=shift.dtype, device=shift.device)], -1
    )
    return G.StereoCamera(left, right)


P2, P3, K4, K8 = (2, 5, 2), (2, 5, 3), (2, 1, 4), (2, 1, 8)


class TestCameras(CompositionTests):
    cases = {
        "pixel2cam": Case(G.pixel2cam, ((2, 1, 3, 4), (2, 4, 4), (2, 3, 4, 3))),
        "cam2pixel": Case(G.cam2pixel, ((2, 3, 4, 3), (2, 4, 4))),
        "project_points_z1": Case(C.project_points_z1, (P3,)),
        "unproject_points_z1": Case(C.unproject_points_z1, (P2, (2, 5))),
        "dx_project_points_z1": Case(C.dx_project_points_z1, (P3,)),
        "project_points_orthographic": Case(C.project_points_orthographic, (P3,)),
        "unproject_points_orthographic": Case(C.unproject_points_orthographic, (P2, (2, 5, 1))),
        "dx_project_points_orthographic": Case(C.dx_project_points_orthographic, (P3,), differentiable=False),
        "distort_points_affine": Case(C.distort_points_affine, (P2, K4)),
        "undistort_points_affine": Case(C.undistort_points_affine, (P2, K4)),
        "dx_distort_points_affine": Case(C.dx_distort_points_affine, (P2, K4)),
        "distort_points_kannala_brandt": Case(lambda p, k: C.distort_points_kannala_brandt(p, lens(k)), (P2, K8)),
        "undistort_points_kannala_brandt": Case(
            lambda p, k: C.undistort_points_kannala_brandt(300 * p, lens(k)), (P2, K8)
        ),
        "dx_distort_points_kannala_brandt": Case(lambda p, k: C.dx_distort_points_kannala_brandt(p, lens(k)), (P2, K8)),
        "StereoCamera": Case(lambda d, s: pair(s).reproject_disparity_to_3D(d), ((2, 3, 4, 1), (2,))),
    }
    compiled = ("dx_distort_points_kannala_brandt", "StereoCamera")


def rand(*shape: int, seed: int = 4) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) + 0.1


CALLS = [
    ("pixel2cam", (rand(2, 1, 3, 4), rand(2, 4, 4), rand(2, 3, 4, 3))),
    ("cam2pixel", (rand(2, 3, 4, 3), rand(2, 4, 4))),
    ("project_points_z1", (rand(2, 5, 3),)),
    ("unproject_points_z1", (rand(2, 5, 2),)),
    ("unproject_points_z1", (rand(2, 5, 2), rand(2, 5))),
    ("unproject_points_z1", (rand(2, 5, 2), rand(2, 5, 1))),
    ("dx_project_points_z1", (rand(2, 5, 3),)),
    ("project_points_orthographic", (rand(2, 5, 3),)),
    ("unproject_points_orthographic", (rand(2, 5, 2), rand(2, 5))),
    ("dx_project_points_orthographic", (rand(2, 5, 3),)),
    ("distort_points_affine", (rand(2, 5, 2), rand(2, 1, 4))),
    ("undistort_points_affine", (rand(2, 5, 2), rand(4))),
    ("dx_distort_points_affine", (rand(2, 5, 2), rand(2, 1, 4))),
    ("distort_points_kannala_brandt", (rand(2, 5, 2) - 0.6, FISHEYE)),
    ("undistort_points_kannala_brandt", (250 * rand(2, 5, 2), FISHEYE)),
    ("dx_distort_points_kannala_brandt", (rand(2, 5, 2) - 0.6, FISHEYE)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry.camera
    expected = getattr(theirs, name)(*args)
    assert_close(getattr(C, name)(*(a.to(device) for a in args)).cpu(), expected, 1e-8, 1e-9)


def test_fisheye_is_that_of_opencv(device):
    cv2 = pytest.importorskip("cv2")
    points = 3 * rand(50, 2) - 2
    matrix = torch.eye(3, dtype=torch.float64)
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = FISHEYE[:4]
    space = torch.cat([points, torch.ones(50, 1, dtype=torch.float64)], -1)
    zero = torch.zeros(3, 1, dtype=torch.float64).numpy()
    expected, _ = cv2.fisheye.projectPoints(space[:, None].numpy(), zero, zero, matrix.numpy(), FISHEYE[4:].numpy())
    found = C.distort_points_kannala_brandt(points.to(device), FISHEYE.to(device))
    assert_close(found.cpu(), torch.from_numpy(expected[:, 0]), 1e-10, 1e-8)
    assert_close(C.undistort_points_kannala_brandt(found, FISHEYE.to(device)).cpu(), points, 1e-9, 1e-9)


@pytest.mark.parametrize("place", [[0.0, 0.0], [1e-30, 0.0], [1e-6, 1e-6], [0.3, -0.4], [3.0, 4.0]])
def test_jacobian_and_inverse_of_a_fisheye(place, device):
    p, k = torch.tensor(place, dtype=torch.float64, device=device), FISHEYE.to(device)
    jacobian = torch.func.jacfwd(C.distort_points_kannala_brandt)(p, k)
    assert_close(C.dx_distort_points_kannala_brandt(p, k), jacobian)
    assert_close(torch.func.jacrev(C.distort_points_kannala_brandt)(p, k), jacobian)
    pixel = C.distort_points_kannala_brandt(p, k)
    back = torch.func.jacrev(C.undistort_points_kannala_brandt)(pixel, k)
    assert_close(back @ jacobian, torch.eye(2, dtype=torch.float64, device=device), 0, 1e-9)
    curved = torch.func.hessian(lambda q: C.distort_points_kannala_brandt(q, k).sum())(p)
    assert curved.isfinite().all()


def cameras(batch: int) -> tuple[Tensor, Tensor]:
    left = torch.zeros(batch, 3, 4, dtype=torch.float64)
    left[:, :, :3] = torch.tensor([[100.0, 0, 32], [0, 90, 20], [0, 0, 1]])
    right = left.clone()
    right[:, 0, 3] = -20 - torch.arange(batch)
    return left, right


@pytest.mark.parametrize("batch", [1, 2])
def test_stereo_is_that_of_kornia(batch, device):
    theirs = pytest.importorskip("kornia").geometry
    ours, his = G.StereoCamera(*(c.to(device) for c in cameras(batch))), theirs.StereoCamera(*cameras(batch))
    for name in ("fx", "fy", "cx_left", "cx_right", "cy", "tx", "Q"):
        assert_close(getattr(ours, name).cpu(), getattr(his, name))
    disparity = 10 * rand(2, 4, 5, 1)
    disparity[0, 0, 0] = 0
    for a, b in zip(
        ours.reproject_disparity_to_3D(disparity.to(device), True), his.reproject_disparity_to_3D(disparity, True)
    ):
        assert_close(a.cpu(), b, 1e-9, 1e-9)
    assert ours.batch_size == batch
    assert ours.device.type == device.type


def test_stereo_depth(device):
    """A point seen by both cameras comes back."""
    left, right = (c.to(device) for c in cameras(1))
    point = torch.tensor([[0.2, -0.1, 4.0]], dtype=torch.float64, device=device)
    seen = [G.transform_points(torch.cat([P, P.new_tensor([[[0, 0, 0, 1]]])], 1), point) for P in (left, right)]
    (u, v), (u2, _) = (G.convert_points_from_homogeneous(p)[0] for p in seen)
    x, y = int(u.round()), int(v.round())
    disparity = (u - u2).reshape(1, 1, 1, 1).expand(1, 40, 64, 1)
    found = G.StereoCamera(left, right).reproject_disparity_to_3D(disparity)[0, y, x]
    assert_close(found[2], point[0, 2])
    assert (found - point[0]).abs().max() < 0.5 * 4 / 90


LEFT, RIGHT = cameras(1)
BAD = [
    (lambda: G.pixel2cam(rand(1, 3, 4), rand(1, 4, 4), rand(1, 3, 4, 3)), ValueError, "pixel2cam: expected depth of shape"),
    (lambda: G.cam2pixel(rand(3, 3, 4, 3), rand(2, 4, 4)), ValueError, "cam2pixel: expected dst_proj_src with 1 or 3 matrices"),
    (lambda: C.project_points_z1([1.0]), TypeError, "project_points_z1: expected points_in_camera to be a Tensor"),
    (lambda: C.unproject_points_z1(rand(2, 2), rand(2, 2)), ValueError, "unproject_points_z1: expected extension of shape"),
    (lambda: C.distort_points_affine(rand(2, 2), rand(8)), ValueError, r"expected params of shape \(\*, 4\)"),
    (lambda: C.undistort_points_kannala_brandt(rand(2, 2), rand(3, 8)), ValueError, "leading axes that broadcast"),
    (lambda: G.StereoCamera(LEFT[0], RIGHT[0]), ValueError, "StereoCamera: expected rectified_left_camera of shape"),
    (lambda: G.StereoCamera(LEFT, 2 * RIGHT), ValueError, "StereoCamera: expected cameras that are equal but"),
    (lambda: G.StereoCamera(LEFT, LEFT), ValueError, r"expected rectified_right_camera\[:, 0, 3\] to be negative"),
    (lambda: G.StereoCamera(LEFT, RIGHT.float()), TypeError, "StereoCamera: expected cameras of one type"),
    (lambda: G.StereoCamera(LEFT, RIGHT).reproject_disparity_to_3D(rand(1, 3, 4)), ValueError, "expected disparity_tensor"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_half_types(device):
    p, k = rand(5, 2).to(device), FISHEYE.to(device)
    for dtype, f in itertools.product(
        (torch.float16, torch.bfloat16), (C.distort_points_kannala_brandt, C.distort_points_affine)
    ):
        params = k if f is C.distort_points_kannala_brandt else k[:4]
        assert_close(f(p.to(dtype), params), f(p.to(dtype).float(), params.float()).to(dtype))
