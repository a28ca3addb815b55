"""Vectors and scalars."""

import pytest
import torch
from torch import Tensor

from composition_tests import Case, CompositionTests
from kvision.geometry.vector import Scalar, Vector2, Vector3
from op_tests import assert_close


class TestVector(CompositionTests):
    cases = {
        "vector": Case(lambda v, w: (Vector3(v).normalized() + w).dot(Vector3(v)).data, ((2, 5, 3), (2, 5, 3))),
    }
    compiled = ("vector",)


def test_vectors(device):
    v = Vector3(torch.tensor([[1.0, 2, 2], [0, 0, 0]], device=device))
    assert_close([v.x, v.y, v.z], list(v.data.unbind(-1)))
    assert_close(v.normalized().data, v.data / 3)
    assert isinstance(v + 1, Vector3)
    assert isinstance(v.sum(), Tensor)
    assert isinstance(v.dot(v), Scalar)
    assert_close(v.squared_norm().data, v.dot(v).data)
    assert Vector2.random((4,), device=device, dtype=torch.float64).shape == (4, 2)
    assert Vector3.random(device=device).shape == (3,)
    assert_close(
        Vector2.from_coords(torch.ones(3, device=device), torch.zeros(3, device=device)).x, torch.ones(3, device=device)
    )
    zero = torch.zeros(3, device=device, requires_grad=True)
    (grad,) = torch.autograd.grad(Vector3(zero).normalized().data.sum(), zero)
    assert grad.isfinite().all()


BAD = [
    (lambda: Vector3(torch.ones(2)), ValueError, r"Vector3: expected vector of shape \(\*, 3\), got \(2,\)"),
    (lambda: Vector2.from_coords(1.0, torch.ones(2)), TypeError, "Vector2.from_coords: expected tensors or numbers"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
