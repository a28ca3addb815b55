"""least_squares against SciPy's: the same start, tolerances 1e-12, blocks of one residual, five robust kernels.

Costs agree to 1e-12 then. Parameters agree to about the root of the tolerance: a cost is flat around its minimum, and from there
both are equally far. `exact_minimum` tells how far.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from kvision.geometry.optim import least_squares
from kvision.geometry.optim._losses import LOSSES as KERNELS

optimize = pytest.importorskip("scipy.optimize")

T = torch.linspace(0, 1, 40, dtype=torch.float64)
POINTS = torch.randn(20, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def _pinhole(p: Tensor) -> Tensor:
    """The pixels of points before cameras of axis-angle rotations, translations and focal lengths (B, 7)."""
    w, t, f = p[:, None, :3], p[:, None, 3:6], p[:, None, 6:]
    angle = (w.square().sum(-1, keepdim=True) + 1e-30).sqrt()
    axis, X = w / angle, POINTS.expand(len(p), *POINTS.shape)
    axis = axis.expand_as(X)
    along = (axis * X).sum(-1, keepdim=True) * axis
    X = along + angle.cos() * (X - along) + angle.sin() * torch.linalg.cross(axis, X) + t
    return (f * X[..., :2] / X[..., 2:]).flatten(1)


def _circle(p: Tensor) -> Tensor:
    angle = 5 * T
    x, y = 1 + 2 * angle.cos(), -1 + 2 * angle.sin()
    return ((x - p[:, :1]).square() + (y - p[:, 1:2]).square()).sqrt() - p[:, 2:]


# name -> (model of parameters (B, n), parameters, how far starts are from them)
MODELS = {
    "decay": (lambda p: p[:, :1] * (p[:, 1:2] * T).exp() + p[:, 2:], [2.0, -3.0, 0.5], 0.3),
    "logistic": (lambda p: p[:, :1] * torch.sigmoid(p[:, 1:2] * (T - p[:, 2:])), [2.0, 9.0, 0.5], 0.1),
    "peak": (lambda p: p[:, :1] * (-((T - p[:, 1:2]) / p[:, 2:]).square()).exp(), [1.0, 0.4, 0.2], 0.05),
    "wave": (lambda p: p[:, :1] * (p[:, 1:2] * T + p[:, 2:]).sin(), [1.5, 6.0, 0.4], 0.2),
    "rational": (
        lambda p: (p[:, :1] + p[:, 1:2] * T) / (1 + p[:, 2:3] * T + p[:, 3:] * T * T),
        [1.0, 2.0, 0.6, 0.8],
        0.1,
    ),
    "circle": (_circle, [1.0, -1.0, 2.0], 0.4),
    "line": (lambda p: p[:, :1] + p[:, 1:2] * T + p[:, 2:] * T * T, [0.5, -1.0, 2.0], 1.0),
    "camera": (_pinhole, [0.3, -0.2, 0.1, 0.1, 0.2, 5.0, 3.0], 0.05),
}
LOSSES = ("linear", "huber", "soft_l1", "cauchy", "arctan")


def exact_minimum(x: Tensor, model: Any, target: Tensor, loss: str) -> Tensor:
    """The minimum next to parameters (n,), by steps of Newton's method."""

    def cost(p: Tensor) -> Tensor:
        return 0.005 * KERNELS[loss]((model(p[None])[0] - target).square() / 0.01).sum()

    for _ in range(4):
        x = x - torch.linalg.solve(torch.func.hessian(cost)(x), torch.func.grad(cost)(x))
    return x


def relative_difference(name: str, loss: str, count: int) -> list[tuple[float, float, float]]:
    """How far parameters and costs of `count` random problems are from SciPy's, relative to theirs.

    The last number is how far parameters are from the exact minimum without tolerances, which rounding ends.
    """
    model, truth, spread = MODELS[name]
    generator = torch.Generator().manual_seed(10 * list(MODELS).index(name) + LOSSES.index(loss))
    truth = torch.tensor(truth, dtype=torch.float64)
    start = truth + spread * (2 * torch.rand(count, len(truth), generator=generator, dtype=torch.float64) - 1)
    target = model(truth[None])
    target = target + 0.05 * torch.randn(count, target.shape[1], generator=generator, dtype=torch.float64)
    ours, closest = (
        least_squares(
            lambda v: model(v["p"]) - target, {"p": start}, loss=loss, f_scale=0.1,
            ftol=tolerance, xtol=tolerance, gtol=tolerance, max_iterations=300, gradient="none",
        )
        for tolerance in (1e-12, 0.0)
    )  # fmt: skip
    differences = []
    for i in range(count):

        def residuals(p: np.ndarray, i: int = i) -> np.ndarray:
            return (model(torch.from_numpy(p)[None]) - target[i])[0].numpy()

        def jacobian(p: np.ndarray) -> np.ndarray:
            return torch.func.jacfwd(lambda p: model(p[None])[0])(torch.from_numpy(p)).numpy()

        theirs = optimize.least_squares(
            residuals, start[i].numpy(), jacobian, loss=loss, f_scale=0.1, ftol=1e-12, xtol=1e-12, gtol=1e-12
        )
        x = ours.variables["p"][i].numpy()
        difference = float(np.linalg.norm(x - theirs.x) / np.linalg.norm(theirs.x))
        exact = exact_minimum(closest.variables["p"][i], model, target[i], loss)
        apart = (closest.variables["p"][i] - exact).norm() / exact.norm()
        differences.append((difference, float(ours.cost[i] / theirs.cost - 1), float(apart)))
    return differences


@pytest.mark.sweep
@pytest.mark.parametrize("name", MODELS)
def test_solutions_are_those_of_scipy(name: str, sizes: str) -> None:
    """A tenth of the 200 problems; `python tests/geometry/optim/test_scipy.py` compares all, `make test` one of each model."""
    i = list(MODELS).index(name)
    for loss in LOSSES[i % 2 :: 2] if sizes == "all" else [LOSSES[i % len(LOSSES)]]:
        for parameters, cost, apart in relative_difference(name, loss, 1):
            assert abs(cost) < 1e-10 and parameters < 1e-5 and apart < 1e-7, (loss, parameters, cost, apart)


if __name__ == "__main__":
    differences = {(n, k, i): d for n in MODELS for k in LOSSES for i, d in enumerate(relative_difference(n, k, 5))}
    for which, limit in (("parameters", 0), ("cost", 1), ("from the exact minimum, without tolerances", 2)):
        others = {key: d for key, d in differences.items() if not abs(d[limit]) <= 1e-8}
        print(
            f"{which}: {len(differences) - len(others)} of {len(differences)} within 1e-8; "
            f"others (parameters, cost, from the minimum): {others}"
        )
