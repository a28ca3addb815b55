"""Inverses and solutions that come with a mask."""

from __future__ import annotations

import kornia
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.sampled_from([torch.float32, torch.float64]))
def test_regular_matrices(device, seed, n, dtype):
    A = torch.randn(4, n, n, generator=torch.Generator().manual_seed(seed), dtype=dtype) + 3 * torch.eye(n, dtype=dtype)
    A = A[torch.linalg.cond(A) < 100].to(device)
    B = torch.ones(len(A), n, 2, dtype=dtype, device=device)
    inverse, valid = K.utils.safe_inverse_with_mask(A)
    X, lu, solved = K.utils.safe_solve_with_mask(B, A)
    assert valid.all() and solved.all() and lu.shape == A.shape
    tolerance = 1e-3 if dtype == torch.float32 else 1e-10
    torch.testing.assert_close(inverse, torch.linalg.inv(A), rtol=tolerance, atol=tolerance)
    torch.testing.assert_close(X, torch.linalg.solve(A, B), rtol=tolerance, atol=tolerance)


MATRICES = {
    "identity": (torch.eye(3), True),
    "zero": (torch.zeros(3, 3), False),
    "rank 2": (torch.arange(9.0).reshape(3, 3), False),  # whose LU factors miss 0 by rounding
    "nearly rank 2": (torch.arange(9.0).reshape(3, 3) + 1e-7 * torch.eye(3), False),
    "tiny": (1e-20 * torch.eye(3), True),
    "huge": (1e20 * torch.eye(3), True),
    "rows of different scale": (torch.diag(torch.tensor([1e-10, 1.0, 1e10])), True),
    "columns of different scale": (torch.ones(3, 3).triu() * torch.tensor([1e-10, 1.0, 1e10]), True),
    "far translation": (torch.tensor([[1.0, 0, 5000], [0, 1, -5000], [0, 0, 1]]), True),
    "permutation": (torch.eye(3)[[2, 0, 1]], True),
    "nan": (torch.full((3, 3), torch.nan), False),
    "inf": (torch.diag(torch.tensor([torch.inf, 1.0, 1.0])), False),
}


@pytest.mark.parametrize("name", MATRICES)
def test_mask(name, device):
    matrix, regular = MATRICES[name]
    A = torch.stack([matrix, 2 * torch.eye(3)]).to(device)
    inverse, valid = K.utils.safe_inverse_with_mask(A)
    X, _, solved = K.utils.safe_solve_with_mask(torch.ones(2, 3, 1, device=device), A)
    assert valid.tolist() == solved.tolist() == [regular, True]
    if matrix.isfinite().all():
        assert torch.equal(valid.cpu(), kornia.core.utils.safe_inverse_with_mask(A.cpu())[1])
    torch.testing.assert_close(inverse[1], torch.eye(3, device=device) / 2)
    if not regular:
        assert torch.equal(inverse[0], torch.eye(3, device=device)) and (X[0] == 1).all()


def test_shapes_and_dtypes(device):
    A = 2 * torch.eye(3, device=device).expand(2, 4, 3, 3)
    X, lu, mask = K.utils.safe_solve_with_mask(torch.ones(2, 4, 3, device=device), A)
    assert (X.shape, lu.shape, mask.shape) == ((2, 4, 3, 1), (2, 4, 3, 3), (2, 4))
    inverse, mask = K.utils.safe_inverse_with_mask(A[:0].half())
    assert (inverse.shape, inverse.dtype, mask.shape) == ((0, 4, 3, 3), torch.float16, (0, 4))
    too_small = torch.eye(2, device=device, dtype=torch.float16) * 1e-5  # its inverse is beyond float16
    assert not K.utils.safe_inverse_with_mask(too_small)[1]


def test_gradients_pass_by_singular_matrices():
    scale = torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    A = torch.stack([torch.eye(2), torch.ones(2, 2)]).double() * scale
    for result in (
        K.utils.safe_inverse_with_mask(A)[0],
        K.utils.safe_solve_with_mask(torch.ones(2, 2, 1).double(), A)[0],
    ):
        (grad,) = torch.autograd.grad(result.sum(), scale, retain_graph=True)
        assert grad.item() == pytest.approx(-0.5)  # of the identity's 2 / scale alone

    regular = torch.rand(2, 3, 3, dtype=torch.float64) + 2 * torch.eye(3)
    rhs = torch.rand(2, 3, 1, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda a: K.utils.safe_inverse_with_mask(a)[0], regular.requires_grad_())
    assert torch.autograd.gradcheck(lambda b, a: K.utils.safe_solve_with_mask(b, a)[0], (rhs.requires_grad_(), regular))


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (
            lambda: K.utils.safe_inverse_with_mask([1]),
            TypeCheckError,
            "safe_inverse_with_mask: expected A to be a Tenso",
        ),
        (
            lambda: K.utils.safe_inverse_with_mask(torch.ones(2, 3)),
            ShapeError,
            r"A of shape \(\*, N, N\), got \(2, 3\)",
        ),
        (
            lambda: K.utils.safe_solve_with_mask([1], torch.eye(2)),
            TypeCheckError,
            "expected B to be a Tensor, got list",
        ),
        (
            lambda: K.utils.safe_solve_with_mask(torch.ones(3, 1), torch.eye(2)),
            ShapeError,
            r"B of shape .*got \(3, 1\)",
        ),
    ],
)
def test_errors(call, error, text):
    with pytest.raises(error, match=text):
        call()
