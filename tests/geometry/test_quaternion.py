"""Quaternions."""

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given
from torch import Tensor, nn

import kvision as K
from composition_tests import Case, CompositionTests
from kvision.geometry.quaternion import average_quaternions
from op_tests import assert_close
from point_op_tests import Call, PointOpTests, vector

G = K.geometry
Q = G.Quaternion


class TestQuaternion(CompositionTests):
    cases = {
        "product": Case(lambda p, q: (Q(p) * Q(q) / Q(p) + 2 * Q(q).inv() - 1).data, ((2, 5, 4),) * 2),
        "slerp": Case(lambda p, q: Q(p).slerp(Q(q), 0.3).data, ((2, 5, 4),) * 2),
        "power": Case(lambda p, t: (Q(p) ** t).data, ((2, 5, 4), (2, 5))),
    }
    compiled = ("slerp",)


def rand(*shape: int, seed: int = 5) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.3


def test_quaternions_are_those_of_kornia(device):
    theirs = pytest.importorskip("kornia").geometry.quaternion.Quaternion
    p, q, t = rand(6, 4), rand(6, 4, seed=6), rand(6, seed=7)
    calls = [
        lambda a, b, t: a * b,
        lambda a, b, t: a / b,
        lambda a, b, t: a + b,
        lambda a, b, t: a - b,
        lambda a, b, t: -a,
        lambda a, b, t: 2.0 * a,
        lambda a, b, t: a * t,
        lambda a, b, t: a / t,
        lambda a, b, t: a + t,
        lambda a, b, t: a - 2.0,
        lambda a, b, t: 2.0 - a,
        lambda a, b, t: 2.0 + a,
        lambda a, b, t: 2.0 / a,
        lambda a, b, t: a**2,
        lambda a, b, t: a**-0.7,
        lambda a, b, t: a.inv(),
        lambda a, b, t: a.conj(),
        lambda a, b, t: a.normalize(),
        lambda a, b, t: a.slerp(b, 0.3),
        lambda a, b, t: a.slerp(b, t),
        lambda a, b, t: a[2:4],
    ]
    for call in calls:
        expected = call(theirs(p), theirs(q), t).data
        assert_close(call(Q(p.to(device)), Q(q.to(device)), t.to(device)).data.cpu(), expected, 1e-9, 1e-9)
    a, b = Q(p.to(device)), theirs(p)
    for name in ("real", "scalar", "vec", "q", "w", "x", "y", "z", "polar_angle"):
        assert_close(getattr(a, name).cpu(), getattr(b, name))
    for name in ("matrix", "to_axis_angle", "norm", "squared_norm", "to_euler"):
        result, expected = getattr(a, name)(), getattr(b, name)()
        assert_close([x.cpu() for x in result] if isinstance(result, tuple) else result.cpu(), expected)
    assert a.shape == (6, 4)
    assert len(a.coeffs) == 4
    assert a.norm(keepdim=True).shape == (6, 1)


def test_ways_to_make_quaternions(device):
    q = Q.random(1000, device, torch.float64)
    assert_close(q.norm(), torch.ones(1000, dtype=torch.float64, device=device))
    assert q.data.mean(0).abs().max() < 0.1
    for again in (Q.from_matrix(q.matrix()), Q.from_axis_angle(q.to_axis_angle()), Q.from_euler(*q.to_euler())):
        assert_close(again.matrix(), q.matrix(), 0, 1e-12)
    assert_close(Q.identity(2, device).data, torch.tensor([[1.0, 0, 0, 0]] * 2, device=device))
    assert Q.identity().shape == Q.random().shape == (4,)
    assert_close(Q.from_coeffs(1.0, 2.0, 3.0, 4.0).data, torch.tensor([1.0, 2, 3, 4]))
    assert_close(Q.from_coeffs(*q.coeffs).data, q.data)
    assert q.to(torch.float32).data.dtype == torch.float32
    assert [name for name, _ in Q(nn.Parameter(torch.ones(4))).named_parameters()] == ["_data"]


@given(st.lists(st.floats(-2, 2).filter(lambda x: abs(x) > 1e-3), min_size=12, max_size=12), st.floats(-3, 3))
def test_algebra(numbers, t):
    p, q, r = (Q(x) for x in torch.tensor(numbers, dtype=torch.float64).split(4))
    assert_close(((p * q) * r).data, (p * (q * r)).data, 1e-10, 1e-10)
    assert_close((p * (q + r)).data, (p * q + p * r).data, 1e-10, 1e-10)
    assert_close((p * p.inv()).data, Q.identity(dtype=torch.float64).data, 0, 1e-10)
    assert_close((p * q).norm(), p.norm() * q.norm())
    assert_close((p * q).matrix(), p.matrix() @ q.matrix(), 0, 1e-10)
    assert_close((p**t * p ** (1 - t)).data, p.data, 1e-9, 1e-9)
    assert_close(p.slerp(q, 0.0).matrix(), p.matrix(), 0, 1e-9)
    assert_close(p.slerp(q, 1.0).matrix(), q.matrix(), 0, 1e-7)


def test_powers_of_numbers(device):
    minus = Q(torch.tensor([-4.0, 0, 0, 0], dtype=torch.float64, device=device))
    root = minus**0.5
    assert_close((root * root).data, minus.data, 0, 1e-12)
    zero = torch.zeros(4, dtype=torch.float64, device=device, requires_grad=True)
    (grad,) = torch.autograd.grad((Q(zero).norm() + Q(zero).normalize().data.sum()), zero)
    assert grad.isfinite().all()


def test_average(device):
    center = Q.random(1, device, torch.float64)
    turns = 0.3 * (torch.rand(200, 3, dtype=torch.float64, device=device) - 0.5)
    around = center * Q.from_axis_angle(torch.cat([turns, -turns]))
    signs = torch.where(torch.rand(400, 1, device=device) > 0.5, 1.0, -1.0)
    result = average_quaternions(Q(around.data * signs))
    assert_close(result.matrix(), center.matrix(), 0, 1e-12)
    weights = torch.cat([torch.ones(1), torch.zeros(399)]).to(device)
    assert_close(average_quaternions(around, weights).matrix()[0], around.matrix()[0], 0, 1e-12)
    same = center.data.expand(5, 4).clone().requires_grad_()
    (grad,) = torch.autograd.grad(average_quaternions(Q(same)).data.sum(), same)
    assert grad.isfinite().all()


BAD = [
    (lambda: Q(torch.ones(3)), ValueError, r"Quaternion: expected data of shape \(\*, 4\)"),
    (lambda: Q.identity().slerp(torch.ones(4), 0.5), TypeError, "slerp: expected q1 to be a Quaternion, got Tensor"),
    (lambda: Q.from_coeffs(1.0, 2.0, 3.0, torch.ones(())), TypeError, "from_coeffs: expected tensors or numbers, got both"),
    (lambda: average_quaternions(torch.ones(2, 4)), TypeError, "average_quaternions: expected Q to be a Quaternion"),
    (lambda: average_quaternions(Q.identity(2), torch.ones(3)), ValueError, r"average_quaternions: expected w of shape \(2,\)"),
    (lambda: average_quaternions(Q.identity(0)), ValueError, "average_quaternions: expected Q of at least one"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


class TestQuaternionOperators(PointOpTests):
    calls = {
        "quaternion_product": [Call((vector(4),) * 2)],
    }
