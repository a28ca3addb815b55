"""Matrices of transformations."""

import pytest
import torch

import kvision as K
from op_tests import assert_close
from point_op_tests import CUBE, DEGREES, EYE, SMALL, Call, PointOpTests, near, vector
from point_op_tests import SQUARE as RECTANGLE

G = K.geometry
SQUARE = torch.tensor([[[0.0, 0], [1, 0], [1, 1], [0, 1]]])
QUAD = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])


def test_shears_in_space_keep_their_center(device):
    center = torch.tensor([[1.0, 2, 3]], device=device)
    angles = {
        name: torch.tensor([0.1 * i], device=device)
        for i, name in enumerate(("sxy", "sxz", "syx", "syz", "szx", "szy"))
    }
    M = G.get_shear_matrix3d(center, **angles)
    assert_close((M[:, :3, :3] @ center[..., None])[..., 0] + M[:, :3, 3], center)


def test_perspective_of_points_on_a_line_is_not_finite(device):
    line = torch.tensor([[[0.0, 0], [1, 1], [2, 2], [0, 3]]], device=device)
    assert not G.get_perspective_transform(line, SQUARE.to(device)).isfinite().all()


FUNCTIONS = {
    "perspective": (G.get_perspective_transform, (SQUARE + 0.1 * QUAD, QUAD)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


def test_gradients_without_rotation_are_finite(device):
    angles = torch.zeros(1, 3, device=device, requires_grad=True)
    ones = torch.ones(1, 3, device=device)
    (grad,) = torch.autograd.grad(G.get_projective_transform(ones, angles, ones)[0, 0, 1], angles)
    assert grad.isfinite().all() and grad.any()


BAD = [
    (lambda: G.get_rotation_matrix2d(torch.ones(1, 2), torch.ones(2), torch.ones(1, 2)), ValueError, "of one batch size"),
    (lambda: G.get_rotation_matrix2d(torch.ones(1, 2).int(), torch.ones(1), torch.ones(1, 2)), TypeError, "center to be floating"),
    (lambda: G.get_perspective_transform(QUAD, QUAD.double()), TypeError, "get_perspective_transform: expected points of one"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


class TestMatricesOperators(PointOpTests):
    calls = {
        "affine_matrix2d": [
            Call((DEGREES, vector(2), vector(2), SMALL, SMALL, vector(2)), (-1.0, 0.0, 0.0, 3)),
            Call((DEGREES, None, vector(2), None, SMALL, None), (1.0, 3.5, 2.0, 2)),
            Call((DEGREES, None, None, None, None, None), (1.0, 3.5, 2.0, 2)),
        ],
        "translation_matrix2d": [Call((vector(2),), (0.0, 0.0, 2)), Call((vector(2),), (0.5, -1.5, 3))],
        "scale_matrix2d": [Call((vector(2), vector(2)), (0.0, 0.0)), Call((vector(2), None), (3.5, 2.0))],
        "shear_factor_matrix2d": [Call((vector(2),))],
        "translation_matrix3d": [Call((vector(3),), (0.5, 0.0, -1.5, 3)), Call((vector(3),), (0.0, 0.0, 0.0, 4))],
        "affine_matrix3d": [
            Call((*[DEGREES] * 3, *[vector(3)] * 3, *[SMALL] * 6), (-1.0, 0.0, 0.0, 0.0, 4)),
            Call((*[DEGREES] * 3, *[None] * 9), (1.0, 3.5, 2.0, 1.0, 3)),
        ],
        "shear_matrix2d": [Call((vector(2), SMALL, SMALL)), Call((vector(2), None, SMALL))],
        "shear_matrix3d": [Call((vector(3), *[SMALL] * 6)), Call((vector(3), *[None] * 5, SMALL))],
        "invert_affine2d": [Call((near(EYE[:2]),))],
        "perspective_matrix": [Call((near(RECTANGLE), near(RECTANGLE)))],
        "perspective_matrix3d": [
            Call((near(CUBE), near(2 * CUBE)), (0.0, 0.0, 0.0)),
            Call((near(CUBE), None), (4.0, 3.0, 5.0)),
        ],
        "crop_matrix": [
            Call((near(RECTANGLE), vector(2)), (4.0, 3.0)),
            Call((near(RECTANGLE), None), (4.0, 1.0)),
        ],
    }


def test_shears_may_be_columns(device):
    zero, one, angle, shear = (
        x.to(device) for x in (torch.zeros(3, 2), torch.ones(3, 2), torch.rand(3), torch.rand(2, 3))
    )
    expected = G.get_affine_matrix2d(zero, one, one, angle, shear[0], shear[1])
    assert torch.equal(G.get_affine_matrix2d(zero, one, one, angle, shear[0, :, None], shear[1, :, None]), expected)
    assert torch.equal(G.get_shear_matrix2d(one, shear[0, :, None]), G.get_shear_matrix2d(one, shear[0]))
