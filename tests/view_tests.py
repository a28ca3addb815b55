"""Functions of several views: CompositionTests without library solvers, and scenes and correspondences in float64."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

import kvision as K
from composition_tests import Case, CompositionTests, on
from op_tests import assert_close

CAMERA = torch.tensor([[80.0, 0, 50], [0, 85, 40], [0, 0, 1]]).double()
LENS = torch.tensor([0.1, -0.05, 0.01, 0.02, 0.03, 0.02, 0.01, 0.005, 0.01, 0.02, -0.01, 0.03, 0.05, -0.04]).double()


def rand(*shape: int, low: float = 0.0, high: float = 1.0, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * (high - low) + low


def rotation(*angles: float) -> Tensor:
    """A rotation matrix (3, 3) from an axis-angle vector."""
    return torch.linalg.matrix_exp(K.geometry.cross_product_matrix(torch.tensor(angles).double()))


def homographies(batch: int, seed: int = 1) -> Tensor:
    noise = rand(batch, 3, 3, low=-1, seed=seed)
    return torch.eye(3).double() + noise * torch.tensor([[0.2, 0.2, 15], [0.2, 0.2, 15], [1e-3, 1e-3, 0]]).double()


def moved(points: Tensor, H: Tensor) -> Tensor:
    p = points @ H[..., :2].mT + H[..., None, :, 2]
    return p[..., :2] / p[..., 2:]


def on_planes(batch: int, count: int, noise: float = 0.0, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Points of two images of planes (B, N, 2), and the homographies between them."""
    points, H = rand(batch, count, 2, high=100, seed=seed), homographies(batch)
    return points, moved(points, H) + noise * rand(batch, count, 2, low=-1, seed=seed + 1), H


class Scene:
    """Points (B, N, 3) in front of two cameras, and their projections in both images (B, N, 2)."""

    def __init__(self, batch: int, count: int, noise: float = 0.0, seed: int = 0) -> None:
        self.points = rand(batch, count, 3, seed=seed) * torch.tensor([4.0, 3.0, 4.0]) + torch.tensor([-2.0, -1.5, 4.0])
        self.R, self.t = rotation(0.1, -0.2, 0.05), torch.tensor([[1.0], [0.1], [0.2]]).double()
        self.P1 = K.geometry.projection_from_KRt(CAMERA, torch.eye(3).double(), torch.zeros(3, 1).double())
        self.P2 = K.geometry.projection_from_KRt(CAMERA, self.R, self.t)
        eye, zero = torch.eye(3).double(), torch.zeros(3, 1).double()
        self.E = K.geometry.essential_from_Rt(eye, zero, self.R, self.t)
        self.F = K.geometry.fundamental_from_essential(self.E, CAMERA, CAMERA)
        shift = noise * rand(2, batch, count, 2, low=-1, seed=seed + 1)
        self.x1, self.x2 = (moved_by(P, self.points) + s for P, s in zip((self.P1, self.P2), shift))

    def normalized(self) -> tuple[Tensor, Tensor]:
        """The points of both images in normalized camera coordinates."""
        inverse = torch.linalg.inv(CAMERA)
        return moved(self.x1, inverse), moved(self.x2, inverse)


def moved_by(P: Tensor, points: Tensor) -> Tensor:
    p = points @ P[:, :3].T + P[:, 3]
    return p[..., :2] / p[..., 2:]


def points(x: Tensor, base: Tensor) -> Tensor:
    return on(x.device, base).to(x.dtype) + 3 * x


def rays(x: Tensor, seen: Tensor) -> Tensor:
    """As many of them as x has, seen by the camera, and some of x."""
    return on(x.device, seen).to(x.dtype)[:, : x.shape[1]] + 0.3 * x


def camera(x: Tensor) -> Tensor:
    return on(x.device, CAMERA).to(x.dtype).expand(x.shape[0], 3, 3)


class NoSolvers(TorchDispatchMode):
    """Raise an error for calls of linear algebra libraries, which wait for a GPU and prevent graph capture."""

    def __torch_dispatch__(self, call, types, args=(), kwargs=None):
        name = call.name().removeprefix("aten::").lstrip("_")
        elementwise = name.startswith(("linalg_vector_norm", "linalg_cross"))
        assert elementwise or not name.startswith(("linalg_", "lu_", "cholesky", "triangular_solve", "ormqr")), name
        return call(*args, **(kwargs or {}))


class ViewTests(CompositionTests):
    def test_autocast_changes_nothing(self, case, device):
        values = self.values(case, device, torch.float32)
        expected = case.call(*values)
        with torch.autocast(device.type, dtype=torch.bfloat16):
            assert_close(case.call(*values), expected, 1e-5, 1e-5)

    def derivatives(self, case: Case, values: list[Tensor]) -> list[Tensor]:
        """The result, its gradients, and the gradients of a norm of the gradients."""
        leaves = [v.detach().requires_grad_() for v in values]
        output = case.call(*leaves)
        first = torch.autograd.grad(output.nan_to_num(0.0).square().sum(), leaves, create_graph=True, allow_unused=True)
        total = sum(g.square().sum() for g in first if g is not None)
        second = torch.autograd.grad(total, leaves, allow_unused=True)
        return [x.detach() for x in (output, *first, *second) if x is not None]

    def test_no_solver_is_called(self, case, device, backend):
        if backend == "reference":
            pytest.skip("the reference may")
        with NoSolvers():
            self.derivatives(case, self.values(case, device))

    @pytest.mark.gpu
    def test_cuda_graph_of_derivatives(self, case, device):
        values = self.values(case, device)
        with torch.cuda.stream(torch.cuda.Stream()):
            self.derivatives(case, values)
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            captured = self.derivatives(case, values)
        for v, new in zip(values, self.values(case, device)):
            v.copy_(new)
        graph.replay()
        for result, expected in zip(captured, self.derivatives(case, values)):
            assert_close(result, expected, 1e-6, 1e-6)


def finite_gradients(function, *args: Tensor) -> Tensor:
    """Return the result of a call and check that all its gradients are finite."""
    leaves = [a.clone().requires_grad_() for a in args]
    output = function(*leaves)
    safe = torch.where(output.detach().isfinite() & (output.detach().abs() < 1e30), output, 0)
    grads = torch.autograd.grad(safe.square().sum(), leaves, allow_unused=True)
    assert all(g is None or g.isfinite().all() for g in grads)
    return output.detach()


def assert_values_of_kornia(
    home: str, name: str, args: Sequence[Any], kwargs: dict[str, Any], device: torch.device
) -> None:
    """Function `name` of kvision.geometry.`home` gives what Kornia's gives, and has the same name in kvision.geometry."""
    ours = getattr(getattr(K.geometry, home), name)
    theirs = getattr(getattr(pytest.importorskip("kornia").geometry, home), name)
    assert getattr(K.geometry, name, None) in (ours, None)
    moved = [a.to(device) if isinstance(a, Tensor) else a for a in args]
    kwargs_moved = {k: v.to(device) if isinstance(v, Tensor) else v for k, v in kwargs.items()}
    results, expected = ours(*moved, **kwargs_moved), theirs(*args, **kwargs)
    for a, e in zip(*((y if isinstance(y, tuple) else (y,)) for y in (results, expected)), strict=True):
        a, e = a.cpu(), e[0] if e.shape != a.shape and e.shape[0] == 1 else e
        largest = e.double().nan_to_num(0, 0, 0).abs().amax()
        assert_close(a, e.to(a.dtype), 1e-7, 1e-7 * max(1.0, float(largest)))
