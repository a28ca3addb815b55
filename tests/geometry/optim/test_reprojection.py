"""Poses by the kernel of the built-in residual, against the iterations of any residual."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from kvision.geometry.liegroup import Se3
from kvision.geometry.optim import ReprojectionError, least_squares
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector

CAMERA = torch.tensor([[300.0, 2.0, 200.0], [0.0, 310.0, 150.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
POINTS = torch.randn(8, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
START = torch.tensor([1.0, 0.02, -0.01, 0.03, 0.1, -0.1, 6.0], dtype=torch.float64)
START[:4] /= START[:4].norm()
H = (POINTS + torch.tensor([0.0, 0.0, 6.2])) @ CAMERA.T
PIXELS = H[:, :2] / H[:, 2:]
OPTIONS = (12, 1e-8, 1e-8, 1e-8)


class TestFitPoses(PointOpTests):
    """Counts of iterations differ by rounding where a tolerance is nearly reached."""

    calls = {
        "fit_poses": [
            Call(
                (lambda: START, near(POINTS, 0.02), near(PIXELS, 0.5), lambda: CAMERA, weights),
                OPTIONS,
                broadcasts=False,
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=("another dtype", "max_iterations 0", "max_iterations 32768"),
                tolerance=500,
                compared=lambda pose, cost, *rest: (pose, cost),
            )
            for weights in (None, vector(8))
        ]
    }


@pytest.mark.parametrize("dtype", SINGLE_AND_DOUBLE)
def test_the_kernel_iterates_as_the_solver(dtype: torch.dtype, device: torch.device) -> None:
    """Weights of 0 and without any, points that are NaN, too few points and a start at the solution."""
    generator = torch.Generator().manual_seed(1)

    def randn(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator, dtype=torch.float64).to(device, dtype)

    truth = Se3.exp(0.3 * randn(6, 6)).requires_grad_(False)
    X, K = randn(6, 20, 3), CAMERA.to(device, dtype)
    h = (truth[:, None] * X + torch.tensor([0, 0, 7.0], device=device, dtype=dtype)) @ K.T
    pixels = h[..., :2] / h[..., 2:] + randn(6, 20, 2)
    weights = randn(6, 20).abs() + 0.1
    weights[0, :5], weights[1], weights[3, 2:] = 0, 0, 0
    pixels[0, :5], pixels[2, 3] = torch.nan, torch.nan
    offset = torch.tensor([0, 0, 7.0, 0, 0, 0], device=device, dtype=dtype)
    start = {"pose": (Se3.exp(0.05 * randn(6, 6) + offset) * truth).requires_grad_(False)}
    error = ReprojectionError(pixels, K, X)
    options = {"weights": weights, "max_iterations": 15, "gradient": "none"}
    kernel = least_squares(error, start, **options)
    solver = least_squares(lambda v: error(v), start, jacobian=lambda v: error.with_jacobian(v), **options)
    assert kernel.converged.dtype is torch.bool and kernel.iterations.dtype is torch.int64
    assert kernel.converged.tolist() == solver.converged.tolist() and kernel.cost[2].isnan()
    assert kernel.iterations[1] == 0 and kernel.variables["pose"].t[2].isnan().all()
    determined = torch.tensor([0, 1, 4, 5], device=device)
    tolerance = 1e-7 if dtype is torch.float64 else 2e-4
    a, b = (fit.variables["pose"].matrix()[determined] for fit in (kernel, solver))
    torch.testing.assert_close(a, b, rtol=tolerance, atol=tolerance)
    torch.testing.assert_close(kernel.cost[determined], solver.cost[determined], rtol=10 * tolerance, atol=0)


@pytest.mark.derivatives
def test_implicit_gradients_of_poses_are_those_of_iterations(device: torch.device) -> None:
    X, pixels, K = (t[None].to(device) for t in (POINTS, PIXELS + 0.2 * POINTS[:, :2], CAMERA))
    inputs = [t.requires_grad_() for t in (X, pixels, K, torch.linspace(1, 2, 8, dtype=X.dtype, device=device)[None])]
    start = {"pose": Se3.exp(torch.tensor([[0, 0, 6.2, 0.01, 0, 0]], dtype=X.dtype, device=device))}

    def gradients(start: dict[str, Se3], **options: Any) -> tuple[Tensor, ...]:
        fit = least_squares(ReprojectionError(pixels, K, X), start, inputs[3], **options)
        return torch.autograd.grad(
            fit.variables["pose"].log() @ torch.arange(1.0, 7, dtype=X.dtype, device=device), inputs
        )

    with torch.no_grad():
        tight = {"max_iterations": 60, "ftol": 0.0, "xtol": 0.0, "gtol": 1e-15}
        solved = least_squares(ReprojectionError(pixels, K, X), start, inputs[3], **tight).variables
    near = {"pose": Se3.exp(torch.full((1, 6), 0.02, dtype=X.dtype, device=device)) * solved["pose"]}
    unrolled = gradients(
        near, gradient="unrolled", method="gauss-newton", ftol=0.0, xtol=0.0, gtol=0.0, max_iterations=12
    )
    for a, b in zip(gradients(solved, **tight), unrolled):
        torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-8)
