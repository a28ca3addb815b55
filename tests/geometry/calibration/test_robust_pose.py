"""Poses of three points, and robust poses and alignments, against OpenCV and known motions."""

from __future__ import annotations

import cv2
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.liegroup import Se3, Sim3, So3
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests

F64 = torch.float64
CAMERA = torch.tensor([[800.0, 0, 320], [0, 820, 240], [0, 0, 1]], dtype=F64)


def seen(B: int, N: int, wrong: int = 0, noise: float = 0.0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Points, their pixels, of which the first are wrong, cameras and poses [R | t]."""
    generator = torch.Generator().manual_seed(0)
    rand, randn = (lambda *s, f=f: f(s, generator=generator, dtype=F64) for f in (torch.rand, torch.randn))
    X, t = 4 * rand(B, N, 3) - 2, 2 * rand(B, 3) - 1 + torch.tensor([0, 0, 6])
    R = So3.exp(randn(B, 3)).matrix().detach()
    h = (X @ R.mT + t[:, None]) @ CAMERA.T
    x = h[..., :2] / h[..., 2:] + noise * randn(B, N, 2)
    x[:, :wrong] = rand(B, wrong, 2) * torch.tensor([640.0, 480.0])
    return X, x, CAMERA.expand(B, 3, 3), torch.cat([R, t[..., None]], -1)


_SEEN = seen(1, 9)
_SAMPLES = torch.stack([torch.randperm(9, generator=torch.Generator().manual_seed(i))[:4] for i in range(6)])
_SAMPLED = (*(x[0] for x in _SEEN[:3]), _SAMPLES)


def degrees(R1: Tensor, R2: Tensor) -> Tensor:
    return torch.rad2deg(torch.acos((((R1 @ R2.mT).diagonal(dim1=1, dim2=2).sum(1) - 1) / 2).clamp(-1, 1)))


def test_poses_of_three_points_are_those_of_opencv(device: torch.device) -> None:
    X, x, camera, truth = seen(200, 3)
    poses = K.geometry.solve_p3p(X.to(device), x.to(device), camera.to(device)).cpu()
    assert ((poses - truth[:, None]).abs().amax((2, 3)).nan_to_num(torch.inf).amin(1) < 1e-8).all()
    h = (X[:, None] @ poses[..., :3].mT + poses[..., None, :, 3]) @ CAMERA.T
    found = poses[..., 0, 0].isfinite()
    assert (h[found][..., 2] > 0).all() and ((h[..., :2] / h[..., 2:] - x[:, None])[found].abs() < 1e-4).all()
    counts = [
        cv2.solveP3P(X[i].numpy(), x[i].numpy(), CAMERA.numpy(), None, flags=cv2.SOLVEPNP_P3P)[0] for i in range(200)
    ]
    assert (found.sum(1) >= torch.tensor(counts)).float().mean() > 0.98


class TestSamplePoses(PointOpTests):
    calls = {
        "sample_poses": [
            Call(
                tuple(lambda i=i: _SAMPLED[i] for i in range(4)),
                broadcasts=False,
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=("another dtype", "samples of torch.int64", "samples cut along axis -2"),
                tolerance=500,
            )
        ]
    }


_POSES = torch.cat([_SEEN[3][0], torch.full((1, 4), 0.0, dtype=F64)]).expand(5, 4, 4)[:, :3]
_HYPOTHESES = _POSES + 0.01 * torch.arange(5, 0, -1, dtype=F64)[:, None, None] * torch.ones(3, 4, dtype=F64)
_MASK = torch.arange(9) != 4


class TestRobustPoses(PointOpTests):
    calls = {
        "robust_poses": [
            Call(
                (lambda: _HYPOTHESES, *(lambda i=i: _SAMPLED[i] for i in range(3)), mask),
                (6.0, 18.0, 4, 3, 1e-8),
                broadcasts=False,
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=("another dtype", "mask of torch.bool", "rounds", "steps", "hypotheses cut along axis -3"),
                tolerance=500,
            )
            for mask in (None, lambda: _MASK)
        ]
    }

    def test_vmap(self, name: str, call: Call, device: torch.device, backend: str) -> None:
        if backend == "reference":
            pytest.skip("on the CPU the reference ends when no score rises, which it reads")
        super().test_vmap(name, call, device)


def test_a_triangle_without_area_has_no_pose_and_a_pose_has_gradients(device: torch.device) -> None:
    X, x, camera, _ = (v.to(device) for v in seen(3, 3))
    X[1, 2] = X[1, 0] + 0.3 * (X[1, 1] - X[1, 0])
    poses = K.geometry.solve_p3p(X, x, camera)
    assert poses[1].isnan().all() and K.geometry.solve_p3p(X[:0], x[:0], camera[:0]).shape == (0, 4, 3, 4)
    found = poses[0, :, 0, 0].isfinite().nonzero()[0, 0]
    torch.autograd.gradcheck(
        lambda p, q: K.geometry.solve_p3p(p, q, camera[:1])[0, found], (X[:1].requires_grad_(), x[:1].requires_grad_())
    )


def test_robust_poses_are_as_near_as_opencvs(device: torch.device) -> None:
    X, x, camera, truth = seen(24, 60, wrong=24, noise=1.0)
    pose, valid, inliers = K.geometry.solve_pnp_ransac(
        X.to(device), x.to(device), camera.to(device), inl_th=4.0, max_samples=128, seed=0
    )
    assert valid.all() and (inliers.sum(1) >= 34).all() and (inliers[:, :24].sum(1) <= 3).all()
    errors = []
    for i in range(24):
        cv2.setRNGSeed(i)
        _, r, t, kept = cv2.solvePnPRansac(
            X[i].numpy(),
            x[i].numpy(),
            CAMERA.numpy(),
            None,
            None,
            None,
            False,
            1000,
            4.0,
            0.9999,
            None,
            cv2.SOLVEPNP_SQPNP,
        )
        r, _ = cv2.solvePnPRefineLM(X[i].numpy()[kept[:, 0]], x[i].numpy()[kept[:, 0]], CAMERA.numpy(), None, r, t)
        errors.append(torch.from_numpy(cv2.Rodrigues(r)[0]))
    own, peer = degrees(pose.r.matrix().detach().cpu(), truth[..., :3]), degrees(torch.stack(errors), truth[..., :3])
    assert own.median() <= 1.02 * peer.median() and own.max() < 0.3


def test_masks_and_problems_without_a_solution(device: torch.device) -> None:
    X, x, camera, truth = (v.to(device) for v in seen(4, 30, wrong=20))
    mask = torch.ones(4, 30, dtype=torch.bool, device=device)
    mask[0, :20], mask[1] = False, False  # all that is left is right; nothing is left
    pose, valid, inliers = K.geometry.solve_pnp_ransac(X, x, camera, mask, inl_th=0.5, max_samples=8, seed=1)
    assert valid[:2].tolist() == [True, False] and inliers[0].tolist() == [False] * 20 + [True] * 10
    assert degrees(pose.r.matrix().detach()[:1], truth[:1, :, :3]) < 1e-5
    assert pose.t[1].isnan().all() and not inliers[~valid].any() and not (inliers & ~mask).any()
    x.requires_grad_()
    pose = K.geometry.solve_pnp_ransac(X, x, camera, mask, seed=1)[0]
    pose.t[0].sum().backward()
    assert (x.grad[0, 20:] != 0).all() and (x.grad[0, :20] == 0).all() and (x.grad[1:] == 0).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64], ids=str)
@pytest.mark.parametrize("name", ["kabsch_ransac", "umeyama_ransac"])
def test_robust_alignment_is_that_of_the_inliers(name: str, dtype: torch.dtype, device: torch.device) -> None:
    generator = torch.Generator().manual_seed(2)
    x = torch.randn(6, 40, 3, generator=generator, dtype=F64).to(device)
    motion = (
        So3.exp(torch.randn(6, 3, generator=generator, dtype=F64).to(device)),
        torch.randn(6, 3, generator=generator, dtype=F64).to(device),
    )
    pose = Se3(*motion) if name[0] == "k" else Sim3(*motion, torch.full((6,), 1.7, dtype=F64, device=device))
    y = (pose[:, None] * x).detach()
    y[:, :20] = 5 * torch.randn(6, 20, 3, generator=generator, dtype=F64).to(device)
    x, y = x.to(dtype), y.to(dtype)
    found, valid, inliers = getattr(K.geometry, name)(x, y, inl_th=0.02, seed=0)
    assert valid.all() and inliers[:, 20:].all() and not inliers[:, :20].any()
    torch.testing.assert_close(found.matrix().double(), pose.matrix(), rtol=3e-6, atol=3e-6)
    _, valid, inliers = getattr(K.geometry, name)(x.expand(1, -1, -1, -1)[0] * 0, y, seed=0)
    assert not valid.any() and not inliers.any()
    _, valid, inliers = getattr(K.geometry, name)(x[:0], y[:0], seed=0)
    assert valid.shape == (0,) and inliers.shape == (0, 40)


@pytest.mark.parametrize("dtype", [torch.float32, F64], ids=str)
@pytest.mark.parametrize("offset", [0.0, 20.0])
def test_points_on_one_line_have_no_pose(dtype: torch.dtype, offset: float, device: torch.device) -> None:
    """The camera may turn about the line. In float32 rounding moves points off it; points in a narrow strip have their pose."""
    along = torch.tensor([1.0, 0.5, 0.3], dtype=F64) * torch.linspace(-1, 1, 30, dtype=F64)[:, None]
    strip = along + 0.05 * torch.tensor([0.0, 1.0, -1.0]) * (torch.arange(30) % 3)[:, None]
    points = torch.stack([along, strip]) + offset
    pose = Se3.exp(torch.tensor([[0.1, -0.2, 5, 0.2, 0.3, -0.1]], dtype=F64)).requires_grad_(False)
    h = (pose[:, None] * (points - offset)) @ CAMERA.mT
    problem = (
        points.to(device, dtype),
        (h[..., :2] / h[..., 2:]).to(device, dtype),
        CAMERA.expand(2, 3, 3).to(device, dtype),
    )
    for found, valid, *inliers in (K.geometry.solve_pnp(*problem), K.geometry.solve_pnp_ransac(*problem, seed=0)):
        assert valid.tolist() == [False, True] and found.t[0].isnan().all()
        assert degrees(found.r.matrix().detach().cpu().double()[1:], pose.r.matrix()).max() < 1
        assert all(i.sum(1).tolist() == [0, 30] for i in inliers)
    none = [p[:0] for p in problem]
    assert K.geometry.solve_pnp(*none)[1].shape == K.geometry.solve_pnp_ransac(*none)[1].shape == (0,)


X, x, C = torch.rand(1, 4, 3), torch.rand(1, 4, 2), torch.eye(3)[None]
BAD = [
    (lambda: K.geometry.solve_p3p(X, x, C), "solve_p3p: expected world_points"),
    (lambda: K.geometry.solve_pnp_ransac(X[:, :3], x[:, :3], C), "expected world_points of at least four"),
    (lambda: K.geometry.kabsch_ransac(X, X, inl_th=0.0), "kabsch_ransac: expected inl_th above 0"),
    (lambda: K.geometry.umeyama_ransac(X[:, :2], X[:, :2]), "umeyama_ransac: expected points1 of at least three"),
]


@pytest.mark.parametrize("call, message", BAD, ids=range(len(BAD)))
def test_errors(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
    with pytest.raises(TypeError, match="expected mask of bool"):
        K.geometry.kabsch_ransac(X, X, torch.ones(1, 4))
