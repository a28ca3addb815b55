"""Calibration against OpenCV on synthetic views of a board, its gradients, and views that are missing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.calibration._lenses import projected, projected_with_jacobians
from kvision.geometry.calibration.camera import _BoardError
from kvision.geometry.liegroup import Se3, So3
from kvision.geometry.optim import least_squares

F64 = torch.float64
LENSES = {
    "brown_conrady": torch.tensor(
        [-0.25, 0.08, 0.001, -0.0005, 0.01, 0.1, 0.02, 0.01, 0.001, 0.0, -0.001, 0.0], dtype=F64
    ),
    "kannala_brandt": torch.tensor([0.02, -0.01, 0.003, -0.001], dtype=F64),
}
SIZE = (480, 640)


def views(
    model: str, count: int, batch: int = 1, noise: float = 0.3, views: int = 6, side: float = 0.04
) -> tuple[Tensor, Tensor]:
    """Points of a 7 x 6 board and their noisy pixels, through the first `count` coefficients of a lens."""
    generator = torch.Generator().manual_seed(0)

    def uniform(*shape: int) -> Tensor:
        return 2 * torch.rand(*shape, generator=generator, dtype=F64) - 1

    board = torch.cartesian_prod(torch.arange(7.0), torch.arange(6.0)).to(F64) - torch.tensor([3.0, 2.5])
    board = torch.cat([side * board, torch.zeros(42, 1, dtype=F64)], -1).expand(batch, views, 42, 3)
    turn = Se3.exp(torch.cat([torch.zeros(batch, views, 3, dtype=F64), 0.5 * uniform(batch, views, 3)], -1))
    shift = torch.tensor([0.08, 0.08, 0.1]) * uniform(batch, views, 1, 3) + torch.tensor([0.0, 0.0, 0.42])
    p = (turn[:, :, None] * board).detach() + shift
    image = projected(model, p.flatten(1, 2), LENSES[model][:count].expand(batch, count))
    pixels = image.unflatten(1, (views, 42)) * torch.tensor([600.0, 610.0]) + torch.tensor([322.0, 236.0])
    return board, pixels + noise * torch.randn(pixels.shape, generator=generator, dtype=F64)


@pytest.mark.parametrize(("model", "count"), [("brown_conrady", 5), ("brown_conrady", 12), ("kannala_brandt", 4)])
def test_as_accurate_as_opencv(model: str, count: int, device: torch.device) -> None:
    cv2 = pytest.importorskip("cv2")
    X, x = views(model, count, views=20 if count == 12 else 6)
    ours = K.geometry.calibrate_camera(X.to(device), x.to(device), SIZE, model=model, num_coefficients=count)
    boards, corners = ([v.numpy().astype(np.float32) for v in t[0]] for t in (X, x))
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    if model == "kannala_brandt":
        flags = getattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC", 2) | getattr(cv2, "CALIB_FIX_SKEW", 8)  # names of OpenCV 5
        boards, corners = ([v[None] for v in t] for t in (boards, corners))
        start = np.zeros((3, 3)), np.zeros((4, 1))
        rms, camera, *_ = cv2.fisheye.calibrate(boards, corners, SIZE[::-1], *start, flags=flags, criteria=criteria)
    else:
        flags = cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL if count == 12 else 0
        rms, camera, *_ = cv2.calibrateCamera(boards, corners, SIZE[::-1], None, None, flags=flags, criteria=criteria)
    assert ours.rms.item() < rms + 1e-4
    if count < 12:  # where numerator and denominator cancel, parameters say little
        assert abs(ours.rms.item() - rms) < 1e-4 and ours.converged.all()
        deviation = ours.covariance[0].diagonal()[:4].sqrt().cpu()
        difference = ours.camera_matrix[0, [0, 1, 0, 1], [0, 1, 2, 2]].cpu() - torch.from_numpy(
            camera[[0, 1, 0, 1], [0, 1, 2, 2]]
        )
        assert (difference.abs() < 0.1 * deviation).all()
        assert (ours.view_rms[0].square().mean().sqrt() - ours.rms).abs() < 1e-9


def test_jacobians_of_lenses(device: torch.device) -> None:
    """Of fisheye lenses also on the axis and near it, 90 degrees from it and beyond."""
    near = torch.randn(1, 9, 3, generator=torch.Generator().manual_seed(0), dtype=F64) + torch.tensor([0.0, 0.0, 3.0])
    far = torch.tensor([[[0.0, 0, 2], [1e-3, 0, 2], [0, 1e-9, 1], [1, -2, 0], [2, 1, -1], [0.1, 0.2, -0.5]]], dtype=F64)
    for model, k in LENSES.items():
        p = (near if model == "brown_conrady" else torch.cat([near, far], 1)).to(device)
        k = k[None].to(device)
        image, to_point, to_k = projected_with_jacobians(model, p, k)
        torch.testing.assert_close(image, projected(model, p, k))
        by_k = torch.func.jacfwd(lambda k, m=model, p=p: projected(m, p, k))(k)
        torch.testing.assert_close(to_k, by_k[..., 0, :], rtol=1e-9, atol=1e-12)
        by_p = torch.func.vmap(torch.func.jacfwd(lambda p, m=model, k=k: projected(m, p[None, None], k)[0, 0]))(p[0])
        torch.testing.assert_close(to_point[0], by_p, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("widest", [89.9, 95, pytest.param(115, marks=pytest.mark.slow)])
def test_fisheye_lenses_see_behind_the_camera(widest: float, device: torch.device) -> None:
    """Boards up to an angle from the axis, in a lens of another focal length than the start takes it to have."""
    generator = torch.Generator().manual_seed(0)
    board = torch.cartesian_prod(torch.arange(9.0), torch.arange(7.0)).to(F64) - torch.tensor([4.0, 3.0])
    board = torch.cat([board, torch.zeros(63, 1, dtype=F64)], -1)
    k, views, seen = torch.tensor([-0.03, 0.006, -0.002, 0.0001], dtype=F64), [], 0.0
    while len(views) < 10:  # boards that face the camera, turned a little
        u = torch.rand(6, generator=generator, dtype=F64)
        tilt, direction = math.radians(widest - 30) * u[0].sqrt(), 2 * math.pi * u[1]
        axis = torch.stack([-direction.sin(), direction.cos(), torch.zeros((), dtype=F64)]) * tilt
        R = So3.exp(axis[None]).matrix()[0] @ So3.exp(0.6 * (2 * u[None, 3:] - 1)).matrix()[0]
        p = (board @ R.mT).detach() + 6 * So3.exp(axis[None]).matrix()[0, :, 2]
        angle = torch.atan2(p[:, :2].norm(dim=1), p[:, 2])
        if angle.max() < math.radians(widest):
            radius = angle * (1 + sum(c * angle ** (2 * i + 2) for i, c in enumerate(k)))
            views.append(p[:, :2] / p[:, :2].norm(dim=1, keepdim=True) * radius[:, None] * 230 + 300)
            seen = max(seen, math.degrees(angle.max().item()))
    assert seen > widest - 8
    pixels = torch.stack(views)[None]
    pixels = pixels + 0.1 * torch.randn(pixels.shape, generator=generator, dtype=F64)
    X = board.expand(1, 10, 63, 3)
    fit = K.geometry.calibrate_camera(X.to(device), pixels.to(device), (600, 640), model="kannala_brandt")
    assert fit.converged.all() and 0.12 < fit.rms.item() < 0.15  # the root of twice the variance
    deviation = fit.covariance[0].diagonal().sqrt()
    found = torch.cat([fit.camera_matrix[0, [0, 1, 0, 1], [0, 1, 2, 2]], fit.dist[0]]).cpu()
    truth = torch.cat([torch.tensor([230.0, 230, 300, 300]), k])
    assert ((found - truth).abs() < 4 * deviation.cpu()).all()


@pytest.mark.derivatives
def test_gradients_of_intrinsics(device: torch.device) -> None:
    X, x = (t.to(device) for t in views("brown_conrady", 4, views=4))
    step = torch.randn(x.shape, generator=torch.Generator().manual_seed(1), dtype=F64).to(device)

    def camera(x: Tensor) -> Tensor:
        fit = K.geometry.calibrate_camera(X, x, SIZE, num_coefficients=4)
        return torch.cat([fit.camera_matrix[0, :2].flatten(), 100 * fit.dist[0]])[[0, 2, 4, 5, 6, 7, 8, 9]]

    direction = torch.arange(1.0, 9.0, dtype=F64, device=device)
    (grad,) = torch.autograd.grad(camera(x.requires_grad_()) @ direction, x)
    with torch.no_grad():
        difference = (camera(x + 1e-3 * step) - camera(x - 1e-3 * step)) @ direction / 2e-3
    torch.testing.assert_close((grad * step).sum(), difference, rtol=1e-4, atol=1e-4)


@pytest.mark.derivatives
@pytest.mark.parametrize(
    ("model", "count", "num_views", "side"),
    [("brown_conrady", 5, 4, 0.04), ("kannala_brandt", 4, 4, 0.04)]
    + [("brown_conrady", n, 12, 0.1) for n in (8, 12)],  # a board that large determines as many coefficients
)
def test_implicit_gradients_are_those_of_iterations(
    model: str, count: int, num_views: int, side: float, device: torch.device
) -> None:
    """Of intrinsics and lens: against Gauss-Newton's steps from near the solution, unrolled."""
    X, x = (t.to(device) for t in views(model, count, views=num_views, noise=0.05, side=side))
    x.requires_grad_()
    fit = K.geometry.calibrate_camera(X, x, SIZE, model=model, num_coefficients=count, max_iterations=100)
    camera = fit.camera_matrix[:, [0, 1, 0, 1], [0, 1, 2, 2]]
    weights = torch.cat([torch.ones(4), 100 * torch.ones(count)]).to(camera)
    implicit = torch.autograd.grad(torch.cat([camera[0], fit.dist[0]]) @ weights, x)[0]
    pose = Se3(So3.from_wxyz(fit.pose.quaternion.data.detach()), fit.pose.t.detach()).requires_grad_(False)
    unrolled = least_squares(
        _BoardError(model, X, x, torch.ones_like(x[..., 0])),
        {"camera": camera.detach() + 3, "dist": fit.dist.detach(), "pose": pose},
        index={"pose": torch.arange(num_views, device=device)},
        eliminate="pose",
        method="gauss-newton",
        max_iterations=8,
        **dict.fromkeys(("ftol", "xtol", "gtol"), 0.0),
        gradient="unrolled",
    ).variables
    total = torch.cat([unrolled["camera"][0], unrolled["dist"][0]]) @ weights
    expected = torch.autograd.grad(total, x)[0]
    assert (implicit - expected).norm() < 1e-3 * expected.norm()


