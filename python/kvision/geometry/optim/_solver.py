"""The iterations of Gauss-Newton and Levenberg-Marquardt, for a batch of problems."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry.optim._derivatives import Problem
from kvision.geometry.optim._normal_equations import Assembly
from kvision.geometry.optim._variables import Variables, chosen, tensors_of

_FIRST_DAMPING = 1e-3
_GROWTH = 4.0  # of the damping when a step fails, and of this factor


class Solver:
    def __init__(
        self,
        problem: Problem,
        assembly: Assembly,
        is_damped: bool,
        max_iterations: int,
        ftol: float,
        xtol: float,
        gtol: float,
    ) -> None:
        self.problem, self.assembly, self.is_damped, self.max_iterations = problem, assembly, is_damped, max_iterations
        self.ftol, self.xtol, self.gtol = ftol, xtol, gtol

    def solve(self, x: Variables) -> tuple[Variables, Tensor, Tensor, Tensor]:
        """The solutions, their costs, whether they converged, and after how many steps."""
        self.assembly.prepare()
        problem = self.problem
        cost = problem.cost(x)
        is_valid = cost.isfinite()
        eps = torch.finfo(cost.dtype).eps
        damping = torch.full_like(cost, _FIRST_DAMPING).detach() if self.is_damped else None
        growth = torch.full_like(cost, _GROWTH).detach()
        done = cost.detach() == 0
        iterations = torch.zeros_like(done, dtype=torch.int64)
        for _ in range(self.max_iterations):
            if _check.values_are_readable(done) and bool((done | ~is_valid).all()):
                break
            step, predicted, is_stationary = self._step(x, cost, damping)
            step = torch.where(done[:, None] | ~step.isfinite(), 0, step)
            candidate = problem.layout.retracted(x, step)
            new_cost = problem.cost(candidate)
            with torch.no_grad():
                # Near the minimum the cost is flat to its rounding, and the step knows better.
                is_better = new_cost <= cost + 8 * eps * cost
                accepted = ~done & (is_better if self.is_damped else new_cost.isfinite()) & predicted.isfinite()
                is_small = step.norm(dim=-1) <= max(self.xtol, 4 * eps) * (self.xtol + _size(x))
                flat = predicted <= max(self.ftol, eps) * cost
                reached = predicted.isfinite() & (is_small | flat | is_stationary)
                iterations += (~done & is_valid).long()
                if damping is not None:
                    ratio = (cost - new_cost) / predicted
                    shrunk = damping * (1 - (2 * ratio - 1) ** 3).clamp(1 / 9, 1)
                    damping = torch.where(accepted, shrunk, damping * growth).clamp(1e-15, 1e15)
                    growth = torch.where(accepted, _GROWTH, _GROWTH * growth).clamp(max=1e6)
            x = chosen(accepted, candidate, x)
            cost = torch.where(accepted, new_cost, cost)
            done = done | reached
            del step, candidate  # before the next Jacobian takes memory
        return chosen(is_valid, x, torch.nan), torch.where(is_valid, cost, torch.nan), done & is_valid, iterations

    def _step(self, x: Variables, cost: Tensor, damping: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """The next step, the decrease of the cost that it predicts, and whether the residuals are orthogonal to all columns of
        the Jacobian, up to `gtol`."""
        assembly = self.assembly
        model = self.problem.gauss_newton(*self.problem.linearized(x))
        slope, norms = assembly.vector(model.gradient), assembly.vector(model.column_norms)
        equations = assembly.equations(model)
        del model  # whose Jacobian takes the most memory
        added = None if damping is None else torch.where(norms == 0, 1, damping[:, None] * norms)
        step, predicted = assembly.solve(equations, slope, added)
        with torch.no_grad():
            is_stationary = (slope.abs() <= self.gtol * norms.sqrt() * (2 * cost).sqrt()[:, None]).all(-1)
        return step, predicted, is_stationary


def _size(variables: Variables) -> Tensor:
    """The lengths (B,) of all numbers of the variables."""
    return (
        torch.stack([t[..., None].flatten(1).square().sum(-1) for x in variables.values() for t in tensors_of(x)])
        .sum(0)
        .sqrt()
    )
