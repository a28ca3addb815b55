"""Local affine frames."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close
from point_op_tests import DEGREES, NUMBER, Call, PointOpTests, near, vector

F = K.feature
FRAME = near(torch.tensor([[3.0, 1, 20], [-1, 2, 30]], dtype=torch.float64))
ELLIPSE = near(torch.tensor([5.0, 6, 0.5, 0.1, 0.7], dtype=torch.float64))
HOMOGRAPHY = near(torch.tensor([[1.0, 0.1, 5], [0.2, 1, -3], [0, 0, 1]], dtype=torch.float64), 1e-3)


class TestFrameOperators(PointOpTests):
    calls = {
        "laf_scale": [Call((FRAME,))],
        "rotate_laf": [Call((FRAME, DEGREES))],
        "set_laf_orientation": [Call((FRAME, DEGREES))],
        "laf_from_parts": [
            Call((vector(2), NUMBER, DEGREES)),
            Call((vector(2), None, DEGREES)),
            Call((vector(2), NUMBER, None)),
            Call((vector(2), None, None)),
        ],
        "scale_laf_parts": [Call((FRAME,), (2.0, 3.0, 4.0))],
        "laf_of_peak": [Call((vector(4), NUMBER), (3.0, 2.0, 0.5))],
        "make_upright": [Call((FRAME,), (1e-9,)), Call((FRAME,), (0.5,))],
        "ellipse_to_laf": [Call((ELLIPSE,))],
        "perspective_transform_laf": [Call((HOMOGRAPHY, FRAME))],
    }


GENERATOR = torch.Generator().manual_seed(3)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR)


LAF, ANGLES = 20 * rand(2, 7, 2, 3) - 5, 400 * rand(2, 7, 1) - 200
ELLIPSES = torch.cat([50 * rand(2, 7, 2), 1 + rand(2, 7, 1), 2 * rand(2, 7, 1) - 1, 1 + rand(2, 7, 1)], -1)
IMAGES = torch.zeros(2, 1, 25, 33)
WITH_EMPTY = torch.cat([LAF, torch.zeros(2, 3, 2, 3)], 1)

CALLS = [
    ("get_laf_center", (LAF,)),
    ("get_laf_scale", (WITH_EMPTY,)),
    ("get_laf_orientation", (WITH_EMPTY,)),
    ("laf_is_valid", (WITH_EMPTY,)),
    ("laf_is_filled", (WITH_EMPTY,)),
    ("laf_from_center_scale_ori", (rand(2, 7, 2),)),
    ("laf_from_center_scale_ori", (rand(2, 7, 2), rand(2, 7, 1, 1), ANGLES)),
    ("scale_laf", (LAF, 0.7)),
    ("scale_laf", (LAF, rand(2, 7, 1, 1))),
    ("scale_laf", (LAF, rand(2, 1, 1, 1))),
    ("rotate_laf", (LAF, ANGLES)),
    ("set_laf_orientation", (LAF, ANGLES)),
    ("make_upright", (WITH_EMPTY,)),
    ("ellipse_to_laf", (ELLIPSES,)),
    ("laf_to_boundary_points", (LAF,)),
    ("laf_to_boundary_points", (LAF, 7)),
    ("laf_to_three_points", (LAF,)),
    ("laf_from_three_points", (LAF,)),
    ("laf_is_inside_image", (WITH_EMPTY, IMAGES)),
    ("laf_is_inside_image", (WITH_EMPTY / 4 + 3, IMAGES, 2)),
    ("normalize_laf", (LAF, IMAGES)),
    ("normalize_laf", (LAF, IMAGES[..., :1])),
    ("denormalize_laf", (LAF, IMAGES)),
    ("perspective_transform_lafs", (torch.eye(3) + 0.001 * rand(2, 3, 3), LAF)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").feature
    result = getattr(F, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    assert_close(result.cpu(), getattr(theirs, name)(*args), 1e-9, 1e-9)


def test_outlines_to_draw():
    theirs = pytest.importorskip("kornia").feature.laf
    x, y = F.laf.get_laf_pts_to_draw(LAF, 1)
    expected_x, expected_y = theirs.get_laf_pts_to_draw(LAF, 1)
    assert_close(torch.tensor([x, y]), torch.tensor([expected_x, expected_y]), 1e-6, 1e-6)


def test_ellipse_round_trip():
    """A A^T is the inverse of [[a, b], [b, c]], also for b != 0."""
    A = F.ellipse_to_laf(ELLIPSES)[..., :2]
    _, _, a, b, c = ELLIPSES.unbind(-1)
    matrix = torch.stack([a, b, b, c], -1).unflatten(-1, (2, 2))
    assert_close(torch.linalg.inv(A @ A.mT), matrix, 1e-9, 1e-9)


def test_orientation_is_what_was_set():
    laf = F.set_laf_orientation(LAF, ANGLES)
    turned = (F.get_laf_orientation(laf) - ANGLES + 180) % 360 - 180
    assert turned.abs().max() < 1e-9
    assert_close(F.get_laf_scale(laf), F.get_laf_scale(LAF), 1e-9, 1e-9)
    upright = F.make_upright(F.rotate_laf(laf, ANGLES))
    assert_close(upright, F.make_upright(laf), 1e-7, 1e-7)


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_empty_slots_stay_and_have_finite_gradients(backend):
    slots = torch.zeros(1, 3, 2, 3, dtype=torch.float64, requires_grad=True)
    angles = torch.full((1, 3, 1), 30.0, dtype=torch.float64)
    with K.backend(backend):
        results = [F.make_upright(slots), F.rotate_laf(slots, angles), F.set_laf_orientation(slots, angles)]
        results.append(F.perspective_transform_lafs(torch.eye(3, dtype=torch.float64)[None], slots))
        assert all((y == 0).all() for y in results)
        results += [F.get_laf_scale(slots), F.get_laf_orientation(slots), F.laf_to_boundary_points(slots)]
        (grad,) = torch.autograd.grad(sum(y.sum() for y in results), slots)
    assert grad.isfinite().all()


def test_large_frames_of_half_type_do_not_overflow():
    laf = torch.tensor([[[[300.0, 0, 500], [20, 400, 400]]]], dtype=torch.float16)
    assert F.get_laf_scale(laf).item() == pytest.approx(120000**0.5, rel=1e-3)
    assert F.laf_is_valid(laf).all() and F.make_upright(laf).isfinite().all()


def test_no_frames():
    none = torch.zeros(2, 0, 2, 3)
    for f in (F.get_laf_scale, F.make_upright, F.laf_is_valid, F.laf_is_filled, F.laf_to_boundary_points):
        assert f(none).shape[:2] == (2, 0)
    assert F.rotate_laf(none, torch.zeros(2, 0, 1)).shape == (2, 0, 2, 3)
    assert F.perspective_transform_lafs(torch.eye(3).expand(2, 3, 3), none).shape == (2, 0, 2, 3)


BAD = [
    (lambda: F.get_laf_scale([1]), TypeError, "get_laf_scale: expected LAF to be a Tensor, got list"),
    (lambda: F.get_laf_scale(LAF[0]), ValueError, r"LAF of shape \(B, N, 2, 3\), got \(7, 2, 3\)"),
    (lambda: F.rotate_laf(LAF, ANGLES[:1]), ValueError, r"rotate_laf: expected angles_degrees of shape"),
    (lambda: F.scale_laf(LAF, "2"), TypeError, "scale_laf: expected scale_coef to be a number or a Tensor"),
    (lambda: F.scale_laf(LAF, torch.ones(3)), ValueError, "scale_laf: expected scale_coef of shape"),
    (lambda: F.laf_from_center_scale_ori(rand(2, 7, 2), rand(2, 7, 1)), ValueError, r"scale of shape \(2, 7, 1, 1\)"),
    (lambda: F.ellipse_to_laf(rand(2, 7, 4)), ValueError, r"ells of shape \(B, N, 5\)"),
    (lambda: F.perspective_transform_lafs(torch.eye(3)[None], LAF), ValueError, r"trans_01 of shape \(2, 3, 3\)"),
    (lambda: F.normalize_laf(LAF, LAF[0]), ValueError, "normalize_laf: expected images of shape"),
    (lambda: F.laf_to_boundary_points(LAF, 0), ValueError, "n_pts"),
]


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(
    "function", [lambda x: F.scale_laf(x, 2.0), lambda x: F.normalize_laf(x, torch.rand(1, 1, 8, 9))]
)
def test_negated_views(function):
    """Imaginary parts of conjugates, for which torch has no new_tensor."""
    negated = torch.complex(LAF, -LAF).conj().imag
    assert_close(function(negated), function(LAF), 1e-6, 1e-6)
