"""Rotations in all their forms: SciPy's values, round trips, and gradients where formulas divide 0 by 0."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close
from point_op_tests import EYE, Call, PointOpTests, near, vector

G = K.geometry
V, Q, R = (2, 5, 3), (2, 5, 4), (2, 5, 3, 3)


class TestRotations(CompositionTests):
    compiled = ("axis_angle_to_rotation_matrix", "rotation_matrix_to_axis_angle")
    cases = {
        "axis_angle_to_rotation_matrix": Case(G.axis_angle_to_rotation_matrix, (V,)),
        "axis_angle_to_quaternion": Case(G.axis_angle_to_quaternion, (V,)),
        "quaternion_to_axis_angle": Case(G.quaternion_to_axis_angle, (Q,)),
        "quaternion_to_rotation_matrix": Case(G.quaternion_to_rotation_matrix, (Q,)),
        "rotation_matrix_to_quaternion": Case(G.rotation_matrix_to_quaternion, (R,)),
        "rotation_matrix_to_axis_angle": Case(G.rotation_matrix_to_axis_angle, (R,)),
        "normalize_quaternion": Case(G.normalize_quaternion, (Q,)),
        "quaternion_log_to_exp": Case(G.quaternion_log_to_exp, (V,)),
        "quaternion_exp_to_log": Case(G.quaternion_exp_to_log, (Q,)),
        "vector_to_skew_symmetric_matrix": Case(G.vector_to_skew_symmetric_matrix, (V,)),
    }


def axes() -> torch.Tensor:
    """Axes times angles: any, small, tiny, half turns and near them, none."""
    generator = torch.Generator().manual_seed(1)
    v = torch.randn(200, 3, dtype=torch.float64, generator=generator)
    unit = v / v.norm(dim=1, keepdim=True)
    eye = torch.eye(3, dtype=torch.float64)
    near = [unit * angle for angle in (math.pi, math.pi - 1e-7, 3.0, 0.04, 0.03, 1e-4, 1e-12)]
    return torch.cat([1.5 * v, *near, math.pi * eye, -math.pi * eye, 0 * eye])


@pytest.fixture(scope="module")
def rotation():
    return pytest.importorskip("scipy.spatial.transform").Rotation.from_rotvec(axes().numpy())


def from_numpy(x, device):
    return torch.from_numpy(np.ascontiguousarray(x)).to(device)


def up_to_sign(a: torch.Tensor, b: torch.Tensor) -> float:
    return torch.minimum((a - b).abs().amax(-1), (a + b).abs().amax(-1)).max().item()


def test_values_are_those_of_scipy(rotation, device):
    v = axes().to(device)
    matrix = from_numpy(rotation.as_matrix(), device)
    quaternion = from_numpy(rotation.as_quat(), device).roll(1, -1)
    assert_close(G.axis_angle_to_rotation_matrix(v), matrix, 0, 1e-14)
    assert_close(G.quaternion_to_rotation_matrix(-3 * quaternion), matrix, 0, 1e-14)
    assert up_to_sign(G.axis_angle_to_quaternion(v), quaternion) < 1e-14
    assert up_to_sign(G.rotation_matrix_to_quaternion(matrix), quaternion) < 1e-14
    assert_close(G.axis_angle_to_rotation_matrix(G.rotation_matrix_to_axis_angle(matrix)), matrix, 0, 1e-14)
    small = v.norm(dim=1) < 3.1
    assert_close(
        G.rotation_matrix_to_axis_angle(matrix)[small], from_numpy(rotation.as_rotvec(), device)[small], 0, 1e-13
    )
    euler = from_numpy(rotation.as_euler("xyz"), device).unbind(-1)
    assert_close(G.euler_from_quaternion(*(2 * quaternion).unbind(-1)), euler, 0, 1e-12)


def test_values_in_float32(rotation, device):
    v, matrix = axes().float().to(device), from_numpy(rotation.as_matrix(), device).float()
    assert_close(G.axis_angle_to_rotation_matrix(v), matrix, 0, 2e-6)
    assert_close(G.axis_angle_to_rotation_matrix(G.rotation_matrix_to_axis_angle(matrix)), matrix, 0, 2e-6)
    for dtype in (torch.float16, torch.bfloat16):
        half = G.axis_angle_to_quaternion(v.to(dtype))
        assert half.dtype == dtype
        assert_close(half, G.axis_angle_to_quaternion(v.to(dtype).float()).to(dtype))


def test_values_are_those_of_kornia(device):
    theirs = pytest.importorskip("kornia").geometry
    v = axes()
    q = theirs.axis_angle_to_quaternion(v)
    matrix = theirs.axis_angle_to_rotation_matrix(v)
    for name, x in (
        ("rotation_matrix_to_quaternion", matrix),
        ("quaternion_to_axis_angle", q),
        ("quaternion_exp_to_log", q),
        ("quaternion_log_to_exp", v),
        ("normalize_quaternion", 3 * q),
        ("vector_to_skew_symmetric_matrix", v),
    ):
        # At a half turn either sign of the axis is right.
        known = slice(None) if name != "quaternion_to_axis_angle" else q[:, 0].abs() > 1e-6
        assert_close(getattr(G, name)(x.to(device)).cpu()[known], getattr(theirs, name)(x)[known], 1e-7, 1e-9)
    t = torch.rand(len(v), 3, 1, dtype=torch.float64)
    for name in ("ARKitQTVecs_to_ColmapQTVecs", "ColmapQTVecs_to_ARKitQTVecs"):
        results = [x.cpu() for x in getattr(G, name)(q.to(device), t.to(device))]
        expected = getattr(theirs, name)(q, t)
        assert up_to_sign(results[0], expected[0]) < 1e-12
        assert_close(results[1], expected[1], 0, 1e-12)


def test_rodrigues_equals_opencv():
    cv2 = pytest.importorskip("cv2")
    for v in axes()[::29]:
        matrix, derivative = cv2.Rodrigues(v.numpy())
        assert_close(G.axis_angle_to_rotation_matrix(v), torch.from_numpy(matrix), 0, 1e-12)
        ours = torch.func.jacrev(G.axis_angle_to_rotation_matrix)(v).flatten(0, 1).T
        assert_close(ours, torch.from_numpy(derivative), 0, 1e-9)


SINGULAR = {
    "axis_angle_to_rotation_matrix": [[0.0, 0, 0], [math.pi, 0, 0], [1e-30, 0, 0]],
    "axis_angle_to_quaternion": [[0.0, 0, 0], [2 * math.pi, 0, 0], [1e-30, 0, 0]],
    "quaternion_to_rotation_matrix": [[1.0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0], [1e-20, 0, 0, 1e-22]],
    "quaternion_to_axis_angle": [[1.0, 0, 0, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0], [1, 1e-25, 0, 0], [1e-25, 1, 0, 0]],
    "quaternion_exp_to_log": [[1.0, 0, 0, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]],
    "quaternion_log_to_exp": [[0.0, 0, 0], [math.pi, 0, 0]],
    "normalize_quaternion": [[1.0, 0, 0, 0], [0, 0, 0, 0], [1e-13, 0, 0, 0]],
    "rotation_matrix_to_quaternion": [[1.0, 0, 0, 0, 1, 0, 0, 0, 1], [-1, 0, 0, 0, -1, 0, 0, 0, 1], [1, 0, 0, 0, -1, 0, 0, 0, -1]],
    "rotation_matrix_to_axis_angle": [[1.0, 0, 0, 0, 1, 0, 0, 0, 1], [-1, 0, 0, 0, 1, 0, 0, 0, -1], [0, 0, 1, 1, 0, 0, 0, 1, 0]],
}  # fmt: skip


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", SINGULAR)
def test_derivatives_are_finite(name, dtype, device):
    """Of first and second order, at no rotation, at half turns, and for what is no rotation at all."""
    x = torch.tensor(SINGULAR[name], dtype=dtype, device=device)
    if name.startswith("rotation_matrix"):
        x = x.reshape(-1, 3, 3)
    x.requires_grad_()
    y = getattr(G, name)(x)
    (grad,) = torch.autograd.grad(y.sum(), x, create_graph=True)
    assert y.isfinite().all()
    assert grad.isfinite().all()
    (second,) = torch.autograd.grad(grad.sum(), x, allow_unused=True)
    assert second is None or second.isfinite().all()


def test_derivatives_at_no_rotation(device):
    zero = torch.zeros(3, dtype=torch.float64, device=device, requires_grad=True)
    back = [G.rotation_matrix_to_axis_angle, G.quaternion_to_axis_angle]
    there = [G.axis_angle_to_rotation_matrix, G.axis_angle_to_quaternion]
    for f, g in zip(there, back):
        jacobian = torch.autograd.functional.jacobian(lambda v, f=f, g=g: g(f(v)), zero)
        assert_close(jacobian, torch.eye(3, dtype=torch.float64, device=device))


@given(st.lists(st.floats(-10, 10), min_size=6, max_size=6))
def test_composition_and_inverse(numbers):
    a, b = torch.tensor(numbers, dtype=torch.float64).split(3)
    A, B = G.axis_angle_to_rotation_matrix(a), G.axis_angle_to_rotation_matrix(b)
    eye = torch.eye(3, dtype=torch.float64)
    assert_close(A @ G.axis_angle_to_rotation_matrix(-a), eye, 0, 1e-12)
    v = G.rotation_matrix_to_axis_angle(A @ B)
    assert v.norm() <= math.pi + 1e-12
    assert_close(G.axis_angle_to_rotation_matrix(v), A @ B, 0, 1e-12)
    # A turns the axis of B with everything else.
    assert_close(G.axis_angle_to_rotation_matrix(A @ b), A @ B @ A.T, 0, 1e-11)


def test_leading_axes_and_integers(device):
    assert G.axis_angle_to_rotation_matrix(torch.zeros(3, device=device)).shape == (3, 3)
    assert G.quaternion_to_axis_angle(torch.rand(2, 0, 3, 4, device=device)).shape == (2, 0, 3, 3)
    assert G.quaternion_to_rotation_matrix(torch.tensor([1, 0, 0, 0], device=device)).dtype == torch.float32


BAD = [
    (lambda: G.axis_angle_to_rotation_matrix([0.0]), TypeError, "axis_angle_to_rotation_matrix: expected axis_angle to be a T"),
    (lambda: G.axis_angle_to_quaternion(torch.ones(2)), ValueError, r"expected axis_angle of shape \(\*, 3\), got \(2,\)"),
    (lambda: G.quaternion_to_axis_angle(torch.ones(3)), ValueError, r"expected quaternion of shape \(\*, 4\)"),
    (lambda: G.rotation_matrix_to_quaternion(torch.ones(3)), ValueError, r"rotation_matrix of shape \(\*, 3, 3\)"),
    (lambda: G.rotation_matrix_to_quaternion(2 * torch.eye(3), check_rotation=True), ValueError, "of rotations"),
    (lambda: G.rotation_matrix_to_axis_angle(-torch.eye(3), True), ValueError, "rotation_matrix_to_axis_angle: expected rot"),
    (lambda: G.normalize_quaternion(torch.ones(4), -1), ValueError, "normalize_quaternion: expected eps"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


class TestRotationsOperators(PointOpTests):
    calls = {
        "rotation_matrix_to_axis_angle": [Call((near(EYE),))],
        "axis_angle_to_rotation_matrix": [Call((vector(3, scale=2),))],
        "quaternion_exponential": [Call((vector(3),), (0.5,))],
        "quaternion_to_axis_angle": [Call((vector(4),))],
        "quaternion_to_rotation_matrix": [Call((vector(4),))],
        "rotation_matrix_to_quaternion": [Call((near(EYE),)), Call((near(-EYE),))],
        "cross_matrix": [Call((vector(3),))],
        "normalize_quaternion": [Call((vector(4),), (1e-12,)), Call((vector(4),), (3.0,))],
        "quaternion_logarithm": [Call((vector(4),))],
    }
