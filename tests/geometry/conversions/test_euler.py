"""Euler angles."""

import math

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close
from point_op_tests import NUMBER, Call, PointOpTests

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


class TestEulerOperators(PointOpTests):
    calls = {
        "quaternion_from_euler": [Call((NUMBER,) * 3)],
        "euler_from_quaternion": [Call((NUMBER,) * 4)],
    }


@pytest.mark.native
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_any_angle(dtype, device):
    """Sines, cosines and arc tangents, of large angles, in every octant and where these meet."""
    exact = torch.cat(
        [
            torch.linspace(-20, 20, 4001, dtype=torch.float64),
            torch.pi / 8 * torch.arange(-40, 41, dtype=torch.float64),
            torch.tensor([0.0, 1e-300, -1e-8, 12345.678, -9.9e5, 1.1e6, 3e15]),
        ]
    )
    angles = exact.to(dtype).to(device)
    zero = torch.zeros_like(angles)
    w, x, _, _ = K.geometry.quaternion_from_euler(angles, zero, zero)
    half = angles.double() / 2
    tolerance = 3e-16 if dtype == torch.float64 else 4e-8
    assert_close(w.double(), half.cos(), 0, tolerance)
    assert_close(x.double(), half.sin(), 0, tolerance)
    cosine, sine = half.cos().to(dtype), half.sin().to(dtype)
    log = K.geometry.quaternion_exp_to_log(torch.stack([cosine, sine, zero, zero], 1))[:, 0].double()
    angle = torch.atan2(sine.double(), cosine.double())
    known = sine != 0
    assert_close(log[known], angle[known], 0, 9e-16 if dtype == torch.float64 else 2e-7)
    for bad in (torch.inf, -torch.inf, torch.nan):
        assert K.geometry.quaternion_from_euler(*torch.full((3, 1), bad, device=device))[0].isnan().all()