def test_missing_points_and_views(device: torch.device) -> None:
    X, x = (t.to(device) for t in views("brown_conrady", 4, batch=3))
    weights = torch.ones_like(x[..., 0])
    alone = K.geometry.calibrate_camera(X[:1, 1:], x[:1, 1:], SIZE, num_coefficients=4)
    weights[0, 0, 3:], x[0, 0, 3:] = 0, torch.nan  # too few points of one view
    weights[1, 2, :9], x[1, 2, :9] = 0, torch.nan
    weights[2] = 0
    fit = K.geometry.calibrate_camera(X, x, SIZE, weights, num_coefficients=4)
    assert fit.converged.tolist() == [True, True, False]
    assert fit.camera_matrix[2].isnan().any() and fit.rms.isnan().tolist() == [False, False, True]
    assert fit.pose.t.isnan().any(-1).tolist() == [[True] + 5 * [False], 6 * [False], 6 * [True]]
    torch.testing.assert_close(fit.camera_matrix[:1], alone.camera_matrix, rtol=1e-6, atol=0)
    torch.testing.assert_close(fit.covariance[:1], alone.covariance, rtol=1e-4, atol=1e-12)
    assert fit.view_rms[1].isfinite().all() and fit.view_rms[0, 0].isnan()
    single = K.geometry.calibrate_camera(X[:2].float(), x[:2].float(), SIZE, weights[:2].float(), num_coefficients=4)
    torch.testing.assert_close(single.camera_matrix.double(), fit.camera_matrix[:2], rtol=2e-3, atol=0)
    few = K.geometry.calibrate_camera(X[:, :, :3], x[:, :, :3], SIZE)
    assert few.camera_matrix.shape == (3, 3, 3) and not few.converged.any()
    none = K.geometry.calibrate_camera(X[:0], x[:0], SIZE)
    assert none.camera_matrix.shape == (0, 3, 3) and none.pose.t.shape == (0, 6, 3)
    unseen = K.geometry.calibrate_camera(X[:, :0], x[:, :0], SIZE)
    assert unseen.camera_matrix[:, 0, 0].isnan().all() and not unseen.converged.any()


def test_errors() -> None:
    X, x = views("brown_conrady", 4)
    with pytest.raises(ValueError, match="calibrate_camera: model must be one of brown_conrady, kannala_brandt"):
        K.geometry.calibrate_camera(X, x, SIZE, model="fisheye")
    with pytest.raises(ValueError, match="num_coefficients of kannala_brandt to be one of 4, got 5"):
        K.geometry.calibrate_camera(X, x, SIZE, model="kannala_brandt", num_coefficients=5)
    with pytest.raises(ValueError, match=r"expected object_points \(B, V, N, 3\) and image_points \(B, V, N, 2\)"):
        K.geometry.calibrate_camera(X[:, 1:], x, SIZE)
