"""Euler angles."""

import math

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests

G = K.geometry
EULER = ((2, 5),)


def joined(f):
    return lambda *x: torch.stack(f(*x), -1)


class TestEuler(CompositionTests):
    compiled = ("euler_from_quaternion",)
    cases = {
        "quaternion_from_euler": Case(joined(G.quaternion_from_euler), EULER * 3),
        "euler_from_quaternion": Case(joined(G.euler_from_quaternion), EULER * 4),
    }


def up_to_sign(a: torch.Tensor, b: torch.Tensor) -> float:
    return torch.minimum((a - b).abs().amax(-1), (a + b).abs().amax(-1)).max().item()


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_gimbal_lock(sign, dtype, device):
    roll, yaw = torch.rand(2, 300, dtype=dtype, device=device) * 6 - 3
    pitch = torch.full_like(roll, sign * math.pi / 2)
    q = torch.stack(G.quaternion_from_euler(roll, pitch, yaw), -1).requires_grad_()
    euler = G.euler_from_quaternion(*q.unbind(-1))
    again = torch.stack(G.quaternion_from_euler(*euler), -1)
    assert up_to_sign(again.detach(), q.detach()) < 10 * torch.finfo(dtype).eps
    assert euler[0].abs().max() == 0
    (grad,) = torch.autograd.grad(sum(euler).sum(), q)
    assert grad.isfinite().all()
    none = [x.requires_grad_() for x in torch.zeros(4, 1, dtype=dtype, device=device).unbind(0)]
    assert all(g.isfinite().all() for g in torch.autograd.grad(sum(G.euler_from_quaternion(*none)).sum(), none))


BAD = [
    (lambda: G.euler_from_quaternion(*torch.ones(3, 2), torch.ones(1)), ValueError, "euler_from_quaternion: expected tensors of"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
