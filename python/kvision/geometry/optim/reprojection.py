"""The reprojection error of points before cameras, with its Jacobian in closed form."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import register
from kvision.geometry.liegroup import Se3, So3
from kvision.geometry.optim._derivatives import Problem
from kvision.geometry.optim._normal_equations import Assembly
from kvision.geometry.optim._solver import Solver
from kvision.geometry.optim._variables import Layout, Variables, tensors_of, value_like

__all__ = ["ReprojectionError"]


class ReprojectionError:
    """Residuals of :func:`least_squares`: where cameras see points, less where they were observed, in pixels.

    The variables are "pose", Se3 from world to camera, and "points" (B, N, 3) or (B, K, 3) with an index, unless `points` are
    given. Without an index one pose of each problem sees all points. Pixels have no distortion: undistort them first.

    Args:
        pixels: observations (B, N, 2) as (x, y).
        camera_matrix: (B, 3, 3), upper triangular, or (3, 3) for all.
        points: known points (B, N, 3) of the world; None for a variable.

    Raises:
        TypeError: an argument is not a floating-point tensor.
        ValueError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 6, 3, dtype=torch.float64) + torch.tensor([0.0, 0.0, 4.0])
        >>> pixels = 100 * points[..., :2] / points[..., 2:]
        >>> camera = torch.diag(torch.tensor([100.0, 100.0, 1.0])).double()
        >>> error = K.geometry.optim.ReprojectionError(pixels, camera, points)
        >>> start = {"pose": K.geometry.liegroup.Se3.exp(0.05 * torch.ones(1, 6).double())}
        >>> pose = K.geometry.optim.least_squares(error, start).variables["pose"]
        >>> pose.log().abs().max() < 1e-6
        tensor(True)
    """

    def __init__(self, pixels: Tensor, camera_matrix: Tensor, points: Tensor | None = None) -> None:
        op = "ReprojectionError"
        _check.floating_trailing_shape(op, "pixels", pixels, "B", "N", 2)
        _check.floating_trailing_shape(op, "camera_matrix", camera_matrix, 3, 3)
        if points is not None:
            _check.floating_trailing_shape(op, "points", points, "B", "N", 3)
        _check.same_device(op, pixels=pixels, camera_matrix=camera_matrix)
        self.pixels, self.points = pixels, points
        self.camera_matrix = K = camera_matrix[None] if camera_matrix.dim() == 2 else camera_matrix
        self.focal, self.center = K[:, None, :2, :2], K[:, None, :2, 2]

    def _in_camera(self, variables: dict[str, Any]) -> tuple[Any, Tensor]:
        pose, points = variables["pose"], variables.get("points", self.points)
        pose = pose[:, None] if pose.t.dim() == 2 else pose
        return pose, pose * points

    def _error(self, p: Tensor) -> Tensor:
        projected = (self.focal @ (p[..., :2] / p[..., 2:])[..., None])[..., 0]
        return projected + self.center - self.pixels

    def __call__(self, variables: dict[str, Any]) -> Tensor:
        """The errors (B, N, 2)."""
        return self._error(self._in_camera(variables)[1])

    def with_jacobian(self, variables: dict[str, Any]) -> tuple[Tensor, dict[str, Tensor]]:
        """The errors (B, N, 2), and their derivatives (B, N, 2, d) with respect to steps of the variables."""
        pose, p = self._in_camera(variables)
        r, inverse = self._error(p), 1 / p[..., 2, None]
        of_focal = self.focal * inverse[..., None]
        to_point = torch.cat([of_focal, -of_focal @ (p[..., :2] * inverse)[..., None]], -1)
        del of_focal  # a bundle's Jacobian is large, so little is kept beside it
        jacobian = {"points": to_point @ pose.r.matrix()} if "points" in variables else {}
        jacobian["pose"] = to_pose = to_point.new_empty(*to_point.shape[:-1], 6)
        to_pose[..., :3] = to_point
        to_pose[..., 3:] = torch.linalg.cross(
            p[..., None, :].expand_as(to_point), to_point
        )  # exp(d) p is p + t + w x p
        return r, jacobian


# --- poses alone -----------------------------------------------------------------------------------------------------


def _reference(
    start: Tensor,
    points: Tensor,
    pixels: Tensor,
    camera: Tensor,
    weights: Tensor | None,
    max_iterations: int,
    ftol: float,
    xtol: float,
    gtol: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    error = ReprojectionError(pixels, camera, points)
    q, t = start.split([4, 3], -1)
    pose = {"pose": Se3(So3.from_wxyz(q), t).requires_grad_(False)}
    layout = Layout("fit_poses", pose, None)
    problem = Problem("fit_poses", error, layout, weights, None, error.with_jacobian)
    solver = Solver(problem, Assembly(layout, None), True, max_iterations, ftol, xtol, gtol)
    found, cost, converged, iterations = solver.solve(pose)
    return torch.cat(tensors_of(found["pose"]), -1), cost, converged, iterations


# The poses from world to camera (B, 7), a quaternion and a translation, that Levenberg and Marquardt's method finds from a start;
# their costs (B,), whether a tolerance was reached, and the number of steps. Points (B, N, 3) and weights (B, N) are known.
fit_poses = register(
    "fit_poses",
    _reference,
    fake=lambda start, *rest: [
        start.shape,
        start.new_empty(start.shape[:1]),
        start.new_empty(start.shape[:1], dtype=torch.bool),
        start.new_empty(start.shape[:1], dtype=torch.int64),
    ],
    non_differentiable=(0, 1, 2, 3),
    casts_outputs=True,
)


def is_pose_problem(error: ReprojectionError, problem: Problem, method: str) -> bool:
    """Whether `fitted_poses` solves a problem of this error: one pose each that sees known points, of one type, by its Jacobian."""
    variables = problem.layout.slices
    tensors = (error.points, error.pixels, error.camera_matrix)
    return (
        method == "levenberg-marquardt"
        and problem.rho is None
        and not problem.layout.index
        and tuple(variables) == ("pose",)
        and variables["pose"].stop == 6
        and problem.jacobian == error.with_jacobian
        and all(x is not None and x.dim() == 3 and x.dtype == error.pixels.dtype for x in tensors)
    )


def fitted_poses(
    error: ReprojectionError,
    start: Variables,
    weights: Tensor | None,
    max_iterations: int,
    tolerances: tuple[float, ...],
) -> tuple[Variables, Tensor, Tensor, Tensor]:
    """The solution of such a problem, as `Solver.solve` returns it."""
    x, points = start["pose"], error.points
    assert points is not None
    arguments = (torch.cat(tensors_of(x), -1), points, error.pixels, error.camera_matrix, weights)
    pose, cost, converged, iterations = fit_poses(*arguments, max_iterations, *tolerances)
    return {"pose": value_like(x, tuple(pose.split([4, 3], -1)))}, cost, converged, iterations
