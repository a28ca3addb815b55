"""Sums of products by group, as normal equations and Schur complements have them."""

from __future__ import annotations

import torch

from kvision.geometry.optim.group_products import Groups, Pairs
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector


def ints(*values: int) -> torch.Tensor:
    return torch.tensor([values], dtype=torch.int32)


LEFT_ROWS, RIGHT_ROWS, OFFSETS = ints(4, 0, 3, 1, 1), ints(2, 2, 0, 3, 1), ints(0, 2, 2, 5)  # the second group is empty
NOT_OF_SAMPLES = ("left_rows of another batch", "right_rows of another batch", "offsets of another batch")


class TestGroupProducts(PointOpTests):
    calls = {
        "group_products": [
            Call(
                (vector(5, 2, 3), vector(4, 2, columns), LEFT_ROWS, RIGHT_ROWS, OFFSETS, *middle),
                broadcasts=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=(" cut along axis -1", "offsets cut along axis"),
                tolerance=50,
            )
            for columns, middle in ((17, (None, None)), (3, (vector(2, 2, 2), ints(0, 1, 1, 0, 1))))
        ]
    }


def test_no_groups_and_no_rows(device: torch.device) -> None:
    nothing = torch.zeros(0, dtype=torch.int64, device=device)
    assert Groups(nothing, 0)(torch.ones(2, 0, 3, device=device)).shape == (2, 0, 3)
    assert torch.equal(Groups(nothing, 2)(torch.ones(2, 0, 3, device=device)).cpu(), torch.zeros(2, 2, 3))
    assert Groups(torch.zeros(4, dtype=torch.int64, device=device), 1)(torch.ones(0, 4, 3, device=device)).shape == (
        0,
        1,
        3,
    )


def test_groups_and_pairs(device: torch.device) -> None:
    """Against sums of all rows and of all pairs of rows, in loops."""
    generator = torch.Generator().manual_seed(0)
    key, shared, other = (torch.randint(n, (m,), generator=generator) for n, m in ((3, 20), (4, 20), (4, 15)))
    W, V = (torch.randn(2, n, 3, 2, generator=generator, dtype=torch.float64) for n in (20, 15))
    M = torch.randn(2, 4, 2, 2, generator=generator, dtype=torch.float64)
    sums = Groups(key.to(device), 5)(W.to(device)).cpu()
    torch.testing.assert_close(sums, torch.stack([W[:, key == k].sum(1) for k in range(5)], 1))
    pairs = Pairs(shared.to(device), other.to(device), key.to(device), None, 3, 1)
    found = pairs.products(W.to(device), M.to(device), V.to(device)).cpu()
    expected = torch.zeros(2, 3, 3, 3, dtype=torch.float64)
    for i in range(20):
        for j in range(15):
            if shared[i] == other[j]:
                expected[:, key[i]] += W[:, i] @ M[:, shared[i]] @ V[:, j].mT
    torch.testing.assert_close(found, expected)
