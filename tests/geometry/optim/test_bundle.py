"""Bundles by the kernel of the built-in residual, against the iterations of any residual."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from kvision import _modes
from kvision.geometry.liegroup import Se3
from kvision.geometry.optim import ReprojectionError, least_squares
from kvision.geometry.optim._losses import LOSSES
from kvision.geometry.optim.group_products import by_key, offsets_of
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector

F64 = torch.float64
CAMERA = torch.tensor([[300.0, 2.0, 200.0], [0.0, 310.0, 150.0], [0.0, 0.0, 1.0]], dtype=F64)
OPTIONS = (2.0, 6, 1e-8, 1e-8, 1e-8)


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def bundle(batch: int, views: int, points: int, noise: float = 0.5) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Poses (B, C, 7) and points near those that pixels come from, and what most cameras see, in no order."""
    truth = Se3.exp(0.2 * randn(batch, views, 6, seed=1)).requires_grad_(False)
    X = randn(batch, points, 3, seed=2) + torch.tensor([0.0, 0.0, 8.0])
    every = torch.cartesian_prod(torch.arange(views), torch.arange(points))
    order = torch.randperm(len(every), generator=torch.Generator().manual_seed(3))
    camera, point = every[order[: len(order) * 6 // 7]].unbind(-1)
    h = (truth[:, camera] * X[:, point]) @ CAMERA.T
    pixels = h[..., :2] / h[..., 2:] + noise * randn(*h.shape[:2], 2, seed=4)
    start = (Se3.exp(0.02 * randn(batch, views, 6, seed=5)) * truth).requires_grad_(False)
    poses = torch.cat([start.quaternion.data, start.t], -1).detach()
    return poses, X + 0.02 * randn(*X.shape, seed=6), pixels, camera, point


def sorted_bundle() -> tuple[Tensor, ...]:
    """One bundle as the operator takes it, the rows of samples first."""
    poses, X, pixels, camera, point = bundle(1, 3, 6)
    order, _ = by_key(3 * point + camera, 18)
    of_point = offsets_of(point[order], 6)
    by_camera, of_camera = by_key(camera[order], 3)
    indices = (camera[order], point[order], by_camera, of_camera, of_point)
    return poses[0], X[0], pixels[0, order], *(i.int()[None] for i in indices)


POSES, POINTS, PIXELS, *INDICES = sorted_bundle()


class TestFitBundle(PointOpTests):
    """Counts of iterations differ by rounding where a tolerance is nearly reached."""

    calls = {
        "fit_bundle": [
            Call(
                (lambda: POSES, near(POINTS, 0.02), near(PIXELS, 0.5), lambda: CAMERA, *INDICES, weights),
                (_modes.ROBUST_LOSS[loss], *OPTIONS),
                broadcasts=False,
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=("another dtype", "max_iterations 0", "max_iterations 32768", "loss 0"),
                tolerance=2000,
                compared=lambda poses, points, cost, *rest: (poses, points, cost),
            )
            for loss, weights in (("linear", None), ("cauchy", vector(len(PIXELS))))
        ]
    }

    def test_compile(self, device: torch.device, backend: str) -> None:
        if backend == "reference":
            pytest.skip("the number of pairs of observations, over which the reference sums, depends on values")
        super().test_compile(device, backend)


def test_modes_are_the_losses() -> None:
    assert tuple(_modes.ROBUST_LOSS) == tuple(LOSSES)


def solved(error: Any, data: tuple[Tensor, ...], **options: Any) -> Any:
    poses, X, _, camera, point = data
    start = {"pose": Se3.from_qxyz(poses).requires_grad_(False), "points": X}
    index = {"pose": camera, "points": point}
    return least_squares(error, start, index=index, eliminate="points", gradient="none", **options)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("dtype", SINGLE_AND_DOUBLE)
def test_the_kernel_iterates_as_the_solver(loss: Any, dtype: torch.dtype, device: torch.device) -> None:
    """Weights of 0 and without any, a pixel that is NaN, points and cameras that nothing sees, points seen several times."""
    poses, X, pixels, camera, point = bundle(5, 7, 40)
    again = torch.arange(0, len(camera), 3).repeat(3)
    pixels = torch.cat([pixels, pixels[:, again] + randn(5, len(again), 2, seed=8)], 1)
    camera, point = torch.cat([camera, camera[again]]), torch.cat([point, point[again]])
    weights = randn(5, len(camera), seed=7).abs() + 0.1
    weights[0, :5], weights[1], weights[3, camera == 2] = 0, 0, 0
    weights[3, point == 4] = 0
    pixels[0, :5], pixels[2, 3] = torch.nan, torch.nan
    data = tuple(
        x.to(device, dtype) if x.is_floating_point() else x.to(device) for x in (poses, X, pixels, camera, point)
    )
    error, weights = ReprojectionError(data[2], CAMERA.to(device, dtype)), weights.to(device, dtype)
    options = {"weights": weights, "max_iterations": 4, "loss": loss, "f_scale": 3.0}
    kernel = solved(error, data, **options)
    solver = solved(lambda v: error(v), data, jacobian=lambda v: error.with_jacobian(v), **options)
    assert kernel.converged.tolist() == solver.converged.tolist() and kernel.cost[2].isnan()
    assert kernel.iterations[1] == 0 and kernel.variables["points"][2].isnan().all()
    determined = torch.tensor([0, 1, 3, 4], device=device)
    tolerance = 1e-7 if dtype is F64 else 1e-2  # of points that few rays determine
    for a, b in ((kernel.variables["points"], solver.variables["points"]), (kernel.cost, solver.cost)):
        torch.testing.assert_close(a[determined], b[determined], rtol=tolerance, atol=tolerance)
    a, b = (fit.variables["pose"].matrix()[determined] for fit in (kernel, solver))
    torch.testing.assert_close(a, b, rtol=tolerance, atol=tolerance)


def test_runs_of_many_cameras_give_the_same_bits(device: torch.device) -> None:
    """More tiles of the Schur complement than one, and steps of which some fail."""
    data = tuple(x.to(device) for x in bundle(2, 21, 60, noise=20.0))
    error = ReprojectionError(data[2], CAMERA.to(device))
    first, second = (solved(error, data, max_iterations=12) for _ in range(2))
    solver = solved(lambda v: error(v), data, jacobian=lambda v: error.with_jacobian(v), max_iterations=12)
    torch.testing.assert_close(first.cost, solver.cost, rtol=1e-8, atol=0)
    assert torch.equal(first.variables["points"], second.variables["points"])
    assert torch.equal(first.variables["pose"].t, second.variables["pose"].t)


def test_indices_out_of_range(device: torch.device) -> None:
    data = tuple(x.to(device) for x in bundle(1, 3, 6))
    error = ReprojectionError(data[2], CAMERA.to(device))
    for index, wrong in ((3, 3), (3, -1), (4, 6)):
        broken = list(data)
        broken[index] = torch.cat([data[index][:-1], data[index].new_tensor([wrong])])
        if device.type == "cpu":
            with pytest.raises(ValueError, match=r"least_squares: expected index\['\w+'\] from 0 to \d"):
                solved(error, tuple(broken))
        else:
            assert solved(error, tuple(broken)).cost.isnan().all()


def test_bundles_do_not_wait_for_the_device(device: torch.device) -> None:
    if device.type != "cuda":
        pytest.skip("needs a GPU")
    data = tuple(x.to(device) for x in bundle(1, 7, 40))
    error = ReprojectionError(data[2], CAMERA.to(device))
    solved(error, data, max_iterations=1)
    torch.cuda.set_sync_debug_mode("error")
    try:
        solved(error, data, max_iterations=3)
    finally:
        torch.cuda.set_sync_debug_mode("default")
