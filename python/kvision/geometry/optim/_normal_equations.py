"""Normal equations of problems whose blocks of residuals see a few elements each: assembly, and solving them densely or by a
Schur complement. Gauss-Newton's and the exact Hessian are solved alike.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from kvision.geometry.optim._variables import Layout, Reference
from kvision.geometry.optim.group_products import Groups, Pairs


class Slope(Protocol):
    """The gradient by reference: sums (B, count, d) by the groups of its elements, of one group where it has no index."""

    def __call__(self, a: Reference, groups: Groups | None) -> Tensor: ...


class Hessian(Protocol):
    """The Hessian by two references."""

    def blocks(self, a: Reference, b: Reference) -> Tensor:
        """The derivatives (B, N, da, db) of every block of residuals; one of the references has an index."""

    def sums(self, a: Reference, b: Reference, groups: Groups | None) -> Tensor:
        """Sums (B, count, da, db) of the blocks by groups; of all of them, (B, 1, da, db), if neither has an index."""


class Step(NamedTuple):
    """Steps (B, D) and the decrease of the cost (B,) that the quadratic model predicts; both NaN without a solution."""

    step: Tensor
    predicted: Tensor


class Equations(NamedTuple):
    """The normal equations, for which the blocks of residuals are no longer needed.

    The Hessian of the kept variables, and with eliminated ones their blocks (B, K, d, d) and the couplings of each kept reference
    to them: (B, K, dr, d), once for each element, where it has no index, else (B, N, dr, d).
    """

    kept: Tensor
    own: Tensor | None
    coupling: list[tuple[Reference, Tensor]]


class Assembly:
    """How the products of references add up; made once for all iterations.

    Args:
        layout: the unknowns.
        eliminate: the variable whose elements no block of residuals sees two of, so that the rest is solved first, by the
            Schur complement; None for one dense system.
    """

    def __init__(self, layout: Layout, eliminate: str | None) -> None:
        self.layout = layout
        self.eliminated = next((r for r in layout.references if r.name == eliminate), None)
        self.kept = [r for r in layout.references if r.name != eliminate]
        self._groups: dict[tuple[int, ...], Groups] = {}
        self._shared: dict[tuple[int, ...], Pairs] = {}
        part = layout.slices[eliminate] if eliminate is not None else slice(layout.size, layout.size)
        self._removed = part
        self._width = part.stop - part.start

    def prepare(self) -> None:
        """Find the pairs of rows of the Schur complement, before the first iteration takes memory."""
        if self.eliminated is not None:
            for i, a in enumerate(self.kept):
                for b in self.kept[i:]:
                    self._pairs_of(a, b)

    @property
    def columns(self) -> dict[str, slice]:
        """The unknowns of each kept variable among those of all kept ones."""
        slices = self.layout.slices
        before = self._removed.start
        return {
            name: s if s.start < before or not self._width else slice(s.start - self._width, s.stop - self._width)
            for name, s in slices.items()
            if s != self._removed or not self._width
        }

    # --- vectors and matrices of the kept variables ------------------------------------------------------------------

    def _of_kept(self, r: Reference) -> slice:
        start = r.offset - (self._width if r.offset > self._removed.start else 0)
        return slice(start, start + r.count * r.size)

    def _groups_of(self, *references: Reference) -> Groups | None:
        """Blocks of residuals by the elements that they see, or by pairs of elements; None where there is no index."""
        if all(r.index is None for r in references):
            return None
        key = tuple(self.layout.references.index(r) for r in references)
        if key not in self._groups:
            self._groups[key] = Groups(_keys(*references), _count(*references))
        return self._groups[key]

    def _pairs_of(self, a: Reference, b: Reference) -> Pairs:
        """The rows of couplings of `a` and `b` that share an eliminated element; of one reference with an index, different rows."""
        key = tuple(self.layout.references.index(r) for r in (a, b))
        if key not in self._shared:
            e = self.eliminated
            assert e is not None and e.index is not None
            every = torch.arange(e.count, device=e.index.device)
            left, right = (every if r.index is None else e.index for r in (a, b))
            different = a is b and a.index is not None
            self._shared[key] = Pairs(left, None if different else right, a.index, b.index, a.count, b.count)
        return self._shared[key]

    def _add(self, matrix: Tensor, a: Reference, b: Reference, blocks: Tensor) -> None:
        """Add blocks (B, counts, da, db) to the rows of `a` and the columns of `b`."""
        full = blocks.unflatten(1, (a.count, b.count)).transpose(2, 3).flatten(3, 4).flatten(1, 2)
        matrix[:, self._of_kept(a), self._of_kept(b)] += full

    def _add_diagonal(self, matrix: Tensor, a: Reference, blocks: Tensor) -> None:
        """Add blocks (B, count, da, da) to the diagonal of `a`."""
        part = matrix[:, self._of_kept(a), self._of_kept(a)].unflatten(1, (a.count, a.size))
        part.unflatten(3, (a.count, a.size)).diagonal(dim1=1, dim2=3).add_(blocks.movedim(1, -1))

    def matrix(self, hessian: Hessian) -> Tensor:
        """The Hessian of the kept variables."""
        size = self.layout.size - self._width
        result: Tensor | None = None
        for i, a in enumerate(self.kept):
            for b in self.kept[i:]:
                # A block of residuals sees one element of a reference, so those of the same one have a block diagonal.
                blocks = hessian.sums(a, b, self._groups_of(a) if a is b else self._groups_of(a, b))
                if result is None:
                    result = blocks.new_zeros(blocks.shape[0], size, size)
                if a is b:
                    self._add_diagonal(result, a, blocks)
                else:
                    self._add(result, a, b, blocks)
                    self._add(result, b, a, _swapped(blocks, a, b))
        assert result is not None
        return result

    def vector(self, slope: Slope) -> Tensor:
        """The gradient (B, D) of its parts."""
        result: Tensor | None = None
        for r in self.layout.references:
            x = slope(r, self._groups_of(r)).flatten(1)
            if result is None:
                result = x.new_zeros(x.shape[0], self.layout.size)
            result[:, r.offset : r.offset + r.count * r.size] += x
        assert result is not None
        return result

    # --- solving -----------------------------------------------------------------------------------------------------

    def equations(self, hessian: Hessian) -> Equations:
        """The normal equations of a Hessian."""
        H, e = self.matrix(hessian), self.eliminated
        if e is None:
            return Equations(H, None, [])
        by_element = self._groups_of(e)
        return Equations(
            H,
            hessian.sums(e, e, by_element),
            [(r, hessian.sums(r, e, by_element) if r.index is None else hessian.blocks(r, e)) for r in self.kept],
        )

    def solve(self, equations: Equations, gradient: Tensor, damping: Tensor | None, positive: bool = True) -> Step:
        """Solve (H + diag(damping)) step = -gradient; `positive` for a positive definite H.

        Without damping (B, D) unknowns that no residual depends on do not move.
        """
        if self.eliminated is None:
            H = equations.kept
            damping = _damping(H) if damping is None else damping
            step = _solve(H + torch.diag_embed(damping), -gradient, positive)
        else:
            step, damping = self._solve_schur(self.eliminated, equations, gradient, damping, positive)
        return Step(step, 0.5 * (step * (damping * step - gradient)).sum(-1))

    def _solve_schur(
        self, e: Reference, equations: Equations, gradient: Tensor, damping: Tensor | None, positive: bool
    ) -> tuple[Tensor, Tensor]:
        H, inverse, damping = self._reduced(e, equations, damping)
        coupling = equations.coupling
        to_kept, to_e = self._split(gradient, e)
        to_e = to_e[..., None]
        solved = inverse @ to_e
        rhs = -to_kept
        for r, W in coupling:
            groups = self._groups_of(r)
            y = (W @ solved).sum(1) if groups is None else groups.products(W.mT, solved, e.index)
            rhs[:, self._of_kept(r)] += y.flatten(1)
        kept = _solve(H, rhs, positive)
        rest = to_e
        by_element = self._groups_of(e)
        assert by_element is not None
        for r, W in coupling:
            x = kept[:, self._of_kept(r)].unflatten(1, (r.count, r.size))[..., None]
            rest = rest + (W.mT @ x if r.index is None else by_element.products(W, x, r.index))
        step_e = -(inverse @ rest).flatten(1)
        return self._joined(kept, step_e), damping

    def _split(self, x: Tensor, e: Reference) -> tuple[Tensor, Tensor]:
        """The parts of x (B, D) of the kept variables (B, C) and of the eliminated ones (B, K, d)."""
        kept = torch.cat([x[:, : self._removed.start], x[:, self._removed.stop :]], 1)
        return kept, x[:, self._removed].unflatten(1, (e.count, e.size))

    def _joined(self, kept: Tensor, eliminated: Tensor) -> Tensor:
        start = self._removed.start
        return torch.cat([kept[:, :start], eliminated.flatten(1), kept[:, start:]], 1)

    def _reduced(self, e: Reference, equations: Equations, damping: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """The Schur complement of the eliminated blocks, their inverses and the damping of all unknowns."""
        H, own, coupling = equations
        assert own is not None
        damping = self._joined(_damping(H), _damping(own)) if damping is None else damping
        of_kept, of_e = self._split(damping, e)
        inverse = torch.linalg.inv_ex(own + torch.diag_embed(of_e)).inverse
        H, minus = H + torch.diag_embed(of_kept), -inverse
        for i, (a, W) in enumerate(coupling):
            for b, other in coupling[i:]:
                blocks = self._pairs_of(a, b).products(W, minus, other)
                groups = self._groups_of(a)
                self._add(H, a, b, blocks)
                if a is not b or groups is not None:
                    self._add(H, b, a, _swapped(blocks, a, b))
                if a is b and groups is not None:
                    assert e.index is not None
                    self._add_diagonal(H, a, groups.squares(W, minus, e.index))
        return H, inverse, damping

    def information(self, equations: Equations) -> Tensor:
        """The Hessian of the kept variables after the eliminated ones are minimized over; its inverse is their covariance."""
        if self.eliminated is None:
            return equations.kept
        H, _, damping = self._reduced(self.eliminated, equations, None)
        return H - torch.diag_embed(self._split(damping, self.eliminated)[0])


def _keys(*references: Reference) -> Tensor:
    """The numbers (N,) of the elements that blocks of residuals see, or of pairs of elements."""
    keys: Tensor | int = 0
    for r in references:
        keys = keys * r.count + (0 if r.index is None else r.index)
    assert isinstance(keys, Tensor)
    return keys


def _count(*references: Reference) -> int:
    return torch.Size(r.count for r in references).numel()


def _swapped(blocks: Tensor, a: Reference, b: Reference) -> Tensor:
    return blocks.unflatten(1, (a.count, b.count)).transpose(1, 2).flatten(1, 2).mT


def _damping(H: Tensor) -> Tensor:
    """What makes the matrix of unknowns on which nothing depends regular: 1 where the diagonal is 0."""
    diagonal = H.diagonal(dim1=-2, dim2=-1)
    return (diagonal == 0).to(diagonal.dtype)


def _solve(H: Tensor, rhs: Tensor, positive: bool) -> Tensor:
    """Solutions (B, D), NaN where H is singular, or not positive definite if it should be."""
    if positive:
        L, info = torch.linalg.cholesky_ex(H)
        x = torch.cholesky_solve(rhs[..., None], L)
    else:
        x, info = torch.linalg.solve_ex(H, rhs[..., None])
    return torch.where(info[:, None] == 0, x[..., 0], torch.nan)
