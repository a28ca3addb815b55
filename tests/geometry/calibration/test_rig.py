"""Calibration of rigs against OpenCV's stereoCalibrate, its gradients, and cameras that others link."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.calibration._lenses import projected
from kvision.geometry.calibration.rig import _RigError
from kvision.geometry.liegroup import Se3

F64 = torch.float64
SIZE = (480, 640)
LENSES = {"brown_conrady": [-0.25, 0.08, 0.001, -0.0005, 0.01], "kannala_brandt": [0.02, -0.01, 0.003, -0.001]}
CAMERAS = [[600.0, 610, 322, 236], [590, 595, 315, 244], [605, 600, 318, 240]]
RIG = [[0.0, 0, 0, 0, 0, 0], [-0.12, 0.003, 0.01, 0.02, 0.1, -0.01], [-0.2, 0.05, 0.02, -0.05, 0.15, 0.03]]


def views(model: str = "brown_conrady", cameras: int = 2, count: int = 8, noise: float = 0.2) -> tuple[Tensor, Tensor]:
    """Points of a 7 x 6 board (1, V, 42, 3) and their noisy pixels in each camera."""
    generator = torch.Generator().manual_seed(0)
    board = torch.cartesian_prod(torch.arange(7.0), torch.arange(6.0)).to(F64) - torch.tensor([3.0, 2.5])
    board = torch.cat([0.04 * board, torch.zeros(42, 1, dtype=F64)], -1).expand(1, count, 42, 3)
    u = 2 * torch.rand(2, 1, count, 3, generator=generator, dtype=F64) - 1
    turn = Se3.exp(torch.cat([torch.zeros_like(u[0]), 0.5 * u[0]], -1))
    p = (turn[:, :, None] * board).detach() + 0.08 * u[1, :, :, None] + torch.tensor([0.04, 0.0, 0.6])
    seen = []
    for motion, camera in zip(torch.tensor(RIG, dtype=F64)[:cameras], torch.tensor(CAMERAS, dtype=F64)):
        q = (Se3.exp(motion[None]) * p.reshape(1, -1, 3)).detach()
        image = projected(model, q, torch.tensor([LENSES[model]], dtype=F64))
        seen.append((camera[:2] * image + camera[2:]).reshape(1, count, 42, 2))
    pixels = torch.stack(seen, 1)
    return board, pixels + noise * torch.randn(pixels.shape, generator=generator, dtype=F64)


@pytest.mark.parametrize(
    ("model", "is_known"),
    [
        pytest.param("brown_conrady", False, marks=pytest.mark.slow),
        ("brown_conrady", True),
        pytest.param("kannala_brandt", False, marks=pytest.mark.slow),
    ],
)
def test_as_accurate_as_opencv(model: str, is_known: bool, device: torch.device) -> None:
    cv2 = pytest.importorskip("cv2")
    X, x = views(model)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    flags = cv2.CALIB_FIX_INTRINSIC if is_known else cv2.CALIB_USE_INTRINSIC_GUESS
    boards, corners = [v.numpy() for v in X[0]], [[v.numpy() for v in t] for t in x[0]]
    if model == "kannala_brandt":
        boards, corners = [v[None] for v in boards], [[v[None] for v in t] for t in corners]
        again, no_skew = getattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC", 2), getattr(cv2, "CALIB_FIX_SKEW", 8)  # OpenCV 5
        flags, calibrate, calibrate_pair = flags | no_skew, cv2.fisheye.calibrate, cv2.fisheye.stereoCalibrate
        options = {"flags": again | no_skew, "criteria": criteria}
        start = np.zeros((3, 3)), np.zeros((4, 1))
    else:
        boards, corners = [v.astype(np.float32) for v in boards], [[v.astype(np.float32) for v in t] for t in corners]
        calibrate, calibrate_pair, options, start = cv2.calibrateCamera, cv2.stereoCalibrate, {}, (None, None)
    lenses = [calibrate(boards, c, SIZE[::-1], *start, **options)[1:3] for c in corners]
    given = {}
    if is_known:
        given["camera_matrix"] = torch.stack([torch.from_numpy(k) for k, _ in lenses])[None].to(device)
        given["dist"] = torch.stack([torch.from_numpy(d).flatten() for _, d in lenses])[None].to(device)
    rms, K1, _, K2, _, R, t, *_ = calibrate_pair(
        boards, *corners, *(v.copy() for lens in lenses for v in lens), SIZE[::-1], flags=flags, criteria=criteria
    )
    ours = K.geometry.calibrate_rig(X.to(device), x.to(device), SIZE, model=model, **given)
    assert abs(ours.rms.item() - rms) < 1e-4 and ours.converged.all()
    assert (ours.rig.t.cpu()[0, 1] - torch.from_numpy(t.reshape(3))).abs().max() < 1e-4
    assert (ours.rig.r.matrix().cpu()[0, 1] - torch.from_numpy(R)).abs().max() < 1e-4
    assert (ours.camera_matrix.cpu()[0] - torch.from_numpy(np.stack([K1, K2]))).abs().max() < 0.2
    deviation = ours.covariance[0].diagonal().sqrt().cpu()
    assert deviation.shape == ((6,) if is_known else (14 + 2 * len(LENSES[model]),))
    if not is_known:
        truth = torch.tensor(CAMERAS, dtype=F64)[:2].flatten()
        found = ours.camera_matrix.cpu()[0, :, [0, 1, 0, 1], [0, 1, 2, 2]].flatten()
        assert ((found - truth).abs() < 4 * deviation[:8]).all()
    assert (ours.view_rms.square().mean().sqrt() - ours.rms).abs() < 1e-9


def test_cameras_are_linked_by_others(device: torch.device) -> None:
    """Three fisheye cameras, of which the first and the last share no view; one that shares none has no solution."""
    X, x = (t.to(device) for t in views("kannala_brandt", 3, noise=0.0))
    weights = torch.ones(2, 3, 8, 42, dtype=F64, device=device)
    weights[0, 0, 4:] = weights[0, 2, :4] = 0
    weights[1, 0, 4:] = weights[1, 1, :4] = weights[1, 2, :4] = 0
    x = x.expand(2, -1, -1, -1, -1).clone()
    x[weights == 0] = torch.nan
    fit = K.geometry.calibrate_rig(X.expand(2, -1, -1, -1), x, SIZE, weights, "kannala_brandt")
    assert fit.converged.tolist() == [True, False] and fit.rms[0] < 1e-6
    assert (fit.rig[0].log().cpu() - torch.tensor(RIG, dtype=F64)).abs().max() < 1e-5
    assert fit.view_rms[0].isnan().sum() == 8 and fit.rig.t[1].isnan().all()


def test_jacobians(device: torch.device) -> None:
    X, x = (t.to(device) for t in views(count=4))
    order = torch.arange(2, device=device).repeat_interleave(4)
    pixels, boards = x.flatten(1, 2), X[:, torch.arange(4).repeat(2)]
    error = _RigError("brown_conrady", boards, pixels, torch.ones_like(pixels[..., 0]), order == 0, {})
    variables = {
        "camera": torch.tensor([CAMERAS[:2]], dtype=F64, device=device)[:, order],
        "dist": torch.tensor([LENSES["brown_conrady"]], dtype=F64, device=device)[:, None].expand(1, 8, 5),
        "rig": Se3.exp(torch.tensor([RIG[1]] * 8, dtype=F64, device=device)[None]).requires_grad_(False),
        "pose": Se3.exp(torch.tensor([[0.1, 0, 0.6, 0.1, -0.1, 0.2]] * 8, dtype=F64, device=device)[None]).requires_grad_(False),
    }  # fmt: skip
    r, J = error.with_jacobian(variables)
    torch.testing.assert_close(r, error(variables))
    for name, step in (("rig", 6), ("pose", 6), ("camera", 4), ("dist", 5)):
        d = torch.randn(1, 8, step, generator=torch.Generator().manual_seed(1), dtype=F64).to(device)

        def moved(scale: float, name: str = name, d: Tensor = d) -> Tensor:
            old = variables[name]
            new = old + scale * d if isinstance(old, Tensor) else Se3.exp(scale * d) * old
            return error({**variables, name: new}).detach()

        difference = (moved(1e-6) - moved(-1e-6)) / 2e-6
        torch.testing.assert_close((J[name] @ d[..., None])[..., 0], difference, rtol=1e-5, atol=1e-5)


@pytest.mark.derivatives
def test_gradients(device: torch.device) -> None:
    X, x = (t.to(device) for t in views(count=4))
    shift = torch.randn(x.shape, generator=torch.Generator().manual_seed(2), dtype=F64).to(device)
    known = {
        "camera_matrix": K.geometry._intrinsics.camera_matrix_of(
            *torch.tensor([CAMERAS[:2]], dtype=F64, device=device).unbind(-1)
        ),
        "dist": torch.tensor([[LENSES["brown_conrady"]] * 2], dtype=F64, device=device),
    }

    def baseline(x: Tensor) -> Tensor:
        return K.geometry.calibrate_rig(X, x, SIZE, **known).rig.t[0, 1].sum()

    (grad,) = torch.autograd.grad(baseline(x.requires_grad_()), x)
    with torch.no_grad():
        difference = (baseline(x + 1e-3 * shift) - baseline(x - 1e-3 * shift)) / 2e-3
    torch.testing.assert_close((grad * shift).sum(), difference, rtol=1e-4, atol=1e-8)


def test_errors() -> None:
    X, x = views()
    with pytest.raises(ValueError, match=r"calibrate_rig: expected object_points \(B, V, N, 3\) and image_points"):
        K.geometry.calibrate_rig(X[:, 1:], x, SIZE)
    with pytest.raises((TypeError, ValueError), match="calibrate_rig: expected dist"):
        K.geometry.calibrate_rig(X, x, SIZE, camera_matrix=torch.eye(3).expand(1, 2, 3, 3))
