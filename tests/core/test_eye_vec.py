"""eye_like and vec_like."""

from __future__ import annotations

import kornia
import pytest
import torch

import kvision as K
from kvision.core.exceptions import BaseError, ShapeError, TypeCheckError, ValueCheckError


@pytest.mark.parametrize("name", ["eye_like", "vec_like"])
@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.int64])
def test_agrees_with_kornia(name, shared, dtype, device):
    for batch in (0, 1, 3):
        like = torch.zeros(batch, 5, dtype=dtype, device=device)
        got = getattr(K.core, name)(4, like, shared)
        want = getattr(kornia.core, name)(4, like, shared)
        assert torch.equal(got, want) and got.dtype == dtype and got.device == like.device


def test_memory():
    for f in (K.core.eye_like, K.core.vec_like):
        assert f(3, torch.zeros(5)).is_contiguous()
        assert f(3, torch.zeros(5), shared_memory=True).stride(0) == 0


@pytest.mark.parametrize("f", [K.core.eye_like, K.core.vec_like])
@pytest.mark.parametrize(
    ("n", "like", "error"),
    [
        (0, torch.zeros(2), ValueCheckError),
        (2.0, torch.zeros(2), TypeCheckError),
        (True, torch.zeros(2), TypeCheckError),
        (2, torch.zeros(()), ShapeError),
        (2, [1], TypeCheckError),
    ],
)
def test_errors(f, n, like, error):
    with pytest.raises(error, match=f"{f.__name__}: expected ") as caught:
        f(n, like)
    assert isinstance(caught.value, BaseError)
