"""Undistortion finds the point that the lens shows at a pixel, or says NaN."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close

G = K.geometry
DOUBLE = torch.float64
CAMERA = torch.tensor([[600.0, 0, 320], [0, 610, 240], [0, 0, 1]], dtype=DOUBLE)
BARREL = torch.tensor([-0.3, 0, 0, 0], dtype=DOUBLE)  # r (1 - .3 r^2) has its largest value, .7027, at r = 1.0541
FOLD = (1 / 0.9) ** 0.5


def monotone_lenses(count: int) -> Tensor:
    """Coefficients (count, 12) of lenses whose distortion grows up to r = 1.3, half of them rational and tangential."""
    random = np.random.default_rng(3)
    r2 = np.linspace(0, 1.69, 200)
    lenses = []
    while len(lenses) < count:
        k = np.zeros(12)
        k[[0, 1, 4]] = random.uniform([-0.45, -0.3, -0.1], [0.5, 0.3, 0.1])
        if len(lenses) % 2:
            k[5:8] = random.uniform(-0.1, 0.3, 3)
            k[2:4], k[8:] = random.uniform(-0.005, 0.005, 2), random.uniform(-0.003, 0.003, 4)
        radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
        if np.diff(np.sqrt(r2) * radial).min() > 2e-4 * np.diff(np.sqrt(r2)).max() and radial.max() < 4:
            lenses.append(k)
    return torch.tensor(np.stack(lenses))


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE], ids=str)
@pytest.mark.parametrize("steps", [0, 5, 30])
def test_monotone_lenses_are_inverted(steps, dtype, device):
    """All points of 150 lenses, to 52 degrees from the axis: distorted in float64, they come back."""
    lenses = monotone_lenses(150).to(device)
    angle, radius = (torch.linspace(0, end, 40, dtype=DOUBLE, device=device) for end in (97.0, 1.28))
    plane = torch.stack([radius * angle.cos(), radius * angle.sin()], -1)
    camera = CAMERA.to(device)
    points = (plane * camera.diagonal()[:2] + camera[:2, 2]).expand(150, 40, 2)
    with K.backend("reference"):
        seen = G.distort_points(points, camera, lenses)
    back = G.undistort_points(seen.to(dtype), camera.to(dtype), lenses.to(dtype), num_iters=steps)
    again = G.distort_points(back.double(), camera, lenses)
    assert (again - seen).abs().max() < (2e-3 if dtype == torch.float32 else 1.01e-3)
    assert_close(back.double(), points, 0, 0.5 if dtype == torch.float32 else 0.05)


def test_the_corner_that_a_fixed_point_iteration_misses(device):
    """A point of x = -309.3, y = -173.9 by SciPy's root finding."""
    camera = torch.tensor([[250.0, 0, 320], [0, 250, 240], [0, 0, 1]], dtype=DOUBLE)
    lens = torch.tensor([-0.28, 0.08, 0, 0], dtype=DOUBLE)
    corner = torch.zeros(1, 2, dtype=DOUBLE)
    direction = -camera[:2, 2] / 250
    seen = float(direction.norm())
    radius = scipy.optimize.brentq(lambda r: r * (1 - 0.28 * r**2 + 0.08 * r**4) - seen, 0, 10)
    expected = direction / seen * radius * 250 + camera[:2, 2]
    for steps in (5, 20, 1000):
        back = G.undistort_points(*(x.to(device) for x in (corner, camera, lens)), num_iters=steps)
        assert_close(back.cpu(), expected[None], 0, 1e-2)


def test_opencv_agrees_where_it_converges(device):
    camera, lens = CAMERA.numpy(), np.array([-0.2, 0.05, 0.001, -0.002, 0.01])
    points = np.random.default_rng(0).uniform(0, 1, (200, 1, 2)) * [640, 480]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    expected = cv2.undistortPoints(points, camera, lens, P=camera, criteria=criteria)[:, 0]
    back = G.undistort_points(*(torch.from_numpy(x).to(device) for x in (points[:, 0], camera, lens)))
    assert_close(back.cpu(), torch.from_numpy(expected), 0, 2e-3)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE], ids=str)
def test_pixels_without_a_point_are_nan(dtype, device):
    """Their gradients are 0, and so is what they add to those of the lens."""
    radius = torch.tensor([0.1, 0.69, 0.702, 0.704, 0.8, 3.0, torch.inf, torch.nan], dtype=dtype, device=device)
    points = torch.stack([600 * radius + 320, torch.full_like(radius, 240)], -1)
    args = [x.to(device, dtype).requires_grad_() for x in (points, CAMERA, BARREL)]
    back = G.undistort_points(*args)
    assert back.isnan().all(-1).tolist() == [False] * 3 + [True] * 5
    assert back.isnan().any(-1).tolist() == [False] * 3 + [True] * 5
    grads = torch.autograd.grad(back.nan_to_num(0).sum(), args)
    assert all(g.isfinite().all() for g in grads) and not grads[0][3:].any()
    some = [args[0][:3].detach().requires_grad_(), *args[1:]]
    alone = torch.autograd.grad(G.undistort_points(*some).sum(), some)
    for a, b in zip(grads[1:], alone[1:]):
        assert_close(a, b)


def test_gradients_are_those_of_the_inverse(device):
    """Where a fixed-point iteration diverges: J of the inverse times J of the distortion is the identity."""
    camera, lens = CAMERA.to(device), torch.tensor([-0.28, 0.08, 0.001, 0.002], dtype=DOUBLE, device=device)
    point = torch.tensor([[-450.0, -390.0]], dtype=DOUBLE, device=device)
    seen = G.distort_points(point, camera, lens)
    to, back = (
        torch.autograd.functional.jacobian(lambda p, f=f: f(p[None], camera, lens)[0], x[0])
        for f, x in ((G.distort_points, point), (G.undistort_points, seen))
    )
    assert_close(back @ to, torch.eye(2, dtype=DOUBLE, device=device), 0, 1e-4)
    leaves = [x.clone().requires_grad_() for x in (seen, camera, lens)]
    exact = [x.clone().requires_grad_() for x in (point, camera, lens)]
    grads = torch.autograd.grad(G.undistort_points(*leaves)[0, 0], leaves)
    jacobians = torch.autograd.functional.jacobian(lambda *x: G.distort_points(*x)[0], tuple(exact))
    inverse = torch.linalg.inv(jacobians[0][:, 0])
    assert_close(grads[2], -(inverse @ jacobians[2])[0], 1e-4, 1e-2)


def test_images_have_no_rings_beyond_the_fold(device):
    """A white image: what the lens shows is white, and what lies beyond the radius to which it grows is 0."""
    image = torch.ones(1, 1, 301, 401, device=device)
    camera = torch.tensor([[[100.0, 0, 200], [0, 100, 150], [0, 0, 1]]], device=device)
    lens = BARREL.float()[None].to(device)
    y, x = (torch.arange(n, device=device) - n // 2 for n in (301, 401))
    radius = (x * x + (y * y)[:, None]).sqrt() / 100
    result = G.undistort_image(image, camera, lens)[0, 0]
    assert (result[radius < FOLD - 1e-3] > 0.9999).all() and (result[radius > FOLD + 1e-3] == 0).all()
    leaves = [x.clone().requires_grad_() for x in (image, camera, lens)]
    for grad in torch.autograd.grad(G.undistort_image(*leaves).sum(), leaves):
        assert grad.isfinite().all()
    mild = G.undistort_image(image, camera, 0.05 * lens.abs())
    assert mild[..., 100:200, 150:250].min() > 0.9999
