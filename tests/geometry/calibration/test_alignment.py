"""Alignment by Kabsch and Umeyama, and refined PnP, against SciPy, OpenCV and known motions."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.liegroup import Se3, Sim3

F64 = torch.float64


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def test_alignment_is_that_of_scipy(device: torch.device) -> None:
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    x, y, w = randn(5, 12, 3).to(device), randn(5, 12, 3, seed=1).to(device), randn(5, 12, seed=2).abs().to(device)
    w[0, 4:], x[0, 4:] = 0, torch.nan
    motion, valid = K.geometry.kabsch(x, y, w)
    similarity, _ = K.geometry.umeyama(x, y, w)
    assert valid.all()
    for i in range(5):
        a, b, v = (t[i, w[i] > 0].cpu().numpy() for t in (x, y, w))
        ca, cb = ((v[:, None] * p).sum(0) / v.sum() for p in (a, b))
        R = rotation.align_vectors(b - cb, a - ca, weights=v)[0].as_matrix()  # not a reflection, for unrelated points
        scale = (v[:, None] * ((a - ca) @ R.T) * (b - cb)).sum() / (v[:, None] * (a - ca) ** 2).sum()
        for pose, s in ((motion, 1.0), (similarity, scale)):
            if s > 0:
                torch.testing.assert_close(pose.r.matrix()[i].cpu(), torch.from_numpy(R), rtol=1e-7, atol=1e-7)
                torch.testing.assert_close(pose.t[i].cpu(), torch.from_numpy(cb - s * R @ ca), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_alignment_of_few_and_degenerate_points(dtype: torch.dtype, device: torch.device) -> None:
    x = randn(5, 4, 3).to(device, dtype)
    x[1, :, 2] = 0  # coplanar
    x[2] = x[2, :1] * torch.arange(4, device=device)[:, None]  # on one line
    x[3] = x[3, :1]  # one point
    x[4, 1] = torch.nan
    for group, solve in ((Se3, K.geometry.kabsch), (Sim3, K.geometry.umeyama)):
        truth = group.exp(0.8 * randn(5, 7 if group is Sim3 else 6, seed=3)).requires_grad_(False).to(device, dtype)
        pose, valid = solve(x, truth[:, None] * x)
        assert valid.tolist() == [True, True, False, False, False]
        assert pose.matrix()[2:, :3].isnan().any(-1).any(-1).all() and pose.t.dtype == dtype
        tolerance = 1e-9 if dtype is F64 else 1e-4
        torch.testing.assert_close(pose.matrix()[:2], truth.matrix()[:2], rtol=tolerance, atol=tolerance)
        assert solve(x[:0], x[:0])[1].shape == (0,)


@pytest.mark.derivatives
def test_gradients_of_alignment(device: torch.device) -> None:
    x, w = randn(2, 6, 3).to(device), randn(2, 6, seed=2).abs().to(device)
    inputs = tuple(t.requires_grad_() for t in (x.clone(), x + 0.1 * randn(2, 6, 3, seed=1).to(device), w))
    steps = [randn(*t.shape, seed=5 + i).to(device) for i, t in enumerate(inputs)]
    direction = randn(2, 7, seed=9).to(device)

    def solved(*points: Tensor) -> Tensor:
        return (K.geometry.umeyama(*points)[0].log() * direction).sum()

    grads = torch.autograd.grad(solved(*inputs), inputs)
    ahead, behind = (solved(*(t + h * d for t, d in zip(inputs, steps))).detach() for h in (1e-5, -1e-5))
    torch.testing.assert_close(
        sum((g * d).sum() for g, d in zip(grads, steps)), (ahead - behind) / 2e-5, rtol=1e-6, atol=1e-7
    )


def problems(is_planar: bool, count: int = 40) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    X = randn(count, 16, 3) * torch.tensor([1.0, 1.0, 0.0 if is_planar else 1.0])
    turn = Se3.exp(torch.cat([torch.zeros(count, 3, dtype=F64), randn(count, 3, seed=1)], -1)).requires_grad_(False)
    camera = torch.tensor([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]], dtype=F64).expand(count, 3, 3)
    p = (turn[:, None] * X + torch.tensor([0.0, 0.0, 8.0])) @ camera[0].T
    return X, p[..., :2] / p[..., 2:] + randn(count, 16, 2, seed=2), camera, turn.r.matrix()


def angle(a: Tensor, b: Tensor) -> Tensor:
    return torch.rad2deg(2 * torch.arcsin(((a - b).flatten(1).norm(dim=1) / 8**0.5).clamp(max=1)))


@pytest.mark.parametrize("is_planar, points", [(False, 16), (True, 16), (False, 5), (True, 4)])
def test_pnp_is_as_accurate_as_opencv(is_planar: bool, points: int, device: torch.device) -> None:
    cv2 = pytest.importorskip("cv2")
    X, x, camera, truth = problems(is_planar)
    X, x = X[:, :points].contiguous(), x[:, :points].contiguous()
    pose, valid = K.geometry.solve_pnp(X.to(device), x.to(device), camera.to(device))
    assert valid.all()
    theirs = []
    for a, b, k, R in zip(X.numpy(), x.numpy(), camera.numpy(), truth):
        solutions = zip(*cv2.solvePnPGeneric(a, b, k, None, flags=cv2.SOLVEPNP_SQPNP)[1:3])
        refined = [cv2.solvePnPRefineLM(a, b, k, None, r.copy(), t.copy())[0] for r, t in solutions]
        theirs.append(min(angle(torch.from_numpy(cv2.Rodrigues(r)[0])[None], R[None]).item() for r in refined))
    quantiles = torch.tensor([0.5, 0.95], dtype=F64)
    ours = torch.quantile(angle(pose.r.matrix().cpu(), truth), quantiles)
    assert (ours <= 1.01 * torch.quantile(torch.tensor(theirs, dtype=F64), quantiles)).all()


def test_pnp_of_masked_points(device: torch.device) -> None:
    X, x, camera, truth = (t[:3].to(device) for t in problems(False, 3))
    weights = torch.ones_like(x[..., 0])
    weights[0, 10:], x[0, 10:] = 0, torch.nan
    weights[1, 3:] = 0
    pose, valid = K.geometry.solve_pnp(X, x, camera, weights)
    assert valid.tolist() == [True, False, True]
    assert pose.t[1].isnan().all() and (angle(pose.r.matrix(), truth)[[0, 2]] < 3).all()
    alone, _ = K.geometry.solve_pnp(X[:1, :10], x[:1, :10], camera[:1])
    torch.testing.assert_close(pose.t[:1], alone.t, rtol=1e-6, atol=1e-6)
    assert K.geometry.solve_pnp(X.float(), x.float(), camera.float(), weights.float())[1].tolist() == [
        True,
        False,
        True,
    ]
    with pytest.raises(ValueError, match="solve_pnp: expected world_points of at least four points"):
        K.geometry.solve_pnp(X[:, :3], x[:, :3], camera)


@pytest.mark.derivatives
def test_gradients_of_poses(device: torch.device) -> None:
    X, x, camera, _ = (t[:1].to(device) for t in problems(False, 1))
    x.requires_grad_()
    step, direction = randn(*x.shape, seed=5).to(device), torch.arange(1.0, 7.0, dtype=F64, device=device)

    def solved(x: Tensor) -> Tensor:
        return K.geometry.solve_pnp(X, x, camera)[0].log()[0] @ direction

    (grad,) = torch.autograd.grad(solved(x), x)
    difference = (solved(x + 1e-3 * step) - solved(x - 1e-3 * step)) / 2e-3
    torch.testing.assert_close((grad * step).sum(), difference.detach(), rtol=1e-4, atol=1e-6)
