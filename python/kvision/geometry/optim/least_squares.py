"""Nonlinear least squares over vectors, rotations, motions and similarities, batched, by Gauss-Newton or Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry.optim._derivatives import Problem, Residuals, WithJacobian
from kvision.geometry.optim._losses import Loss, RobustLoss, loss_of
from kvision.geometry.optim._normal_equations import Assembly
from kvision.geometry.optim._solver import Solver
from kvision.geometry.optim._variables import Layout, Variables, detached, one_of, tensors_of, value_like
from kvision.geometry.optim.bundle import fitted_bundle, is_bundle_problem
from kvision.geometry.optim.reprojection import ReprojectionError, fitted_poses, is_pose_problem

__all__ = ["LeastSquaresResult", "least_squares"]

Method: TypeAlias = Literal["levenberg-marquardt", "gauss-newton"]
_METHODS = get_args(Method)
Gradient: TypeAlias = Literal["implicit", "unrolled", "none"]
_GRADIENTS = get_args(Gradient)


@dataclass(frozen=True)
class LeastSquaresResult:
    """What :func:`least_squares` returns for B problems.

    Attributes:
        variables: the solutions, by name; NaN where the residuals of the start are not finite, or a weight is below 0 or NaN.
        cost: 1/2 the sum of weight * rho(|r|^2), (B,).
        converged: whether a tolerance was reached, bool (B,).
        iterations: the number of steps that were tried, int64 (B,).
        columns: where the tangent of each variable is in :meth:`covariance`; eliminated variables are not.

    Example:
        >>> import torch, kvision as K
        >>> y = torch.tensor([[1.0, 3.0]])
        >>> mean = K.geometry.optim.least_squares(lambda v: v["x"] - y, {"x": torch.zeros(1, 1)})
        >>> mean.variables["x"], mean.covariance(sigma=1.0)
        (tensor([[2.]]), tensor([[[0.5000]]]))
    """

    variables: dict[str, Any]
    cost: Tensor
    converged: Tensor
    iterations: Tensor
    columns: dict[str, slice]
    _information: Callable[[], tuple[Tensor, Tensor]] = field(repr=False)

    def covariance(self, sigma: float | None = None) -> Tensor:
        """The covariance of the solution in its tangent, exp(d) X or X + d.

        Args:
            sigma: standard deviation of residuals of weight 1; None estimates it from the cost.

        Returns:
            (B, D, D), whose rows and columns :attr:`columns` names; that of eliminated variables is integrated out. NaN where the
            residuals do not determine the variables. There is no gradient.
        """
        with torch.no_grad():
            information, freedom = self._information()
            L, info = torch.linalg.cholesky_ex(information)
            inverse = torch.cholesky_solve(torch.eye(L.shape[-1], dtype=L.dtype, device=L.device).expand_as(L), L)
            variance = 2 * self.cost.detach() / freedom if sigma is None else torch.full_like(self.cost, sigma**2)
            is_known = (info == 0) & (variance >= 0) & (freedom > 0 if sigma is None else True)
            return torch.where(is_known[:, None, None], inverse * variance[:, None, None], torch.nan)


def least_squares(
    residuals: Residuals,
    variables: Mapping[str, Any],
    weights: Tensor | None = None,
    loss: RobustLoss | Loss = "linear",
    f_scale: float = 1.0,
    index: Mapping[str, Tensor] | None = None,
    eliminate: str | None = None,
    jacobian: WithJacobian | None = None,
    method: Method = "levenberg-marquardt",
    max_iterations: int = 50,
    ftol: float = 1e-8,
    xtol: float = 1e-8,
    gtol: float = 1e-8,
    gradient: Gradient = "implicit",
) -> LeastSquaresResult:
    """Minimize 1/2 the sum of weight * rho(|r|^2) over blocks r of residuals, for a batch of independent problems.

    Vectors move by addition, rotations, motions and similarities by X <- exp(d) X. Problems that have converged stay as they are
    while others go on. On the CPU the iterations end when all problems have converged; on a GPU the host waits for nothing, and
    there are `max_iterations` of them.

    Args:
        residuals: a torch function of a dictionary of variables, which returns blocks (B, N, n), or (B, N) for blocks of one
            number. Those of a problem depend on the variables of this problem alone.
        variables: the start by name: tensors (B, *), So3, Se3 or Sim3 (B, *), of float32 or float64.
        weights: of the blocks, at least 0, (B, N). Blocks of weight 0 do not count, whatever their residuals. A problem with a
            weight below 0 or NaN has no solution.
        loss: the robust kernel rho(s) of the squared norm s of a block: "linear", "huber", "soft_l1", "cauchy", "arctan",
            "geman_mcclure", "welsch" or "tukey", or an elementwise torch function with rho'(0) = 1.
        f_scale: the norm C of a block at which a robust kernel sets in: C^2 rho(s / C^2).
        index: for variables of many elements (B, K, *), the one element (N,) or the m elements (N, m) that each block depends on,
            int64. `residuals` gets them as (B, N, *) or (B, N, m, *).
        eliminate: the name of an indexed variable, such as the points of a bundle, that is eliminated by a Schur complement.
            Without one the normal equations are dense.
        jacobian: a function of the same variables that returns the residuals and a dictionary of their Jacobians (B, N, n, d) with
            respect to steps d. None takes `residuals.with_jacobian` if there is one, else torch.func's forward mode.
        method: "levenberg-marquardt" or "gauss-newton".
        max_iterations: of steps tried.
        ftol: tolerance of the relative decrease of the cost that the next step predicts.
        xtol: tolerance of the length of a step relative to that of the variables.
        gtol: tolerance of the cosine of the angle between the residuals and a column of the Jacobian.
        gradient: how gradients reach all tensors that `residuals`, `weights` and a function `loss` depend on: "implicit", by the
            implicit function theorem at the solution, once differentiable; "unrolled", through the iterations; "none".

    Returns:
        A :class:`LeastSquaresResult`.

    Raises:
        TypeError: a variable or an index is of another type.
        ValueError: a shape, name or number is not as in Args.

    Source: K. Madsen, H. B. Nielsen, O. Tingleff, "Methods for non-linear least squares problems" (2004); B. Triggs et al., "Bundle
    adjustment: a modern synthesis" (2000).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.linspace(0, 1, 20, dtype=torch.float64)
        >>> y = 2 * (-3 * x).exp()
        >>> start = {"a": torch.ones(1, 1).double(), "b": torch.zeros(1, 1).double()}
        >>> fit = K.geometry.optim.least_squares(lambda v, x=x, y=y: v["a"] * (v["b"] * x).exp() - y, start)
        >>> round(fit.variables["a"].item(), 6), round(fit.variables["b"].item(), 6), fit.converged.item()
        (2.0, -3.0, True)
    """
    op = "least_squares"
    _check.function(op, "residuals", residuals)
    _check.choice(op, "method", method, _METHODS)
    _check.choice(op, "gradient", gradient, _GRADIENTS)
    _check.ints(op, "max_iterations", max_iterations, 1, minimum=0)
    tolerances = tuple(_check.number(op, name, x, 0) for name, x in (("ftol", ftol), ("xtol", xtol), ("gtol", gtol)))
    rho = loss_of(op, loss, f_scale)
    if eliminate is not None:
        one_of(op, "eliminate", eliminate, index)
    if jacobian is None:
        jacobian = getattr(residuals, "with_jacobian", None)
    layout = Layout(op, variables, index)
    assembly = Assembly(layout, eliminate)
    if weights is not None:
        _check.shape(op, "weights", weights, "B", "N")
    problem = Problem(op, residuals, layout, weights, rho, jacobian)
    start = {name: _broadcast(x) for name, x in variables.items()}
    if weights is not None:
        is_valid = (weights.detach() >= 0).all(1)
        start = {name: _where(is_valid, x) for name, x in start.items()}
    solver = Solver(problem, assembly, method == "levenberg-marquardt", max_iterations, *tolerances)
    if gradient == "unrolled":
        solution, cost, converged, iterations = solver.solve(start)
    else:
        with torch.no_grad():
            constant = detached(start)
            error = residuals if isinstance(residuals, ReprojectionError) else None
            if error is not None and is_pose_problem(error, problem, method):
                found = fitted_poses(error, constant, weights, max_iterations, tolerances)
            elif error is not None and is_bundle_problem(error, problem, method, eliminate, loss):
                arguments = (layout.index, weights, loss, float(f_scale), max_iterations, tolerances)
                found = fitted_bundle(error, constant, *arguments)  # type: ignore[arg-type]  # loss is a name
            else:
                found = solver.solve(constant)
            solution, cost, converged, iterations = found
        if gradient == "implicit" and torch.is_grad_enabled():
            solution, cost = _with_implicit_gradient(problem, assembly, solution, cost)
    constant = detached(solution)
    return LeastSquaresResult(
        solution, cost, converged, iterations, assembly.columns, lambda: _information(problem, assembly, constant)
    )


def _broadcast(x: Any) -> Any:
    """A group element whose tensors have the same leading axes."""
    if isinstance(x, Tensor):
        return x
    axes = [0 if i == 2 else 1 for i in range(len(tensors_of(x)))]
    leading = torch.broadcast_shapes(*(t.shape[: t.dim() - n] for t, n in zip(tensors_of(x), axes)))
    return value_like(x, tuple(t.expand(*leading, *t.shape[t.dim() - n :]) for t, n in zip(tensors_of(x), axes)))


def _where(is_valid: Tensor, x: Any) -> Any:
    """A variable with NaN in problems that are not valid (B,)."""
    tensors = tensors_of(x)
    if is_valid.shape[0] != tensors[0].shape[0]:
        return x  # which the problem refuses
    return value_like(x, tuple(torch.where(is_valid.view(-1, *[1] * (t.dim() - 1)), t, torch.nan) for t in tensors))


def _information(problem: Problem, assembly: Assembly, variables: Variables) -> tuple[Tensor, Tensor]:
    """Gauss-Newton's Hessian of the kept variables and the number of residuals (B,) beyond that of unknowns they depend on."""
    r, J = problem.linearized(variables)
    count = torch.full_like(r[:, 0, 0], r[0].numel() if len(r) else 0) if r.shape[1] else r.new_zeros(len(r))
    if problem.weights is not None:
        count = r.shape[2] * (problem.weights > 0).sum(-1).to(r.dtype)
    model = problem.gauss_newton(r, J)
    unknowns = (assembly.vector(model.column_norms) > 0).sum(-1)
    return assembly.information(assembly.equations(model)), count - unknowns


