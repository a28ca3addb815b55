"""Least squares on manifolds: known solutions, dense against Schur, gradients through the solution, hard inputs."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from kvision.geometry.liegroup import Se3, Sim3, So3
from kvision.geometry.optim import LeastSquaresResult, ReprojectionError, least_squares
from kvision.geometry.optim._variables import moving_tensors, retracted, tensors_of, velocities

F64 = torch.float64


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def motion(group: Any, *shape: int, scale: float = 0.5, seed: int = 1) -> Any:
    size = {So3: 3, Se3: 6, Sim3: 7}[group]
    return group.exp(scale * randn(*shape, size, seed=seed)).requires_grad_(False)


def align(group: Any, source: Tensor, target: Tensor, **options: Any) -> LeastSquaresResult:
    start = {"x": group.identity(len(source), device=source.device, dtype=source.dtype)}
    return least_squares(lambda v: v["x"][:, None] * source - target, start, **options)


@pytest.mark.parametrize(
    ("group", "method", "dtype"),
    [
        (So3, "levenberg-marquardt", torch.float32),
        (Se3, "levenberg-marquardt", F64),
        (Sim3, "levenberg-marquardt", torch.float32),
        (Sim3, "gauss-newton", F64),
    ],
)
def test_alignment_on_groups(group: Any, method: str, dtype: torch.dtype, device: torch.device) -> None:
    source, truth = randn(4, 20, 3).to(device, dtype), motion(group, 4).to(device, dtype)
    fit = align(group, source, truth[:, None] * source, method=method)
    tolerance = 1e-9 if dtype is F64 else 1e-5
    torch.testing.assert_close(fit.variables["x"].matrix(), truth.matrix(), rtol=tolerance, atol=tolerance)
    assert fit.converged.all() and (fit.iterations < 20).all() and fit.cost.dtype == dtype
    assert not any(p.requires_grad for p in fit.variables["x"].parameters())


@pytest.mark.parametrize("group", [So3, Se3, Sim3])
def test_derivatives_of_steps(group: Any, device: torch.device) -> None:
    """The closed form is the derivative of exp(d) x at d = 0, along each direction."""
    x = motion(group, 2, 5).to(device)
    steps = torch.eye({So3: 3, Se3: 6, Sim3: 7}[group], dtype=F64, device=device)[:, None, None].expand(-1, 2, 5, -1)
    found = velocities(x, moving_tensors(x), steps)
    zeros = torch.zeros_like(steps[0])
    for i, step in enumerate(steps):
        expected = torch.func.jvp(lambda d: moving_tensors(retracted(x, d)), (zeros,), (step,))[1]
        for a, b in zip(found, expected, strict=True):
            torch.testing.assert_close(a[i], b)


def bundle(device: torch.device, views: int = 4, points: int = 15) -> tuple[Any, dict[str, Any], dict[str, Tensor]]:
    """Two bundles in which most cameras see most points; the residuals, a start and an index."""
    poses, X = motion(Se3, 2, views, scale=0.2), randn(2, points, 3, seed=2) + torch.tensor([0.0, 0.0, 8.0])
    camera, point = torch.cartesian_prod(torch.arange(views), torch.arange(points)).unbind(-1)
    keep = torch.arange(len(camera)) % 7 != 3
    camera, point = camera[keep], point[keep]
    K = torch.tensor([[300.0, 2.0, 200.0], [0.0, 310.0, 150.0], [0.0, 0.0, 1.0]], dtype=F64)
    seen = (poses[:, camera] * X[:, point]) @ K.T
    pixels = seen[..., :2] / seen[..., 2:] + 0.5 * randn(*seen.shape[:2], 2, seed=4)
    start = {"pose": (motion(Se3, 2, views, scale=0.02, seed=5) * poses).to(device), "points": X.to(device)}
    index = {"pose": camera.to(device), "points": point.to(device)}
    return ReprojectionError(pixels.to(device), K.to(device)), start, index


def test_schur_complement_takes_the_steps_of_the_dense_system(device: torch.device) -> None:
    error, start, index = bundle(device)
    options: dict[str, Any] = {"index": index, "loss": "huber", "f_scale": 0.7, "max_iterations": 8}
    dense = least_squares(error, start, **options)
    assert (dense.cost < 0.9 * least_squares(error, start, **{**options, "max_iterations": 0}).cost).all()
    for eliminate in ("points", "pose"):
        schur = least_squares(error, start, eliminate=eliminate, **options)
        torch.testing.assert_close(schur.cost, dense.cost, rtol=1e-8, atol=0)
        torch.testing.assert_close(schur.variables["points"], dense.variables["points"], rtol=1e-5, atol=1e-5)
    again = least_squares(error, start, eliminate="points", **options)
    assert torch.equal(
        again.variables["points"], least_squares(error, start, eliminate="points", **options).variables["points"]
    )


def test_schur_complement_with_shared_variables(device: torch.device) -> None:
    """A shared focal length, which every block sees, beside poses with an index and eliminated points."""
    error, start, index = bundle(device)
    start = {"points": start["points"], "f": torch.ones(2, 1, dtype=F64, device=device), "pose": start["pose"]}

    def residuals(v: dict[str, Any]) -> Tensor:
        return error(v) + (v["f"] - 1)[:, None] * 300 * (v["pose"] * v["points"])[..., :2] / 8

    dense = least_squares(residuals, start, index=index, max_iterations=3)
    for eliminate in ("points", "pose"):
        schur = least_squares(residuals, start, index=index, eliminate=eliminate, max_iterations=3)
        torch.testing.assert_close(schur.variables["f"], dense.variables["f"], rtol=1e-6, atol=1e-6)
    assert schur.columns == {"points": slice(0, 45), "f": slice(45, 46)}
    fixed = torch.ones(2, error.pixels.shape[1], dtype=F64, device=device)
    anchored = {"f": start["f"], "points": start["points"]}

    def with_known_poses(v: dict[str, Any]) -> Tensor:
        return residuals({**v, "pose": start["pose"][:, index["pose"]]})

    solved = [
        least_squares(with_known_poses, anchored, fixed, index={"points": index["points"]}, eliminate=e)
        for e in (None, "points")
    ]
    torch.testing.assert_close(solved[0].covariance()[:, :1, :1], solved[1].covariance(), rtol=1e-6, atol=0)


def test_jacobian_of_the_reprojection_error(device: torch.device) -> None:
    error, start, index = bundle(device)
    given = least_squares(error, start, index=index, eliminate="points", max_iterations=3)
    derived = least_squares(lambda v: error(v), start, index=index, eliminate="points", max_iterations=3)
    torch.testing.assert_close(given.variables["points"], derived.variables["points"], rtol=1e-9, atol=1e-9)


def test_pose_graphs(device: torch.device) -> None:
    """A loop of poses with measured relative motions, each block of residuals seeing two of them."""
    truth = motion(Se3, 1, 6, scale=0.8).to(device)
    pairs = torch.tensor([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0], [0, 3]], device=device)
    measured = truth[:, pairs[:, 0]].inverse() * truth[:, pairs[:, 1]]
    start = motion(Se3, 1, 6, scale=0.1, seed=3).to(device) * truth

    def residuals(v: dict[str, Any]) -> Tensor:
        a, b = v["pose"][:, :, 0], v["pose"][:, :, 1]
        return (measured.inverse() * (a.inverse() * b)).log()

    fit = least_squares(residuals, {"pose": start}, index={"pose": pairs})
    assert fit.cost.item() < 1e-16
    found = fit.variables["pose"][:, :1].inverse() * fit.variables["pose"]
    torch.testing.assert_close(found.matrix(), (truth[:, :1].inverse() * truth).matrix(), rtol=1e-6, atol=1e-6)
    assert fit.covariance().isnan().all(), "the first pose is free"


@pytest.mark.derivatives
@pytest.mark.parametrize(("group", "loss"), [(Se3, "linear"), (So3, "cauchy"), (Sim3, "linear")])
def test_gradients_through_the_solution(group: Any, loss: str, device: torch.device) -> None:
    """By the implicit function theorem, through the iterations, and by differences."""
    source, truth = randn(2, 8, 3).to(device), motion(group, 2).to(device)
    target = truth[:, None] * source + 0.2 * randn(2, 8, 3, seed=5).to(device)
    weights = (0.5 + randn(2, 8, seed=6).abs()).to(device)

    def solved(gradient: str, source: Tensor, target: Tensor, weights: Tensor) -> Tensor:
        options: dict[str, Any] = {"ftol": 0.0, "xtol": 1e-13, "gtol": 1e-14, "loss": loss, "f_scale": 1.0}
        fit = align(group, source, target, weights=weights, gradient=gradient, **options)
        return torch.cat([fit.variables["x"].log().flatten(), fit.cost])

    inputs = tuple(x.requires_grad_() for x in (source, target, weights))
    direction = randn(*solved("none", *inputs).shape, seed=7).to(device)
    implicit = torch.autograd.grad(solved("implicit", *inputs) @ direction, inputs)
    steps = [randn(*x.shape, seed=8 + i).to(device) for i, x in enumerate(inputs)]
    h = 1e-5
    ahead, behind = (solved("none", *(x + s * d for x, d in zip(inputs, steps))).detach() for s in (h, -h))
    difference = (ahead - behind) @ direction / (2 * h)
    torch.testing.assert_close(sum((g * d).sum() for g, d in zip(implicit, steps)), difference, rtol=1e-5, atol=1e-6)
    if group is So3:
        unrolled = torch.autograd.grad(solved("unrolled", *inputs) @ direction, inputs)
        for a, b in zip(implicit, unrolled):
            torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-7)


@pytest.mark.derivatives
def test_implicit_gradients_through_a_bundle(device: torch.device) -> None:
    """The Schur complement of the exact Hessian gives the gradients of the dense one."""
    error, start, index = bundle(device, 3, 10)
    known, pixels = start["pose"], error.pixels.requires_grad_()
    gradients = []
    for eliminate in (None, "points"):
        scale = torch.ones(2, 1, dtype=F64, device=device)

        def residuals(v: dict[str, Any]) -> Tensor:
            return error({"pose": known[:, index["pose"]], "points": v["points"]}) + (v["f"] - 1)[:, None]

        fit = least_squares(
            residuals, {"points": start["points"], "f": scale}, index={"points": index["points"]}, eliminate=eliminate
        )
        gradients.append(torch.autograd.grad(fit.variables["f"].sum() + fit.variables["points"].sum(), pixels)[0])
    assert gradients[0].abs().max() > 1e-3
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-4, atol=1e-8)
    with pytest.raises(RuntimeError, match="first derivatives only"):
        fit = least_squares(residuals, {"points": start["points"], "f": scale}, index={"points": index["points"]})
        (grad,) = torch.autograd.grad(fit.variables["f"].sum(), pixels, create_graph=True)
        grad.sum().backward()


def test_problems_do_not_see_each_other(device: torch.device) -> None:
    """A batch gives what its problems give alone; NaN where one cannot be evaluated, and no weight for what is masked."""
    source = randn(4, 10, 3).to(device)
    target = motion(Se3, 4).to(device)[:, None] * source + 0.1 * randn(4, 10, 3, seed=2).to(device)
    alone = [align(Se3, source[i : i + 1], target[i : i + 1]).variables["x"].matrix() for i in range(4)]
    weights = torch.ones(4, 10, dtype=F64, device=device)
    target[1, 3] = torch.nan
    target[2] = torch.cat([target[2, :6], torch.full((4, 3), torch.nan, dtype=F64, device=device)])
    weights[2, 6:] = 0
    fit = align(Se3, source, target, weights=weights)
    assert fit.converged.tolist() == [True, False, True, True]
    assert fit.cost.isnan().tolist() == [False, True, False, False]
    assert fit.variables["x"].matrix()[1, :3].isnan().all()
    for i in (0, 3):
        torch.testing.assert_close(fit.variables["x"].matrix()[i : i + 1], alone[i], rtol=1e-9, atol=1e-9)
    few = align(Se3, source[2:3, :6], target[2:3, :6])
    torch.testing.assert_close(fit.variables["x"].matrix()[2:3], few.variables["x"].matrix(), rtol=1e-9, atol=1e-9)
    assert align(Se3, source[:0], target[:0]).cost.shape == (0,)
    nothing = align(Se3, source[:, :0], source[:, :0])
    assert nothing.converged.all() and nothing.covariance().isnan().all()


@pytest.mark.parametrize("path", ["dense", "poses"])
@pytest.mark.parametrize("gradient", ["implicit", "unrolled", "none"])
def test_problems_with_weights_that_are_no_weights_are_not_solved(path, gradient, device):
    """NaN and numbers below 0 make their problem NaN; the others are solved as they are alone."""
    if path == "dense":
        y = torch.arange(12.0, dtype=F64, device=device).view(3, 4)
        start: Any = {"x": torch.zeros(3, 1, dtype=F64, device=device)}
        call = lambda weights: least_squares(  # noqa: E731
            lambda v: v["x"] - y, start, weights=weights, gradient=gradient
        )
        count = 4
    else:
        points = torch.rand(3, 9, 3, dtype=F64, device=device) + torch.tensor([0.0, 0.0, 3.0], device=device)
        camera = torch.eye(3, dtype=F64, device=device)
        pixels = points[..., :2] / points[..., 2:] + 0.01 * torch.rand(3, 9, 2, dtype=F64, device=device)
        pose = Se3.exp(torch.zeros(3, 6, dtype=F64, device=device))
        error, start = ReprojectionError(pixels, camera, points), {"pose": pose}
        call = lambda weights: least_squares(error, start, weights=weights, gradient=gradient)  # noqa: E731
        count = 9
    weights = torch.ones(3, count, dtype=F64, device=device)
    good = call(weights)
    weights[0, 1], weights[2, 2] = torch.nan, -1.0
    fit = call(weights)
    for name, x in fit.variables.items():
        of_good = good.variables[name]
        for t, expected in zip(tensors_of(x), tensors_of(of_good)):
            assert t[[0, 2]].isnan().all() and torch.equal(t[1], expected[1]), name
    assert fit.cost[[0, 2]].isnan().all() and fit.cost[1] == good.cost[1]
    assert fit.converged.tolist() == [False, bool(good.converged[1]), False]


def test_covariance_is_that_of_linear_regression(device: torch.device) -> None:
    A, y = randn(1, 30, 3).to(device), randn(1, 30, seed=1).to(device)
    fit = least_squares(
        lambda v: (A @ v["x"][..., None])[..., 0] - y, {"x": torch.zeros(1, 3, dtype=F64, device=device)}
    )
    x = torch.linalg.lstsq(A, y[..., None]).solution
    torch.testing.assert_close(fit.variables["x"], x[..., 0])
    variance = (A @ x - y[..., None]).square().sum() / 27
    torch.testing.assert_close(fit.covariance(), variance * torch.linalg.inv(A.mT @ A))
    torch.testing.assert_close(fit.covariance(2.0), 4 * torch.linalg.inv(A.mT @ A))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"loss": "l1"}, ValueError, "least_squares: loss must be one of linear, huber"),
        ({"f_scale": 0.0}, ValueError, "least_squares: expected f_scale above 0"),
        ({"method": "newton"}, ValueError, "least_squares: method must be one of"),
        ({"eliminate": "x"}, ValueError, "least_squares: expected eliminate to be a variable with an index"),
        ({"weights": torch.ones(1, 2)}, ValueError, r"least_squares: expected weights of shape \(1, 3\), got \(1, 2\)"),
        ({"index": {"x": torch.zeros(3)}}, TypeError, "least_squares: expected index.'x'. to be int64"),
        (
            {"variables": {"x": torch.zeros(1, 3).half()}},
            TypeError,
            "least_squares: expected x to be float32 or float64",
        ),
        (
            {"variables": {"x": "pose"}},
            TypeError,
            "least_squares: expected the variable 'x' to be a Tensor, So3, Se3 or",
        ),
        ({"residuals": lambda v: v["x"].sum()}, ValueError, r"least_squares: expected residuals of shape \(1, N\)"),
        (
            {"jacobian": lambda v: (v["x"], {"x": v["x"]})},
            ValueError,
            "least_squares: expected the Jacobian of x of shape",
        ),
    ],
)
def test_errors(options: dict[str, Any], error: type[Exception], message: str) -> None:
    arguments = {"residuals": lambda v: v["x"], "variables": {"x": torch.ones(1, 3)}, **options}
    with pytest.raises(error, match=message):
        least_squares(**arguments)


def test_iterations_do_not_wait_for_the_device(device: torch.device) -> None:
    if device.type != "cuda":
        pytest.skip("needs a GPU")
    error, start, index = bundle(device)
    least_squares(error, start, index=index, eliminate="points", max_iterations=1)
    source, target = randn(4, 20, 3).to(device), randn(4, 20, 3, seed=1).to(device)
    align(Se3, source, target, max_iterations=2)
    torch.cuda.set_sync_debug_mode("error")
    try:
        align(Se3, source, target, max_iterations=5, gradient="none")
    finally:
        torch.cuda.set_sync_debug_mode("default")
