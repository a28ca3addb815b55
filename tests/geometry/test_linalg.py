"""Transformations of points, and distances."""

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from kvision.geometry.linalg import inverse3x3, inverse4x4
from op_tests import assert_close
from point_op_tests import Call, PointOpTests, vector

G = K.geometry
P2, P3, MATRIX, POSE = (2, 5, 2), (2, 5, 3), (2, 3, 3), (2, 4, 4)


class TestLinalg(CompositionTests):
    cases = {
        "transform_points": Case(lambda p, m: G.transform_points(m, p), (P3, POSE)),
        "compose_transformations": Case(G.compose_transformations, (POSE, POSE)),
        "inverse_transformation": Case(G.inverse_transformation, (POSE,)),
        "relative_transformation": Case(G.relative_transformation, (POSE, POSE)),
        "point_line_distance": Case(G.point_line_distance, (P2, P3)),
        "euclidean_distance": Case(G.euclidean_distance, (P3, P3)),
        "batched_dot_product": Case(G.batched_dot_product, (P3, P3)),
        "squared_norm": Case(G.squared_norm, (P3,)),
    }
    compiled = ("relative_transformation",)


GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


CALLS = [
    *(("transform_points", (rand(*s, 3, 3), rand(2, 4, 5, 2))) for s in ((), (1,), (2,))),
    ("transform_points", (rand(1, 4, 4), rand(7, 3))),
    ("compose_transformations", (rand(2, 4, 4), rand(1, 4, 4))),
    ("inverse_transformation", (rand(4, 4),)),
    ("relative_transformation", (rand(1, 4, 4), rand(2, 4, 4))),
    ("point_line_distance", (rand(2, 5, 2), rand(2, 5, 3))),
    ("point_line_distance", (rand(2, 5, 3), rand(2, 5, 3))),
    ("euclidean_distance", (rand(2, 5, 3), rand(2, 5, 3))),
    ("batched_dot_product", (rand(2, 5, 3), rand(2, 5, 3), True)),
    ("batched_squared_norm", (rand(2, 5, 3), True)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry
    result = getattr(G, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    expected = getattr(theirs, name)(*args)
    for ours, his in zip(*((y,) if isinstance(y, Tensor) else y for y in (result, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-7, 1e-9)


def test_gradients_where_distances_are_zero(device):
    x = torch.zeros(2, 2, device=device, requires_grad=True)
    rho, phi = G.cart2pol(x[:, 0], x[:, 1])
    line = torch.tensor([[0.0, 0, 1], [1.0, 1, 0]], device=device, requires_grad=True)
    distance = G.point_line_distance(x, line)
    assert_close(distance, torch.tensor([torch.inf, 0], device=device))
    total = rho.sum() + phi.sum() + G.euclidean_distance(x, 0 * x.detach()).sum() + distance[1]
    assert total == 0
    assert all(g.isfinite().all() for g in torch.autograd.grad(total, (x, line)))
    infinite = torch.tensor([1.0, 2, 0], device=device)
    assert G.point_line_distance(infinite, line[1]) == torch.inf


def test_half_types_compute_in_float32(device):
    p, k = rand(2, 5, 3).to(device), 100 * rand(2, 3, 3).to(device)
    for dtype in (torch.float16, torch.bfloat16):
        q = p.to(dtype)
        assert_close(G.project_points(q, k.float()), G.project_points(q.float(), k.float()).to(dtype))
        assert_close(
            G.transform_points(k.to(dtype), q[..., :2]),
            G.transform_points(k.to(dtype).float(), q[..., :2].float()).to(dtype),
        )
    assert G.create_meshgrid(1, 5000, False, device, torch.float16)[0, 0, -1, 0] == 5000
    assert G.transform_points(k.float(), torch.ones(2, 5, 2, dtype=torch.long, device=device)).dtype == torch.float32


@given(st.lists(st.floats(-3, 3), min_size=12, max_size=12), st.floats(0.5, 2))
def test_rigid_transformations(numbers, s):
    a, b = torch.tensor(numbers, dtype=torch.float64).reshape(2, 6)
    A, B = (G.Rt_to_matrix4x4(G.axis_angle_to_rotation_matrix(v[:3]), v[3:, None]) for v in (a, b))
    eye = torch.eye(4, dtype=torch.float64)
    assert_close(G.compose_transformations(A, G.inverse_transformation(A)), eye, 0, 1e-12)
    assert_close(G.compose_transformations(A, G.relative_transformation(A, B)), B, 0, 1e-12)
    p = torch.arange(12, dtype=torch.float64).reshape(1, 4, 3)
    both = G.transform_points(G.compose_transformations(A, B)[None], p)
    assert_close(both, G.transform_points(A[None], G.transform_points(B[None], p)), 0, 1e-11)
    distance = G.euclidean_distance(p[:, :-1], p[:, 1:])
    moved = G.transform_points(A[None], p * s)
    assert_close(G.euclidean_distance(moved[:, :-1], moved[:, 1:]), distance * s, 1e-11, 0)


EYE, ONES = torch.eye(3), torch.ones(2, 4, 3)
BAD = [
    (lambda: G.transform_points(EYE, ONES), ValueError, r"transform_points: expected points_1 of shape \(\*, 2\)"),
    (lambda: G.transform_points(EYE[:2], ONES), ValueError, r"transform_points: expected trans_01 of shape"),
    (lambda: G.transform_points(EYE.expand(3, 3, 3), ONES[..., :2]), ValueError, r"points_1 of shape \(3, \*, 2\)"),
    (lambda: G.transform_points(EYE.expand(2, 3, 3), ONES[0, :2, :2]), ValueError, r"points_1 of shape \(2, \*, 2\)"),
    (lambda: G.inverse_transformation(EYE), ValueError, r"expected trans_12 of shape \(\*, 4, 4\)"),
    (lambda: G.compose_transformations(torch.ones(2, 4, 4), torch.ones(3, 4, 4)), ValueError, "leading axes that broadcast"),
    (lambda: G.point_line_distance(torch.ones(4), torch.ones(3)), ValueError, "point_line_distance: expected point of shape"),
    (lambda: G.euclidean_distance(torch.ones(4), torch.ones(3)), ValueError, "euclidean_distance: expected leading axes"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_inverses_in_closed_form() -> None:
    for inverse, n in ((inverse3x3, 3), (inverse4x4, 4)):
        matrices = torch.randn(2, 50, n, n, dtype=torch.float64, generator=GENERATOR)
        assert_close(inverse(matrices) @ matrices, torch.eye(n, dtype=torch.float64).expand_as(matrices), atol=1e-10)
        assert not inverse(torch.ones(1, n, n)).isfinite().any()


class TestLinalgOperators(PointOpTests):
    calls = {
        "compose_poses": [Call((vector(4, 4),) * 2)],
        "invert_pose": [Call((vector(4, 4),))],
        "relative_pose": [Call((vector(4, 4),) * 2)],
    }
