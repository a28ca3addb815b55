"""Sums of products of small matrices by group, of which normal equations are made."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._ops import register


def _reference(
    left: Tensor,
    right: Tensor,
    left_rows: Tensor,
    right_rows: Tensor,
    offsets: Tensor,
    middle: Tensor | None,
    middle_rows: Tensor | None,
) -> Tensor:
    i, j = left_rows[0].long(), right_rows[0].long()
    factor = right.index_select(1, j)
    if middle is not None:
        assert middle_rows is not None
        factor = middle.index_select(1, middle_rows[0].index_select(0, i).long()) @ factor
    products = left.index_select(1, i).mT @ factor
    group = torch.searchsorted(offsets[0], torch.arange(len(i), device=i.device), right=True) - 1
    count = offsets.shape[1] - 1
    return products.new_zeros(len(left), count, *products.shape[2:]).index_add(1, group, products)


# The sums (B, G, a, b) over the pairs of each group of left[l]^T right[r], where l and r are the rows of a pair (1, P) of
# matrices (B, N, n, a) and (B, M, n, b), and group g has the pairs offsets[g] to offsets[g + 1] - 1. With matrices `middle`
# (B, K, n, n) they are those of left[l]^T middle[middle_rows[l]] right[r]. Indices are int32.
group_products = register(
    "group_products",
    _reference,
    fake=lambda left, right, rows, others, offsets, *rest: left.new_empty(
        left.shape[0], offsets.shape[1] - 1, left.shape[3], right.shape[3]
    ),
)


def by_key(keys: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Rows (N,) in the order of their keys, and where those of each key begin, (count + 1) of int32."""
    ordered, order = keys.contiguous().sort(stable=True)
    return order, offsets_of(ordered, count)


def offsets_of(ordered: Tensor, count: int) -> Tensor:
    """Where rows of each key begin among ordered keys (N,), (count + 1) of int32."""
    every = torch.arange(count + 1, dtype=ordered.dtype, device=ordered.device)
    return torch.searchsorted(ordered, every, out_int32=True)


class Groups:
    """Rows with keys (N,), and their sums by key, (B, count, *): the same bits every run."""

    def __init__(self, keys: Tensor, count: int) -> None:
        order, offsets = by_key(keys, count)
        self.rows, self.offsets = order.int()[None], offsets[None]

    def products(self, left: Tensor, right: Tensor, right_index: Tensor | None = None) -> Tensor:
        """Sums of left^T right (B, count, a, b) over rows of matrices (B, N, n, a) and (B, N, n, b).

        With an index (N,) `right` is (B, M, n, b), and its row of a row is the one that the index names.
        """
        others = self.rows if right_index is None else right_index[self.rows[0]].int()[None]
        return group_products(left, right, self.rows, others, self.offsets, None, None)

    def squares(self, left: Tensor, middle: Tensor, index: Tensor) -> Tensor:
        """Sums of left M left^T over rows of matrices (B, N, a, n), with the matrix M (B, K, n, n) that the index (N,) names."""
        return group_products(left.mT, left.mT, self.rows, self.rows, self.offsets, middle, index.int()[None])

    def __call__(self, x: Tensor) -> Tensor:
        """Sums of x (B, N, *)."""
        rows = x.flatten(2) if x.dim() > 2 else x[..., None]
        one = x.new_ones(1, 1, 1, 1).expand(*x.shape[:2], 1, 1)
        return self.products(one, rows[:, :, None]).reshape(len(x), self.offsets.shape[1] - 1, *x.shape[2:])


class Pairs:
    """Pairs of rows that share an element, by the keys of both: what a Schur complement sums over.

    Args:
        left, right: the elements (N,) and (M,) that rows of two tables share. None for `right`: pairs of different rows of
            one table, in one order each.
        left_key, right_key: the keys (N,) and (M,) of rows; None for tables that have none.
        left_count, right_count: of keys, 1 without.
    """

    def __init__(
        self,
        left: Tensor,
        right: Tensor | None,
        left_key: Tensor | None,
        right_key: Tensor | None,
        left_count: int,
        right_count: int,
    ) -> None:
        self.middle = left.int().contiguous()[None]
        i, j = _different(self.middle[0]) if right is None else _sharing(self.middle[0], right.int())
        keys = torch.zeros_like(i)
        if left_key is not None:
            keys += left_key[i].int() * right_count
        if right_key is not None:
            keys += right_key[j].int()
        ordered, order = keys.sort(stable=True)
        bounds = torch.arange(left_count * right_count + 1, dtype=torch.int32, device=keys.device)
        self.left, self.right = i[order][None], j[order][None]
        self.offsets = torch.searchsorted(ordered, bounds, out_int32=True)[None]

    def products(self, left: Tensor, middle: Tensor, right: Tensor) -> Tensor:
        """Sums of left M right^T over pairs, with the matrix M (B, K, n, n) of the shared element."""
        return group_products(left.mT, right.mT, self.left, self.right, self.offsets, middle, self.middle)


def _sharing(left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """All pairs (i, j) with left[i] = right[j], in the order of i."""
    ordered, order = right.sort(stable=True)
    first = torch.searchsorted(ordered, left, out_int32=True)
    count = torch.searchsorted(ordered, left, right=True, out_int32=True) - first
    i = torch.repeat_interleave(count).int()  # waits for the device, which alone knows the number of pairs
    start = first - (count.cumsum(0, dtype=torch.int32) - count)
    within = torch.arange(len(i), dtype=torch.int32, device=i.device)
    within += start[i]
    return i, order.int()[within]


def _different(x: Tensor) -> tuple[Tensor, Tensor]:
    """All pairs (i, j) of different rows with x[i] = x[j], in one order each."""
    ordered, order = x.sort(stable=True)
    rows = torch.arange(len(x), dtype=torch.int32, device=x.device)
    before = rows - torch.searchsorted(ordered, ordered, out_int32=True)  # rows of the same element that come first
    second = torch.repeat_interleave(before).int()  # waits for the device, as above
    start = before.cumsum(0, dtype=torch.int32) - before
    first = torch.arange(len(second), dtype=torch.int32, device=x.device)
    first += (rows - before - start)[second]
    order = order.int()
    return order[first], order[second]
