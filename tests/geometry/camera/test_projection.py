"""Projections by parallel and by central rays."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G, C = K.geometry, K.geometry.camera

P2, P3, K4, K8 = (2, 5, 2), (2, 5, 3), (2, 1, 4), (2, 1, 8)


class TestProjection(CompositionTests):
    cases = {
        "project_points_z1": Case(C.project_points_z1, (P3,)),
        "unproject_points_z1": Case(C.unproject_points_z1, (P2, (2, 5))),
        "dx_project_points_z1": Case(C.dx_project_points_z1, (P3,)),
        "project_points_orthographic": Case(lambda x: C.project_points_orthographic(x).clone(), (P3,)),  # it is a view
        "unproject_points_orthographic": Case(C.unproject_points_orthographic, (P2, (2, 5, 1))),
        "dx_project_points_orthographic": Case(C.dx_project_points_orthographic, (P3,), differentiable=False),
    }
    compiled = ()


def rand(*shape: int, seed: int = 4) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) + 0.1


CALLS = [
    ("project_points_z1", (rand(2, 5, 3),)),
    ("unproject_points_z1", (rand(2, 5, 2),)),
    ("unproject_points_z1", (rand(2, 5, 2), rand(2, 5))),
    ("unproject_points_z1", (rand(2, 5, 2), rand(2, 5, 1))),
    ("dx_project_points_z1", (rand(2, 5, 3),)),
    ("project_points_orthographic", (rand(2, 5, 3),)),
    ("unproject_points_orthographic", (rand(2, 5, 2), rand(2, 5))),
    ("dx_project_points_orthographic", (rand(2, 5, 3),)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry.camera
    expected = getattr(theirs, name)(*args)
    assert_close(getattr(C, name)(*(a.to(device) for a in args)).cpu(), expected, 1e-8, 1e-9)


def test_an_orthographic_projection_is_a_view():
    points = rand(2, 5, 3)
    assert C.project_points_orthographic(points).data_ptr() == points.data_ptr()


@pytest.mark.parametrize("points, depths", [((3, 1, 2), (1, 4, 1)), ((1, 4, 2), (3, 4)), ((2,), ())])
def test_depths_broadcast(points: tuple[int, ...], depths: tuple[int, ...], device):
    x, z = rand(*points).to(device), rand(*depths).to(device)
    column = z if z.dim() == x.dim() else z[..., None]
    for unproject in (C.unproject_points_z1, C.unproject_points_orthographic):
        X = unproject(x, z)
        projected = X[..., :2] / X[..., 2:] if unproject is C.unproject_points_z1 else X[..., :2]
        assert_close(projected, x.expand_as(projected), 1e-12, 0)
        assert torch.equal(X[..., 2:], column.expand_as(X[..., 2:]))


BAD = [
    (lambda: C.project_points_z1([1.0]), TypeError, "project_points_z1: expected points_in_camera to be a Tensor"),
    (lambda: C.unproject_points_z1(rand(2, 2), rand(2, 2)), ValueError, "unproject_points_z1: expected extension of shape"),
    (lambda: C.unproject_points_z1(rand(5, 2), rand()), ValueError, r"expected extension of shape .*, got \(\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
