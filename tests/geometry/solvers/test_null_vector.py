"""Null vectors and eigenvectors of small matrices."""

import pytest
import torch

import kvision as K
from kvision.geometry.solvers.null_vector import eigenvectors
from op_tests import assert_close
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector
from view_tests import rand

G = K.geometry


@pytest.mark.parametrize("n", [3, 4, 9, 12])
def testeigenvectors(n, device):
    """Also of matrices that have no more than one eigenvalue, or two."""
    matrix = torch.stack([M @ M.mT for M in rand(6, n, n, seed=n)]).to(device)
    matrix[:3] = torch.stack([0 * matrix[0], torch.eye(n, device=device).double(), torch.ones_like(matrix[0])])
    values, vectors = eigenvectors(matrix)
    assert_close(values, torch.linalg.eigvalsh(matrix.cpu()).to(device), 1e-12, 1e-12)
    assert_close(matrix @ vectors, vectors * values[:, None], 1e-12, 1e-12)
    assert_close(vectors.mT @ vectors, torch.eye(n, device=device).double().expand_as(matrix), 1e-12, 1e-12)


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.null_vector_3x4(M), ValueError, r"null_vector_3x4: expected A of shape \(\*, 3, 4\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


def symmetric(n: int):
    return lambda: (lambda x: x @ x.mT)(vector(n, n)())


class TestNullVectorOperators(PointOpTests):
    calls = {
        "null_vector": [
            Call(
                (vector(7, 4), weights),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=100,
            )
            for weights in (vector(7), None)
        ],
        # The sign of a vector is open.
        "eigenvectors": [
            Call(
                (symmetric(n),),
                differentiable=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=20,
                compared=lambda values, _: values,
            )
            for n in (3, 9)
        ],
    }
