"""Normal equations of problems whose blocks of residuals see a few elements each: assembly, and solving them densely or by a
Schur complement.

A Hessian comes as a function `product(a, b)` of two references: the derivatives (B, N, da, db) of every block of residuals, or
their sum (B, da, db) where neither reference has an index. Gauss-Newton's and the exact Hessian are solved alike.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from kvision.geometry.optim._variables import Layout, Reference

Product = Callable[[Reference, Reference], Tensor]


class _SumByKey:
    """Sums of x (B, N, *) over the rows of equal keys (N,), (B, count, *), in the order of the rows: the same bits every run."""

    def __init__(self, keys: Tensor, count: int) -> None:
        self.keys, self.count = keys, count
        if keys.is_cuda:  # where index_add is not deterministic
            ordered, self.order = keys.sort(stable=True)
            self.offsets = torch.searchsorted(ordered, torch.arange(count + 1, device=keys.device))

    def __call__(self, x: Tensor) -> Tensor:
        if not x.is_cuda:
            return x.new_zeros(x.shape[0], self.count, *x.shape[2:]).index_add(1, self.keys, x)
        rows = x.transpose(0, 1).index_select(0, self.order)
        sums = torch.segment_reduce(rows.flatten(1), "sum", offsets=self.offsets, axis=0, unsafe=True, initial=0)
        return sums.unflatten(1, (x.shape[0], *x.shape[2:])).transpose(0, 1)


class Step(NamedTuple):
    """Steps (B, D) and the decrease of the cost (B,) that the quadratic model predicts; both NaN without a solution."""

    step: Tensor
    predicted: Tensor


class Assembly:
    """How the products of references add up; made once for all iterations.

    Args:
        layout: the unknowns.
        eliminate: the variable whose elements no block of residuals sees two of, so that the rest is solved first, by the
            Schur complement; None for one dense system.
    """

    _CHUNK = 1 << 14  # pairs of blocks that are multiplied at once

    def __init__(self, layout: Layout, eliminate: str | None) -> None:
        self.layout = layout
        self.eliminated = next((r for r in layout.references if r.name == eliminate), None)
        self.kept = [r for r in layout.references if r.name != eliminate]
        self._sums: dict[tuple[int, ...], _SumByKey] = {}
        part = layout.slices[eliminate] if eliminate is not None else slice(layout.size, layout.size)
        self._removed = part
        self._width = part.stop - part.start
        e = self.eliminated
        if e is not None and any(r.index is not None for r in self.kept):
            assert e.index is not None
            self._first, self._second = _pairs(e.index)

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

    def _sum(self, x: Tensor, *references: Reference) -> Tensor:
        """Sums (B, counts, *) of x (B, N, *) over the elements that blocks see, or pairs of elements."""
        indexed = [r for r in references if r.index is not None]
        if not indexed:
            return x.sum(1, keepdim=True)
        key = tuple(self.layout.references.index(r) for r in references)
        if key not in self._sums:
            keys: Tensor | int = 0
            for r in references:
                keys = keys * r.count + (0 if r.index is None else r.index)
            assert isinstance(keys, Tensor)
            self._sums[key] = _SumByKey(keys, _count(*references))
        return self._sums[key](x)

    def _add(self, matrix: Tensor, a: Reference, b: Reference, blocks: Tensor) -> None:
        """Add blocks (B, counts, da, db) to the rows of `a` and the columns of `b`."""
        full = blocks.unflatten(1, (a.count, b.count)).transpose(2, 3).flatten(3, 4).flatten(1, 2)
        matrix[:, self._of_kept(a), self._of_kept(b)] += full

    def matrix(self, product: Product) -> Tensor:
        """The Hessian of the kept variables."""
        size = self.layout.size - self._width
        result: Tensor | None = None
        for i, a in enumerate(self.kept):
            for b in self.kept[i:]:
                x = product(a, b)
                blocks = x[:, None] if a.index is None and b.index is None else self._sum(x, a, b)
                if result is None:
                    result = blocks.new_zeros(blocks.shape[0], size, size)
                self._add(result, a, b, blocks)
                if a is not b:
                    self._add(result, b, a, _swapped(blocks, a, b))
        assert result is not None
        return result

    def vector(self, parts: Callable[[Reference], Tensor]) -> Tensor:
        """The gradient (B, D) of its parts, (B, N, d) of a reference with an index, else their sum (B, d)."""
        result: Tensor | None = None
        for r in self.layout.references:
            x = parts(r)
            if result is None:
                result = x.new_zeros(x.shape[0], self.layout.size)
            sums = x if r.index is None else self._sum(x, r).flatten(1)
            result[:, r.offset : r.offset + r.count * r.size] += sums
        assert result is not None
        return result

    # --- solving -----------------------------------------------------------------------------------------------------

    def solve(self, product: Product, gradient: Tensor, damping: Tensor | None, positive: bool = True) -> Step:
        """Solve (H + diag(damping)) step = -gradient; `positive` for a positive definite H.

        Without damping (B, D) unknowns that no residual depends on do not move.
        """
        if self.eliminated is None:
            H = self.matrix(product)
            damping = _damping(H) if damping is None else damping
            step = _solve(H + torch.diag_embed(damping), -gradient, positive)
        else:
            step, damping = self._solve_schur(self.eliminated, product, gradient, damping, positive)
        return Step(step, 0.5 * (step * (damping * step - gradient)).sum(-1))

    def _solve_schur(
        self, e: Reference, product: Product, gradient: Tensor, damping: Tensor | None, positive: bool
    ) -> tuple[Tensor, Tensor]:
        H, coupling, inverse, damping = self._reduced(e, product, damping)
        to_kept, to_e = self._split(gradient, e)
        to_e = to_e[..., None]
        solved = inverse @ to_e
        rhs = -to_kept
        for r, W in coupling:
            y = W @ (solved if r.index is None else _rows(solved, e))
            rhs[:, self._of_kept(r)] += (y.sum(1) if r.index is None else self._sum(y, r)).flatten(1)
        kept = _solve(H, rhs, positive)
        rest = to_e
        for r, W in coupling:
            x = kept[:, self._of_kept(r)].unflatten(1, (r.count, r.size))[..., None]
            rest = rest + (W.mT @ x if r.index is None else self._sum(W.mT @ _rows(x, r), e))
        step_e = -(inverse @ rest).flatten(1)
        return self._joined(kept, step_e), damping

    def _split(self, x: Tensor, e: Reference) -> tuple[Tensor, Tensor]:
        """The parts of x (B, D) of the kept variables (B, C) and of the eliminated ones (B, K, d)."""
        kept = torch.cat([x[:, : self._removed.start], x[:, self._removed.stop :]], 1)
        return kept, x[:, self._removed].unflatten(1, (e.count, e.size))

    def _joined(self, kept: Tensor, eliminated: Tensor) -> Tensor:
        start = self._removed.start
        return torch.cat([kept[:, :start], eliminated.flatten(1), kept[:, start:]], 1)

    def _reduced(
        self, e: Reference, product: Product, damping: Tensor | None
    ) -> tuple[Tensor, list[tuple[Reference, Tensor]], Tensor, Tensor]:
        """The Schur complement of the eliminated blocks, the couplings to them, their inverses and the damping of both."""
        H = self.matrix(product)
        own = self._sum(product(e, e), e)
        damping = self._joined(_damping(H), _damping(own)) if damping is None else damping
        of_kept, of_e = self._split(damping, e)
        inverse = torch.linalg.inv_ex(own + torch.diag_embed(of_e)).inverse
        # A reference without an index couples with element k once, others once for each block of residuals.
        coupling = [(r, self._sum(x, e) if r.index is None else x) for r in self.kept for x in [product(r, e)]]
        H = H + torch.diag_embed(of_kept)
        self._subtract_complement(H, e, coupling, inverse)
        return H, coupling, inverse, damping

    def _subtract_complement(
        self, H: Tensor, e: Reference, coupling: list[tuple[Reference, Tensor]], inverse: Tensor
    ) -> None:
        between = torch.zeros_like(H) if any(r.index is not None for r, _ in coupling) else None
        for a, Wa in coupling:
            scaled = -Wa @ (inverse if a.index is None else _rows(inverse, e))
            for b, Wb in coupling:
                if a.index is None and b.index is None:
                    self._add(H, a, b, (scaled @ Wb.mT).sum(1, keepdim=True))
                elif a.index is None or b.index is None:
                    left = _rows(scaled, e) if a.index is None else scaled
                    right = _rows(Wb, e) if b.index is None else Wb
                    self._add(H, a, b, self._sum(left @ right.mT, a, b))
                else:
                    self._add(H, a, b, self._sum(scaled @ Wb.mT, a, b))
                    assert between is not None
                    self._add_pairs(between, a, b, scaled, Wb)
        if between is not None:
            H += between + between.mT

    def _add_pairs(self, matrix: Tensor, a: Reference, b: Reference, scaled: Tensor, W: Tensor) -> None:
        """Add the products of different blocks of residuals that see one eliminated element, each pair in one order."""
        assert a.index is not None and b.index is not None
        total: Tensor | None = None
        for i, j in zip(self._first.split(self._CHUNK), self._second.split(self._CHUNK)):
            blocks = scaled.index_select(1, i) @ W.index_select(1, j).mT
            keys = a.index[i] * b.count + b.index[j]
            sums = _SumByKey(keys, a.count * b.count)(blocks)
            total = sums if total is None else total + sums
        if total is not None:
            self._add(matrix, a, b, total)

    def information(self, product: Product) -> Tensor:
        """The Hessian of the kept variables after the eliminated ones are minimized over; its inverse is their covariance."""
        if self.eliminated is None:
            return self.matrix(product)
        H, _, _, damping = self._reduced(self.eliminated, product, None)
        return H - torch.diag_embed(self._split(damping, self.eliminated)[0])


def _rows(x: Tensor, r: Reference) -> Tensor:
    """The elements (B, N, *) of x (B, count, *) that blocks of residuals see."""
    return x if r.index is None else x.index_select(1, r.index)


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


def _pairs(keys: Tensor) -> tuple[Tensor, Tensor]:
    """All pairs of different rows with equal keys (N,), one order of each."""
    ordered, order = keys.sort(stable=True)
    rows = torch.arange(len(keys), device=keys.device)
    before = rows - torch.searchsorted(ordered, ordered)  # rows of the same key that come first
    second = torch.repeat_interleave(rows, before)
    starts = before.cumsum(0) - before
    first = torch.arange(len(second), device=keys.device) - starts[second] + (rows - before)[second]
    return order[first].int(), order[second].int()
