"""The kernels behind transform_points, project_points and unproject_points: images of points (B, 3, H, W), as OpTests has them."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision._modes import POINT_MAP
from kvision.geometry._transform_points import _transform_points, transformed
from op_tests import OpTests, assert_close

G = K.geometry


def matrices(rows: int, columns: int):
    def made(x: Tensor) -> Tensor:
        numbers = torch.linspace(0.3, 1.1, x.shape[0] * rows * columns, dtype=torch.float64)
        return numbers.sin().reshape(x.shape[0], rows, columns) + 0.3

    return made


def cameras(x: Tensor) -> Tensor:
    return matrices(3, 3)(x)[:, None, None] + 0.5


class PointMaps(OpTests):
    operators = ("transform_points", "transform_points_backward")
    mixed = ("grad", "points", "depth")
    accepted = ("points without rows", "points cut along axis -2", "matrix cut along axis -2")  # fewer points, (3, 4)
    channels = 3
    shape = (2, 3, 7, 9)
    small = (2, 3, 1, 3)
    max_size = 9

    test_wrong_kinds = None  # of points, not of images: test_points.py

    def input(self, shape, dtype, device):
        if dtype in (torch.uint8, torch.int32):
            return torch.randint(1, 9, shape, dtype=dtype, device=device)
        return (torch.rand(shape, dtype=torch.float64) + 0.3).to(dtype).to(device)

    def call(self, x, kwargs):
        return self.function(x.movedim(1, -1), **kwargs).movedim(-1, 1)


class TestTransform(PointMaps):
    function = staticmethod(lambda p, M: transformed(p if p.is_floating_point() else p.float(), M))
    variants = [{"M": matrices(4, 4)}, {"M": matrices(3, 4)}, {"M": lambda x: matrices(4, 4)(torch.zeros(1))}]


class TestTransformOfThePlane(PointMaps):
    function = staticmethod(lambda p, M: G.transform_points(M, p[..., :2]))
    variants = [{"M": matrices(3, 3)}]


class TestProject(PointMaps):
    function = staticmethod(G.project_points)
    variants = [{"camera_matrix": cameras}, {"camera_matrix": lambda x: cameras(torch.zeros(1))[0, 0, 0]}]


class TestUnproject(PointMaps):
    variants = [{"camera_matrix": cameras}, {"camera_matrix": cameras, "normalize": True}]

    @staticmethod
    def function(p, camera_matrix, normalize=False):
        return G.unproject_points(p[..., :2], p[..., 2:], camera_matrix, normalize)


class TestMeet(PointMaps):
    channels = 2
    shape, small = (2, 2, 7, 9), (2, 2, 1, 3)
    empty = ()  # planes and cameras are no parameters of a whole batch
    camera = staticmethod(lambda x: torch.tensor([[[0.9, 0, 0.4], [0, 1.1, 0.3], [0, 0, 1]]]).double())
    variants = [
        {
            "normal": lambda x: torch.tensor([[0.2, -0.1, 1.0]]).double().repeat(len(x), 1),
            "camera": camera,
            "eps": 1e-8,
        },
        {"normal": lambda x: torch.tensor([[0.5, 1.0, 0.1]]).double(), "camera": camera, "eps": 0.2},
    ]

    @staticmethod
    def function(p, normal, camera, eps):
        shape, normal = p.shape[:-1], normal.to(p.dtype if p.is_floating_point() else torch.float32)
        offset = normal[:, 2:] + 0.5
        return G.depth_from_plane_equation(normal, offset, p.flatten(1, 2), camera, eps).reshape(*shape, 1)


KINDS = [
    *(("transform", 2, (3, 3)), ("transform", 3, (4, 4)), ("transform", 3, (3, 4)), ("project", 3, (3, 3))),
    *(("unproject", 2, (3, 3)), ("unproject_distance", 2, (3, 3)), ("intersect", 2, (1, 9))),
]


@pytest.mark.native
@pytest.mark.parametrize("kind, axes, sizes", KINDS, ids=[f"{k}-{a}-{s}" for k, a, s in KINDS])
@pytest.mark.parametrize("count", [1, 3, 4, 1024, 9001])
def test_numbers_of_points(kind, axes, sizes, count, device):
    """Fours and what is left of them, one part and several, one matrix and one for each."""
    for batch, own in itertools.product((1, 3), (False, True)):
        inputs = [torch.rand(batch, count, axes) + 0.2, torch.rand(batch if own else 1, *sizes) + 0.3]
        if kind.startswith("unproject"):
            inputs.append(torch.rand(batch, count, 1) + 0.2)
        leaves = [x.to(device).requires_grad_() for x in inputs]

        def both(leaves):
            y = _transform_points(leaves[0], leaves[2] if len(leaves) > 2 else None, leaves[1], POINT_MAP[kind])
            weights = torch.linspace(0, 1, y.numel(), device=device, dtype=y.dtype).reshape(y.shape)
            return y, *torch.autograd.grad((y * weights).sum(), leaves)

        with K.backend("reference"):
            expected = both([x.detach().double().requires_grad_() for x in leaves])
        for a, e in zip(both(leaves), expected):
            assert_close(a, e.float(), 5e-5, 5e-6 * e.abs().max().item())


def test_points_in_any_memory(device):
    """What does not begin at 16 bytes, and what is not dense."""
    M = matrices(4, 4)(torch.zeros(1)).float().to(device)
    storage = torch.rand(1, 401, 3, device=device)
    for points in (
        storage[:, 1:],
        storage.flatten()[1:-2].reshape(1, 400, 3),
        storage[..., [2, 1, 0]].flip(1),
        storage[:, ::2],
    ):
        assert_close(
            G.transform_points(M, points), G.transform_points(M, points.clone(memory_format=torch.contiguous_format))
        )


def test_no_points(device):
    M = torch.eye(4, device=device)[None].requires_grad_()
    y = G.transform_points(M, torch.zeros(1, 0, 3, device=device))
    (grad,) = torch.autograd.grad(y.sum(), M)
    assert y.shape == (1, 0, 3)
    assert_close(grad, torch.zeros(1, 4, 4, device=device))


def test_points_that_are_not_divided(device):
    """Within 1e-8 of depth 0; their gradient to it is 0."""
    p = torch.tensor([[1.0, 2, 0], [1, 2, -1e-9], [1, 2, 1e-7], [1, 2, torch.nan]], device=device, requires_grad=True)
    k = torch.tensor([[2.0, 0, 3], [0, 4, 5], [0, 0, 1]], device=device)
    y = G.project_points(p, k)
    assert_close(y[:2], torch.tensor([[5.0, 13], [5, 13]], device=device))
    (grad,) = torch.autograd.grad(y[:2].sum(), p)
    assert_close(grad[:2], torch.tensor([[2.0, 4, 0], [2, 4, 0]], device=device))
    with K.backend("reference"):
        assert_close(G.project_points(p, k).detach(), y.detach())


def test_cameras_of_any_axes(device):
    """All ways in which leading axes broadcast, compared with a loop over the points."""
    for points, cameras in itertools.product(
        ((), (5,), (2, 5), (1, 5), (3, 2, 5)), ((), (5,), (1,), (2, 1), (2, 5), (3, 1, 1))
    ):
        p, k = torch.rand(*points, 3, device=device) + 0.5, torch.rand(*cameras, 3, 3, device=device)
        aligned = (*cameras, 1) if len(cameras) < len(points) else cameras
        try:
            leading = torch.broadcast_shapes(points, aligned)
        except RuntimeError:
            with pytest.raises(ValueError, match="leading axes"):
                G.project_points(p, k)
            continue
        each = p.expand(*leading, 3), k.reshape(*aligned, 3, 3).expand(*leading, 3, 3)
        focal, center = each[1].diagonal(dim1=-2, dim2=-1)[..., :2], each[1][..., :2, 2]
        assert_close(G.project_points(p, k), focal * each[0][..., :2] / each[0][..., 2:] + center)


@pytest.mark.parametrize("batch", [(), (1,), (2,)])
def test_projections_of_space_to_the_plane(batch, device):
    projection = torch.rand(*batch, 3, 4, dtype=torch.float64, device=device, requires_grad=True)
    points = torch.rand(2, 5, 3, dtype=torch.float64, device=device, requires_grad=True)
    result = G.transform_points(projection, points)
    homogeneous = torch.cat([points, torch.ones_like(points[..., :1])], -1) @ projection.mT
    assert_close(result, homogeneous[..., :2] / homogeneous[..., 2:])
    assert torch.autograd.gradcheck(G.transform_points, (projection, points))
    kornia = pytest.importorskip("kornia").geometry
    if batch:
        assert_close(result, kornia.transform_points(projection, points))


@pytest.mark.parametrize("n", [1, 4])
def test_points_of_other_dimensions(n, device):
    """There is no kernel for points on a line or in four dimensions: the reference transforms them."""
    matrix, points = torch.eye(n + 1, device=device) + 0.1, torch.rand(2, 5, n, device=device)
    homogeneous = torch.cat([points, torch.ones_like(points[..., :1])], -1) @ matrix.mT
    assert_close(G.transform_points(matrix, points), homogeneous[..., :-1] / homogeneous[..., -1:])
