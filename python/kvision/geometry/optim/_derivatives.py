"""Derivatives of residuals with respect to steps of the variables that they see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from kvision.core.exceptions import ShapeError
from kvision.geometry.optim._losses import Loss, with_derivatives
from kvision.geometry.optim._normal_equations import Product
from kvision.geometry.optim._variables import Layout, Reference, Variables, tensors_of

Residuals = Callable[[Variables], Tensor]
WithJacobian = Callable[[Variables], tuple[Tensor, Mapping[str, Tensor]]]


class Problem:
    """Residuals (B, N, n) of variables, their weights (B, N) and robust kernel, and the cost 1/2 sum of weight rho(|r|^2)."""

    def __init__(
        self,
        op: str,
        residuals: Residuals,
        layout: Layout,
        weights: Tensor | None,
        rho: Loss | None,
        jacobian: WithJacobian | None,
    ) -> None:
        self.op, self.residuals, self.layout = op, residuals, layout
        self.weights, self.rho, self.jacobian = weights, rho, jacobian

    def blocks(self, seen: Variables) -> Tensor:
        """The residuals (B, N, n); 0 where their weight is."""
        return self._checked(self.residuals(seen), seen)

    def _checked(self, r: Any, seen: Variables) -> Tensor:
        batch = tensors_of(next(iter(seen.values())))[0].shape[0]
        if not isinstance(r, Tensor) or r.dim() not in (2, 3) or r.shape[0] != batch:
            got = tuple(r.shape) if isinstance(r, Tensor) else type(r).__name__
            raise ShapeError(f"{self.op}: expected residuals of shape ({batch}, N) or ({batch}, N, n), got {got}")
        r = r[..., None] if r.dim() == 2 else r
        for i in self.layout.index.values():
            if i.shape[0] != r.shape[1]:
                raise ShapeError(
                    f"{self.op}: expected residuals of as many blocks as the index has rows, {i.shape[0]}, got {tuple(r.shape)}"
                )
        if self.weights is None:
            return r
        if self.weights.shape != r.shape[:2]:
            raise ShapeError(
                f"{self.op}: expected weights of shape {tuple(r.shape[:2])}, got {tuple(self.weights.shape)}"
            )
        return torch.where(self.weights[..., None] > 0, r, 0)

    def cost_of(self, r: Tensor) -> Tensor:
        """The costs (B,) of residuals (B, N, n)."""
        s = r.square().sum(-1)
        s = s if self.rho is None else self.rho(s)
        return 0.5 * (s if self.weights is None else torch.where(self.weights > 0, self.weights * s, 0)).sum(-1)

    def cost(self, variables: Variables) -> Tensor:
        return self.cost_of(self.blocks(self.layout.seen(variables)))

    # --- Gauss-Newton ------------------------------------------------------------------------------------------------

    def linearized(self, variables: Variables) -> tuple[Tensor, Tensor]:
        """Residuals (B, N, n) and their Jacobian (B, N, n, T)."""
        seen = self.layout.seen(variables)
        if self.jacobian is not None:
            r, parts = self.jacobian(seen)
            r = self._checked(r, seen)
            J = torch.cat([self._checked_jacobian(name, parts[name], r) for name in seen], -1)
        else:
            r = self.blocks(seen)
            zeros = self.layout.zeros(seen)

            def moved(steps: Mapping[str, Tensor]) -> Tensor:
                return self.blocks(self.layout.moved(seen, steps))

            def along(direction: Mapping[str, Tensor]) -> Tensor:
                tangents = {name: d.expand(zeros[name].shape) for name, d in direction.items()}
                derivative: Tensor = torch.func.jvp(moved, (zeros,), (tangents,))[1]
                return derivative

            J = torch.func.vmap(along)(self.layout.directions(seen)).movedim(0, -1)
        if self.weights is not None:
            J = torch.where(self.weights[..., None, None] > 0, J, 0)
        return r, J

    def _checked_jacobian(self, name: str, J: Tensor, r: Tensor) -> Tensor:
        J = J[:, :, None] if J.dim() == 3 else J
        expected = (*r.shape, self.layout.shapes[name][-1])
        if J.shape != expected:
            raise ShapeError(f"{self.op}: expected the Jacobian of {name} of shape {expected}, got {tuple(J.shape)}")
        return J

    def slopes(self, r: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """weight * rho' (B, N) and the factor of r r^T in the Hessian with respect to a block; None for 1 and for 0."""
        if self.rho is None:
            return self.weights, None
        s = r.square().sum(-1)
        slope, bend = with_derivatives(self.rho, s)
        bend = torch.where(s > 0, torch.maximum(2 * bend, -slope / torch.where(s > 0, s, 1)), 2 * bend)
        return (slope, bend) if self.weights is None else (self.weights * slope, self.weights * bend)

    def gauss_newton(self, r: Tensor, J: Tensor) -> tuple[Callable[[Reference], Tensor], Product]:
        """The gradient by reference and Gauss-Newton's Hessian by two, of residuals and their Jacobian.

        With a robust kernel a block's Hessian is J^T (rho' + 2 rho'' r r^T) J, without curvature along r where that is negative.
        """
        slope, bend = self.slopes(r)
        weighted_r = r if slope is None else slope[..., None] * r

        def weighted(J: Tensor) -> Tensor:
            if bend is None:
                return J if slope is None else slope[..., None, None] * J
            assert slope is not None
            if r.shape[-1] == 1:
                return (slope + bend * r[..., 0].square())[..., None, None] * J
            return slope[..., None, None] * J + (bend[..., None] * r)[..., None] * (r[..., None, :] @ J)

        def gradient(a: Reference) -> Tensor:
            columns = J[..., a.columns]
            if a.index is None:
                return (columns.flatten(1, 2).mT @ weighted_r.flatten(1)[..., None])[..., 0]
            return (columns.mT @ weighted_r[..., None])[..., 0]

        def product(a: Reference, b: Reference) -> Tensor:
            left, right = J[..., a.columns], weighted(J[..., b.columns])
            if a.index is None and b.index is None:
                return left.flatten(1, 2).mT @ right.flatten(1, 2)
            return left.mT @ right

        return gradient, product

    def column_norms(self, r: Tensor, J: Tensor) -> Callable[[Reference], Tensor]:
        """The squared norms of the columns of the weighted Jacobian by reference, which scale the damping.

        Unlike the diagonal of the Hessian they do not vanish where a robust kernel has no curvature.
        """
        slope, squares = self.slopes(r)[0], J.square().sum(-2)
        squares = squares if slope is None else slope[..., None] * squares
        return lambda a: squares[..., a.columns].sum(1) if a.index is None else squares[..., a.columns]

    # --- exact derivatives -------------------------------------------------------------------------------------------

    def _slopes(self, variables: Variables, steps: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The gradients of all costs with respect to steps of what residuals see."""
        seen = self.layout.seen(variables)

        def total(steps: Mapping[str, Tensor]) -> Tensor:
            return self.cost_of(self.blocks(self.layout.moved(seen, steps))).sum()

        slopes: dict[str, Tensor] = torch.func.grad(total)(steps)
        return slopes

    def gradient(self, variables: Variables) -> Callable[[Reference], Tensor]:
        """The gradient by reference, differentiable with respect to everything that residuals depend on."""
        slopes = self._slopes(variables, self.layout.zeros(self.layout.seen(variables)))
        return lambda a: slopes[a.name][..., self._within(a)]

    def hessian(self, variables: Variables) -> Product:
        """The exact Hessian by two references."""
        seen = self.layout.seen(variables)
        zeros, directions = self.layout.zeros(seen), self.layout.directions(seen)

        def along(direction: Mapping[str, Tensor]) -> dict[str, Tensor]:
            tangents = {name: d.expand(zeros[name].shape) for name, d in direction.items()}
            derivative: dict[str, Tensor] = torch.func.jvp(lambda d: self._slopes(variables, d), (zeros,), (tangents,))[
                1
            ]
            return derivative

        second = torch.func.vmap(along)(directions)

        def product(a: Reference, b: Reference) -> Tensor:
            if a.index is None and b.index is not None:  # a step of a sees each block of b; the reverse sees their sum
                return second[b.name][a.columns][..., self._within(b)].movedim(0, -2)
            return second[a.name][b.columns][..., self._within(a)].movedim(0, -1)

        return product

    def _within(self, a: Reference) -> slice:
        """The columns of a reference among those of its variable."""
        start = next(r.columns.start for r in self.layout.references if r.name == a.name)
        return slice(a.columns.start - start, a.columns.stop - start)
