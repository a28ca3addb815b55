"""Derivatives of residuals with respect to steps of the variables that they see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from kvision.core.exceptions import ShapeError
from kvision.geometry.optim._losses import Loss, with_derivatives
from kvision.geometry.optim._normal_equations import Hessian, Slope
from kvision.geometry.optim._variables import Layout, Reference, Variables, moving_tensors, moving_value, tensors_of
from kvision.geometry.optim.group_products import Groups

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

    def linearized(self, variables: Variables) -> tuple[Tensor, dict[str, Tensor]]:
        """Residuals (B, N, n) and their Jacobians (B, N, n, t) by variable."""
        seen = self.layout.seen(variables)
        if self.jacobian is not None:
            r, parts = self.jacobian(seen)
            r = self._checked(r, seen)
            J = {name: self._checked_jacobian(name, parts[name], r) for name in seen}
        else:
            moving = {name: moving_tensors(x) for name, x in seen.items()}

            def of_tensors(moving: Mapping[str, tuple[Tensor, ...]]) -> Tensor:
                return self.blocks({name: moving_value(x, moving[name]) for name, x in seen.items()})

            def along(velocities: Mapping[str, tuple[Tensor, ...]]) -> Any:
                return torch.func.jvp(of_tensors, (moving,), (velocities,))

            outputs: Any = (None, -1)  # residuals do not depend on the direction
            r, columns = torch.func.vmap(along, out_dims=outputs)(self.layout.velocities(seen, moving))
            J = dict(zip(seen, columns.split([shape[-1] for shape in self.layout.shapes.values()], -1)))
        if self.weights is not None:
            counts = self.weights[..., None, None] > 0
            J = {name: torch.where(counts, part, 0) for name, part in J.items()}
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

    def gauss_newton(self, r: Tensor, J: dict[str, Tensor]) -> GaussNewton:
        """The gradient and Gauss-Newton's Hessian, of residuals and their Jacobians."""
        return GaussNewton(r, J, *self.slopes(r))

    # --- exact derivatives -------------------------------------------------------------------------------------------

    def _slopes(self, variables: Variables, steps: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The gradients of all costs with respect to steps of what residuals see."""
        seen = self.layout.seen(variables)

        def total(steps: Mapping[str, Tensor]) -> Tensor:
            return self.cost_of(self.blocks(self.layout.moved(seen, steps))).sum()

        slopes: dict[str, Tensor] = torch.func.grad(total)(steps)
        return slopes

    def gradient(self, variables: Variables) -> Slope:
        """The gradient by reference, differentiable with respect to everything that residuals depend on."""
        slopes = self._slopes(variables, self.layout.zeros(self.layout.seen(variables)))

        def slope(a: Reference, groups: Groups | None) -> Tensor:
            x = slopes[a.name][..., a.within]
            return x[:, None] if groups is None else groups(x)

        return slope

    def hessian(self, variables: Variables) -> Hessian:
        """The exact Hessian by two references."""
        seen = self.layout.seen(variables)
        zeros, directions = self.layout.zeros(seen), self.layout.directions(seen)

        def along(direction: Mapping[str, Tensor]) -> dict[str, Tensor]:
            tangents = {name: d.expand(zeros[name].shape) for name, d in direction.items()}
            derivative: dict[str, Tensor] = torch.func.jvp(lambda d: self._slopes(variables, d), (zeros,), (tangents,))[
                1
            ]
            return derivative

        return _Exact(torch.func.vmap(along)(directions))


class GaussNewton:
    """The gradient and the Hessian J^T (rho' + 2 rho'' r r^T) J of blocks of residuals, by reference.

    Where the curvature along r is negative, it counts as 0.

    Args:
        r: residuals (B, N, n).
        J: their Jacobians (B, N, n, t) by variable.
        slope, bend: weight * rho' (B, N) and the factor of r r^T; None for 1 and for 0.
    """

    def __init__(self, r: Tensor, J: dict[str, Tensor], slope: Tensor | None, bend: Tensor | None) -> None:
        self.r, self.J, self.slope, self.bend = r, J, slope, bend
        self.weighted_r = (r if slope is None else slope[..., None] * r)[..., None]

    def _weighted(self, J: Tensor) -> Tensor:
        slope, bend, r = self.slope, self.bend, self.r
        if bend is None:
            return J if slope is None else slope[..., None, None] * J
        assert slope is not None
        if r.shape[-1] == 1:
            return (slope + bend * r[..., 0].square())[..., None, None] * J
        return slope[..., None, None] * J + (bend[..., None] * r)[..., None] * (r[..., None, :] @ J)

    def _part(self, a: Reference) -> Tensor:
        return self.J[a.name][..., a.within]

    def gradient(self, a: Reference, groups: Groups | None) -> Tensor:
        return _sums(self._part(a), self.weighted_r, groups)[..., 0]

    def column_norms(self, a: Reference, groups: Groups | None) -> Tensor:
        """The squared norms of the columns of the weighted Jacobian, which scale the damping.

        Unlike the diagonal of the Hessian they do not vanish where a robust kernel has no curvature.
        """
        squares = self._part(a).square().sum(-2)
        squares = squares if self.slope is None else self.slope[..., None] * squares
        return squares.sum(1, keepdim=True) if groups is None else groups(squares)

    def blocks(self, a: Reference, b: Reference) -> Tensor:
        return self._part(a).mT @ self._weighted(self._part(b))

    def sums(self, a: Reference, b: Reference, groups: Groups | None) -> Tensor:
        return _sums(self._part(a), self._weighted(self._part(b)), groups)


class _Exact:
    """Second derivatives of the costs: of the slopes of all variables along steps of all columns."""

    def __init__(self, second: dict[str, Tensor]) -> None:
        self.second = second

    def blocks(self, a: Reference, b: Reference) -> Tensor:
        if a.index is None and b.index is not None:  # a step of a sees each block of b; the reverse sees their sum
            return self.second[b.name][a.columns][..., b.within].movedim(0, -2)
        return self.second[a.name][b.columns][..., a.within].movedim(0, -1)

    def sums(self, a: Reference, b: Reference, groups: Groups | None) -> Tensor:
        x = self.blocks(a, b)
        return x[:, None] if groups is None else groups(x)


def _sums(left: Tensor, right: Tensor, groups: Groups | None) -> Tensor:
    """Sums of left^T right by groups, or of all rows as one group."""
    if groups is None:
        return (left.flatten(1, 2).mT @ right.flatten(1, 2))[:, None]
    return groups.products(left, right)
