"""Degrees, radians, polar coordinates and rotations of the plane."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close
from point_op_tests import DEGREES, Call, PointOpTests

G = K.geometry
P2, P3, MATRIX, POSE = (2, 5, 2), (2, 5, 3), (2, 3, 3), (2, 4, 4)


def flat(f):
    """A function of several results as one of one."""
    return lambda *x: torch.cat([y.flatten(1) for y in f(*x)], 1)


class TestAngles(CompositionTests):
    cases = {
        "rad2deg": Case(G.rad2deg, (P2,)),
        "deg2rad": Case(G.deg2rad, (P2,)),
        "pol2cart": Case(flat(G.pol2cart), (P2, P2)),
        "cart2pol": Case(flat(G.cart2pol), (P2, P2)),
        "angle_to_rotation_matrix": Case(G.angle_to_rotation_matrix, ((2, 3),)),
    }
    compiled = ()


GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


CALLS = [
    ("rad2deg", (rand(3),)),
    ("deg2rad", (rand(3),)),
    ("pol2cart", (rand(3), rand(3))),
    ("cart2pol", (rand(3) - 0.5, rand(3) - 0.5)),
    ("angle_to_rotation_matrix", (500 * rand(3),)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry
    result = getattr(G, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    expected = getattr(theirs, name)(*args)
    for ours, his in zip(*((y,) if isinstance(y, Tensor) else y for y in (result, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-7, 1e-9)


def test_rotations_by_any_angle(device):
    """Also by angles so large that only a multiple of 90 degrees next to them is left, and by none."""
    turns = torch.tensor([0.0, 1, 7, -1e6, 1e12], dtype=torch.float64)
    rest = torch.tensor([0.0, 44.9, 45, -45, 45.1, 89.5], dtype=torch.float64)
    degrees = (360 * turns[:, None] + rest).to(device)
    cosine, sine = torch.deg2rad(rest).cos().to(device), torch.deg2rad(rest).sin().to(device)
    expected = torch.stack([cosine, sine, -sine, cosine], -1).unflatten(-1, (2, 2)).expand(5, -1, -1, -1)
    matrices = G.angle_to_rotation_matrix(degrees)
    assert_close(matrices[:4], expected[:4], 0, 1e-9)
    assert_close(matrices[4], expected[4], 0, 1e-3)
    unbounded = torch.tensor([1e17, -3e20, float("inf"), float("nan")], dtype=torch.float64, device=device)
    matrices = G.angle_to_rotation_matrix(unbounded)
    assert (matrices[:2].abs() <= 1).all() and matrices[2:].isnan().all()


BAD = [
    (lambda: G.rad2deg(1.0), TypeError, "rad2deg: expected tensor to be a Tensor, got float"),
    (lambda: G.pol2cart(torch.ones(2), torch.ones(3)), ValueError, "pol2cart: expected leading axes that broadcast"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


class TestAnglesOperators(PointOpTests):
    calls = {
        "angle_to_rotation_matrix": [Call((DEGREES,))],
    }
