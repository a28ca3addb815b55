"""Bundles of the built-in reprojection error: all iterations by one operator."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _limits, _modes
from kvision._ops import register
from kvision.geometry.liegroup import Se3, So3
from kvision.geometry.optim._derivatives import Problem
from kvision.geometry.optim._losses import Loss, RobustLoss, loss_of
from kvision.geometry.optim._normal_equations import Assembly
from kvision.geometry.optim._solver import Solver
from kvision.geometry.optim._variables import Layout, Variables, tensors_of, value_like
from kvision.geometry.optim.group_products import by_key, offsets_of
from kvision.geometry.optim.reprojection import ReprojectionError


def _reference(
    poses: Tensor,
    points: Tensor,
    pixels: Tensor,
    camera: Tensor,
    camera_index: Tensor,
    point_index: Tensor,
    by_camera: Tensor,
    camera_offsets: Tensor,
    point_offsets: Tensor,
    weights: Tensor | None,
    loss: int,
    scale: float,
    max_iterations: int,
    ftol: float,
    xtol: float,
    gtol: float,
) -> tuple[Tensor, ...]:
    op = "fit_bundle"
    error = ReprojectionError(pixels, camera)
    q, t = poses.split([4, 3], -1)
    start = {"pose": Se3(So3.from_wxyz(q), t).requires_grad_(False), "points": points}
    layout = Layout(op, start, {"pose": camera_index[0].long(), "points": point_index[0].long()})
    rho = loss_of(op, tuple(_modes.ROBUST_LOSS)[loss], scale)  # type: ignore[arg-type]  # the names of RobustLoss
    problem = Problem(op, error, layout, weights, rho, error.with_jacobian)
    solver = Solver(problem, Assembly(layout, "points"), True, max_iterations, ftol, xtol, gtol)
    found, cost, converged, iterations = solver.solve(start)
    return torch.cat(tensors_of(found["pose"]), -1), found["points"], cost, converged, iterations


# The poses from world to camera (B, C, 7), quaternions and translations, and the points (B, K, 3) that Levenberg and Marquardt's
# method finds from a start; their costs (B,), whether a tolerance was reached, and the number of steps. The pixels (B, N, 2) and
# weights (B, N) are those of observations in the order of their points, which `point_index` (1, N) names, and of their cameras,
# which `camera_index` names; `by_camera` (1, N) orders them by camera alone, and offsets (1, C + 1) and (1, K + 1) say where those
# of each camera and point begin. All of these are int32.
fit_bundle = register(
    "fit_bundle",
    _reference,
    fake=lambda poses, points, *rest: [
        poses.shape,
        points.shape,
        poses.new_empty(poses.shape[:1]),
        poses.new_empty(poses.shape[:1], dtype=torch.bool),
        poses.new_empty(poses.shape[:1], dtype=torch.int64),
    ],
    non_differentiable=(0, 1, 2, 3, 4),
    casts_outputs=True,
)


def is_bundle_problem(
    error: ReprojectionError, problem: Problem, method: str, eliminate: str | None, loss: RobustLoss | Loss
) -> bool:
    """Whether `fitted_bundle` solves a problem of this error: poses and points with an index, of one type, by its Jacobian."""
    index, references = problem.layout.index, problem.layout.references
    return (
        method == "levenberg-marquardt"
        and isinstance(loss, str)
        and eliminate == "points"
        and set(problem.layout.slices) == {"pose", "points"} == set(index)
        and len(references) == 2
        and [r.size for r in references if r.name == "pose"] == [6]
        and [r.size for r in references if r.name == "points"] == [3]
        and all(0 < r.count for r in references)
        and all(r.count <= _limits.MAX_BUNDLE_CAMERAS for r in references if r.name == "pose")
        and error.points is None
        and problem.jacobian == error.with_jacobian
    )


def fitted_bundle(
    error: ReprojectionError,
    start: Variables,
    index: dict[str, Tensor],
    weights: Tensor | None,
    loss: RobustLoss,
    f_scale: float,
    max_iterations: int,
    tolerances: tuple[float, ...],
) -> tuple[Variables, Tensor, Tensor, Tensor]:
    """The solution of such a problem, as `Solver.solve` returns it."""
    pose, points = start["pose"], start["points"]
    order = (index["points"] * pose.t.shape[1] + index["pose"]).argsort(stable=True)
    camera_index, point_index = index["pose"][order], index["points"][order]
    by_camera, of_camera = by_key(camera_index, pose.t.shape[1])
    poses, found, cost, converged, iterations = fit_bundle(
        torch.cat(tensors_of(pose), -1),
        points,
        error.pixels[:, order],
        error.camera_matrix,
        camera_index.int()[None],
        point_index.int()[None],
        by_camera.int()[None],
        of_camera[None],
        offsets_of(point_index, points.shape[1])[None],
        None if weights is None else weights[:, order],
        _modes.ROBUST_LOSS[loss],
        float(f_scale),
        max_iterations,
        *tolerances,
    )
    return {"pose": value_like(pose, tuple(poses.split([4, 3], -1))), "points": found}, cost, converged, iterations
