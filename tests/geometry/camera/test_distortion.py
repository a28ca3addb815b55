"""Lenses of the affine and the Kannala-Brandt model."""

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


P2, P3, K4, K8 = (2, 5, 2), (2, 5, 3), (2, 1, 4), (2, 1, 8)


class TestDistortion(CompositionTests):
    cases = {
        "distort_points_affine": Case(C.distort_points_affine, (P2, K4)),
        "undistort_points_affine": Case(C.undistort_points_affine, (P2, K4)),
        "dx_distort_points_affine": Case(C.dx_distort_points_affine, (P2, K4)),
        "distort_points_kannala_brandt": Case(lambda p, k: C.distort_points_kannala_brandt(p, lens(k)), (P2, K8)),
        "undistort_points_kannala_brandt": Case(
            lambda p, k: C.undistort_points_kannala_brandt(300 * p, lens(k)), (P2, K8)
        ),
        "dx_distort_points_kannala_brandt": Case(lambda p, k: C.dx_distort_points_kannala_brandt(p, lens(k)), (P2, K8)),
    }
    compiled = ("dx_distort_points_kannala_brandt",)


def rand(*shape: int, seed: int = 4) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) + 0.1


CALLS = [
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


def test_fisheye_equals_opencv(device):
    cv2 = pytest.importorskip("cv2")
    points = 3 * rand(50, 2) - 2
    matrix = torch.eye(3, dtype=torch.float64)
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = FISHEYE[:4]
    space = torch.cat([points, torch.ones(50, 1, dtype=torch.float64)], -1)
    zero = torch.zeros(3, 1, dtype=torch.float64).numpy()
    expected, _ = cv2.fisheye.projectPoints(space[:, None].numpy(), zero, zero, matrix.numpy(), FISHEYE[4:].numpy())
    result = C.distort_points_kannala_brandt(points.to(device), FISHEYE.to(device))
    assert_close(result.cpu(), torch.from_numpy(expected[:, 0]), 1e-10, 1e-8)
    assert_close(C.undistort_points_kannala_brandt(result, FISHEYE.to(device)).cpu(), points, 1e-9, 1e-9)


@pytest.mark.parametrize("largest", [0.05, 0.3])
def test_wide_fisheyes_are_inverted(largest, device):
    """Angles up to 83 degrees, distorted to radii up to 9: Newton's method starts far away."""
    angle, direction = 1.45 * rand(2000), 6.28 * rand(2000)
    points = torch.stack([angle.tan() * direction.cos(), angle.tan() * direction.sin()], -1)
    params = torch.cat([torch.tensor([1.0, 1, 0, 0]).double().expand(2000, 4), largest * rand(2000, 4)], -1)
    points, params = points.to(device), params.to(device)
    back = C.undistort_points_kannala_brandt(C.distort_points_kannala_brandt(points, params), params)
    assert_close(back, points, 1e-9, 1e-9)


@pytest.mark.parametrize("position", [[0.0, 0.0], [1e-30, 0.0], [1e-6, 1e-6], [0.3, -0.4], [3.0, 4.0]])
def test_jacobian_and_inverse_of_a_fisheye(position, device):
    p, k = torch.tensor(position, dtype=torch.float64, device=device), FISHEYE.to(device)
    jacobian = torch.func.jacfwd(C.distort_points_kannala_brandt)(p, k)
    assert_close(C.dx_distort_points_kannala_brandt(p, k), jacobian)
    assert_close(torch.func.jacrev(C.distort_points_kannala_brandt)(p, k), jacobian)
    pixel = C.distort_points_kannala_brandt(p, k)
    back = torch.func.jacrev(C.undistort_points_kannala_brandt)(pixel, k)
    assert_close(back @ jacobian, torch.eye(2, dtype=torch.float64, device=device), 0, 1e-9)
    curved = torch.func.hessian(lambda q: C.distort_points_kannala_brandt(q, k).sum())(p)
    assert curved.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_rays_of_a_fisheye_reach_180_degrees(dtype, device):
    """On the plane at depth 1 they are NaN from 90 degrees on, without a gradient."""
    degrees = torch.tensor([0.0, 30, 89, 90.5, 120, 179], dtype=torch.float64)
    angle = degrees.deg2rad()
    lens = torch.tensor([190.0, 180, 160, 120, 0.01, -0.002, 3e-4, -1e-5], dtype=torch.float64)
    distorted = angle * (1 + sum(k * angle ** (2 * i + 2) for i, k in enumerate(lens[4:].tolist())))
    direction = torch.tensor([0.6, -0.8], dtype=torch.float64)
    pixels = distorted[:, None] * direction * lens[:2] + lens[2:4]
    pixels, lens = pixels.to(device, dtype).requires_grad_(), lens.to(device, dtype).requires_grad_()
    rays = C.undistort_points_kannala_brandt(pixels, lens, return_rays=True)
    expected = torch.cat([angle.sin()[:, None] * direction, angle.cos()[:, None]], -1)
    assert_close(rays.detach().cpu().double(), expected, 0, 1e-5)
    points = C.undistort_points_kannala_brandt(pixels, lens)
    assert points.isnan().all(-1).tolist() == [False] * 3 + [True] * 3
    assert_close(points[:3].detach().cpu().double(), angle[:3].tan()[:, None] * direction, 1e-3, 1e-6)
    grads = torch.autograd.grad(points.nan_to_num(0).sum(), (pixels, lens))
    assert all(g.isfinite().all() for g in grads) and not grads[0][3:].any()


def test_pixels_without_a_ray_are_nan(device):
    """theta (1 - .3 theta^2) has its largest value, .7027, at 60.4 degrees; the mask of distortion ends there."""
    lens = torch.tensor([100.0, 100, 0, 0, -0.3, 0, 0, 0], dtype=torch.float64, device=device)
    pixels = torch.tensor([[70.2, 0], [70.3, 0], [90, 0], [torch.inf, 0], [torch.nan, 0]], dtype=torch.float64)
    for return_rays in (False, True):
        back = C.undistort_points_kannala_brandt(pixels.to(device), lens, return_rays)
        assert back.isnan().all(-1).tolist() == [False] + [True] * 4
    points = torch.tensor([[1.75, 0], [1.77, 0], [1e6, 0], [torch.inf, 1]], dtype=torch.float64, device=device)
    seen, valid = C.distort_points_kannala_brandt(points, lens, return_valid=True)
    assert valid.tolist() == [True, False, False, False]
    assert_close(seen, C.distort_points_kannala_brandt(points, lens))


BAD = [
    (lambda: C.distort_points_affine(rand(2, 2), rand(8)), ValueError, r"expected params of shape \(\*, 4\)"),
    (lambda: C.undistort_points_kannala_brandt(rand(2, 2), rand(3, 8)), ValueError, "leading axes that broadcast"),
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
