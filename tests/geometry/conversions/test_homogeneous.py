"""Homogeneous coordinates of points and matrices."""

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


class TestHomogeneous(CompositionTests):
    cases = {
        "convert_points_to_homogeneous": Case(G.convert_points_to_homogeneous, (P2,)),
        "convert_points_from_homogeneous": Case(G.convert_points_from_homogeneous, (P3,)),
        "convert_affinematrix_to_homography": Case(G.convert_affinematrix_to_homography, ((2, 2, 3),)),
        "convert_affinematrix_to_homography3d": Case(G.convert_affinematrix_to_homography3d, ((2, 3, 4),)),
    }
    compiled = ()


GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


CALLS = [
    ("convert_points_from_homogeneous", (rand(2, 3, 3),)),
    ("convert_points_to_homogeneous", (rand(2, 3, 3),)),
    ("convert_affinematrix_to_homography", (rand(2, 2, 3),)),
    ("convert_affinematrix_to_homography3d", (rand(2, 3, 4),)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry
    result = getattr(G, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    expected = getattr(theirs, name)(*args)
    for ours, his in zip(*((y,) if isinstance(y, Tensor) else y for y in (result, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-7, 1e-9)


def test_points_at_infinity_stay_undivided(device):
    p = torch.tensor([[1.0, 2, 0], [3, 4, 1e-9], [4, 2, -2]], device=device, requires_grad=True)
    result = G.convert_points_from_homogeneous(p)
    assert_close(result, torch.tensor([[1.0, 2], [3, 4], [-2, -1]], device=device))
    look = torch.eye(3, device=device)
    assert_close(G.project_points(p, look), result)
    flat = torch.eye(4, device=device)[None] * torch.tensor([1.0, 1, 1, 0], device=device)
    assert_close(G.transform_points(flat, p[None]), p[None])
    (grad,) = torch.autograd.grad(result.sum() + G.project_points(p, look).sum(), p)
    assert grad.isfinite().all()


EYE, ONES = torch.eye(3), torch.ones(2, 4, 3)
BAD = [
    (lambda: G.convert_points_to_homogeneous(torch.ones(())), ValueError, r"of shape \(\*, D\), got \(\)"),
    (lambda: G.convert_points_from_homogeneous(torch.ones(3, 1)), ValueError, "D of at least 2"),
    (lambda: G.convert_affinematrix_to_homography(EYE), ValueError, r"expected A of shape \(\*, 2, 3\), got \(3, 3\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
