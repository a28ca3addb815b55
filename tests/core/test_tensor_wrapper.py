"""TensorWrapper behaves like the tensor it holds."""

from __future__ import annotations

import copy
import operator
import pickle

import numpy as np
import pytest
import torch

from kvision.core import TensorWrapper
from kvision.core.exceptions import TypeCheckError


class Weight(TensorWrapper):
    pass


ARITHMETIC = ["add", "sub", "mul", "truediv", "floordiv", "mod", "pow"]
BITWISE = ["and_", "or_", "xor", "lshift", "rshift"]
COMPARISON = ["eq", "ne", "lt", "le", "gt", "ge"]


@pytest.mark.parametrize("name", ARITHMETIC + BITWISE + COMPARISON)
def test_binary_operators(name):
    op = getattr(operator, name)
    a, b = (torch.tensor([6, 2]), torch.tensor([1, 3])) if name in BITWISE else (torch.rand(2), torch.rand(2))
    for got in (op(Weight(a), b), op(a, Weight(b)), op(Weight(a), Weight(b))):
        assert type(got) is Weight and torch.equal(got.unwrap(), op(a, b))
    scalar = 2
    assert torch.equal(op(Weight(a), scalar).data, op(a, scalar))
    assert torch.equal(op(scalar, Weight(a)).data, op(scalar, a))


@pytest.mark.parametrize("name", ["neg", "pos", "abs", "invert"])
def test_unary_operators(name):
    x = torch.tensor([3, -4])
    got = getattr(operator, name)(Weight(x))
    assert type(got) is Weight and torch.equal(got.data, getattr(operator, name)(x))


@pytest.mark.parametrize("name", ["iadd", "isub", "imul", "itruediv", "ipow"])
def test_in_place_operators(name):
    x = torch.tensor([3.0, 4.0])
    w = same = Weight(x)
    expected = getattr(operator, name)(x.clone(), 2)
    w = getattr(operator, name)(w, 2)
    assert w is same and w.data is x and torch.equal(x, expected)


def test_matrix_product():
    a = torch.rand(3, 3)
    assert torch.equal((Weight(a) @ a).data, a @ a) and torch.equal((a @ Weight(a)).data, a @ a)


def test_functions_methods_and_attributes():
    x = torch.rand(2, 3)
    w = Weight(x)
    assert torch.equal(torch.cat([w, x]).data, torch.cat([x, x])) and type(torch.sin(w)) is Weight
    assert type(w.sum(dim=1)) is Weight and torch.equal(w.T.data, x.T)
    assert [type(part) for part in w.unbind(1)] == [Weight] * 3
    assert w.shape == (2, 3) and w.dtype == torch.float32 and len(w) == 2 and w.dim() == 2
    assert torch.equal(torch.add(x, other=w).data, 2 * x)
    assert repr(Weight(torch.tensor(1))) == "Weight(1)"


def test_indexing_and_iteration():
    w = Weight(torch.arange(6).reshape(2, 3))
    assert type(w[0]) is Weight and w[0].tolist() == [0, 1, 2]
    w[0, 0] = 9
    assert w.data[0, 0] == 9 and 9 in w and 7 not in w
    assert [type(row) for row in w] == [Weight, Weight]


def test_python_values():
    w = Weight(torch.tensor(3))
    assert (int(w), float(w), bool(w), complex(w), operator.index(w)) == (3, 3.0, True, 3 + 0j, 3)
    assert np.array_equal(np.asarray(Weight(torch.ones(2))), np.ones(2, np.float32))
    assert torch.equal(torch.from_dlpack(Weight(torch.ones(2))), torch.ones(2))
    assert len({w, w}) == 1


def test_gradient():
    x = torch.rand(3, requires_grad=True)
    (Weight(x) ** 2).sum().backward()
    assert torch.allclose(x.grad, 2 * x)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda w: pickle.loads(pickle.dumps(w))])
def test_copies(duplicate):
    w = duplicate(Weight(torch.ones(2)))
    assert type(w) is Weight and torch.equal(w.data, torch.ones(2))


def test_wrappers_do_not_nest():
    x = torch.ones(2)
    assert Weight(TensorWrapper(x)).data is x


def test_errors():
    with pytest.raises(TypeCheckError, match="Weight: expected data to be a Tensor, got list"):
        Weight([1])
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = Weight(torch.ones(1)).no_such_thing