# --- gradients through the solution ----------------------------------------------------------------------------------


class _ImplicitStep(torch.autograd.Function):
    """Steps 0 whose gradient to the slope of the cost is -H^-1: how the minimum moves when the slope changes."""

    @staticmethod
    def forward(ctx: Any, slope: Tensor, solve: Callable[[Tensor], Tensor]) -> Tensor:
        ctx.solve = solve
        return torch.zeros_like(slope)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        with torch.no_grad():
            step = ctx.solve(grad)
        return _NoSecondDerivative.apply(step.requires_grad_()) if torch.is_grad_enabled() else step, None


class _NoSecondDerivative(torch.autograd.Function):
    """The same numbers, through which no gradient flows: an error instead of one without the change of the Hessian."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        raise RuntimeError("least_squares: gradient='implicit' has first derivatives only; 'unrolled' has all")


def _with_implicit_gradient(
    problem: Problem, assembly: Assembly, solution: Variables, cost: Tensor
) -> tuple[Variables, Tensor]:
    """The solution with the gradient of the implicit function theorem, by the exact Hessian."""
    value = problem.cost(solution)  # its derivative along the solution is 0
    if not value.requires_grad:
        return solution, cost
    slope = assembly.vector(problem.gradient(solution))

    def solve(grad: Tensor) -> Tensor:
        return assembly.solve(assembly.equations(problem.hessian(solution)), grad, None, positive=False).step

    moved = problem.layout.retracted(solution, _ImplicitStep.apply(slope, solve))
    return {name: _valued(x, solution[name]) for name, x in moved.items()}, cost + (value - value.detach())


def _valued(x: Any, constant: Any) -> Any:
    """`x` with the value of `constant`, bit by bit."""
    return value_like(x, tuple(c.detach() + (t - t.detach()) for t, c in zip(tensors_of(x), tensors_of(constant))))
