"""Poses of cameras as matrices, and their conventions."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
P2, P3, MATRIX, POSE = (2, 5, 2), (2, 5, 3), (2, 3, 3), (2, 4, 4)


def flat(f):
    """A function of several results as one of one."""
    return lambda *x: torch.cat([y.flatten(1) for y in f(*x)], 1)


class TestPoses(CompositionTests):
    cases = {
        "Rt_to_matrix4x4": Case(G.Rt_to_matrix4x4, (MATRIX, (2, 3, 1))),
        "camtoworld_to_worldtocam_Rt": Case(flat(G.camtoworld_to_worldtocam_Rt), (MATRIX, (2, 3, 1))),
        "camtoworld_graphics_to_vision_4x4": Case(G.camtoworld_graphics_to_vision_4x4, (POSE,)),
        "camtoworld_vision_to_graphics_Rt": Case(flat(G.camtoworld_vision_to_graphics_Rt), (MATRIX, (2, 3, 1))),
    }
    compiled = ()


GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


CALLS = [
    ("Rt_to_matrix4x4", (rand(2, 3, 3), rand(2, 3, 1))),
    ("matrix4x4_to_Rt", (rand(2, 4, 4),)),
    ("camtoworld_to_worldtocam_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
    ("worldtocam_to_camtoworld_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
    ("camtoworld_graphics_to_vision_4x4", (rand(2, 4, 4),)),
    ("camtoworld_graphics_to_vision_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
    ("camtoworld_vision_to_graphics_4x4", (rand(2, 4, 4),)),
    ("camtoworld_vision_to_graphics_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry
    result = getattr(G, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    expected = getattr(theirs, name)(*args)
    for ours, his in zip(*((y,) if isinstance(y, Tensor) else y for y in (result, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-7, 1e-9)


def test_inverse_rotations_are_views(device):
    R, t = torch.rand(2, 3, 3, device=device), torch.rand(2, 3, 1, device=device)
    for invert in (G.camtoworld_to_worldtocam_Rt, G.worldtocam_to_camtoworld_Rt):
        assert invert(R, t)[0].data_ptr() == R.data_ptr()


def test_inverses_of_whole_numbers(device):
    R, t = torch.eye(3, device=device).repeat(2, 1, 1), torch.tensor([1, 2, 3], device=device).repeat(2, 1)[..., None]
    assert torch.equal(G.camtoworld_to_worldtocam_Rt(0.5 * R, t)[1], -0.5 * t)
    assert torch.equal(G.camtoworld_to_worldtocam_Rt(R.long(), t)[1], -t)


def test_rotation_check():
    R, t = torch.eye(3)[None], torch.ones(1, 3, 1)
    G.camtoworld_to_worldtocam_Rt(R, t, check_rotation=True)
    with pytest.raises(ValueError, match="worldtocam_to_camtoworld_Rt: expected R of rotations"):
        G.worldtocam_to_camtoworld_Rt(2 * R, t, check_rotation=True)


EYE, ONES = torch.eye(3), torch.ones(2, 4, 3)
BAD = [
    (lambda: G.Rt_to_matrix4x4(EYE, torch.ones(1, 3, 1)), ValueError, r"Rt_to_matrix4x4: expected t of shape \(3, 1\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
