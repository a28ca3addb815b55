import pytest
import torch
from torch import Tensor

import kvision as K
from kvision._modes import PHOTOMETRIC_DISTANCE
from op_tests import assert_close
from point_op_tests import EYE, SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector
from warp_tests import WarpTests

G = K.geometry


def homography(x: Tensor) -> Tensor:
    m = torch.tensor([[0.93, 0.06, 0.041], [-0.05, 0.97, -0.037], [0.03, -0.02, 1.03]], dtype=torch.float64)
    return m + 0.013 * torch.arange(len(x))[:, None, None]


def target(x: Tensor) -> Tensor:
    """Smooth, and never equal to what is in [0, 1]: no difference changes its sign."""
    rows = torch.linspace(1.2, 1.5, x.shape[2], dtype=torch.float64)
    return (
        (rows[:, None] * torch.linspace(1, 1.3, x.shape[3] + 2, dtype=torch.float64)).expand(*x.shape[:3], -1).clone()
    )


class TestPhotometric(WarpTests):
    function = staticmethod(G.photometric_homography_loss)
    operators = ("photometric", "warp", "warp_image_backward")
    max_size = 7
    bytes = False
    small = (1, 2, 5, 6)
    variants = [
        {"target": target, "src_homo_dst": homography},
        {"target": target, "src_homo_dst": lambda x: homography(x[:1]), "distance": "l2", "align_corners": True},
    ]
    errors = [
        ({"distance": "huber"}, ValueError, "distance must be one of l1, l2, charbonnier; got 'huber'"),
        ({"target": lambda x: x[:, :1]}, ValueError, "expected target of shape"),
        ({"src_homo_dst": lambda x: torch.eye(3)[None, :2]}, ValueError, "expected src_homo_dst of shape"),
        ({"eps": -1.0}, ValueError, "eps"),
    ]


@pytest.mark.parametrize("distance", ["l1", "l2", "charbonnier"])
def test_is_the_mean_over_the_warped_image(distance, device):
    x = torch.rand(2, 3, 40, 50, dtype=torch.float64, device=device)
    y = torch.rand(2, 3, 30, 45, dtype=torch.float64, device=device)
    M = homography(x).to(device).requires_grad_()
    warped = G.homography_warp(x, M, (30, 45))
    difference = warped - y
    value = {"l1": difference.abs(), "l2": difference**2, "charbonnier": (difference**2 + 1e-6).sqrt()}[distance]
    seen = (G.homography_warp(torch.ones_like(x), M, (30, 45)) > 1 - 1e-9).double()
    expected = (value * seen).sum((1, 2, 3)) / seen.sum((1, 2, 3))
    result = G.photometric_homography_loss(x, y, M, distance)
    assert_close(result, expected)
    assert_close(*(torch.autograd.grad(loss.sum(), M)[0] for loss in (result, expected)), 1e-7, 1e-7)


def test_no_pixel_in_view_gives_nan(device):
    far = torch.tensor([[[1.0, 0, 9], [0, 1, 0], [0, 0, 1]]], device=device)
    assert G.photometric_homography_loss(
        torch.ones(1, 1, 4, 4, device=device), torch.ones(1, 1, 4, 4, device=device), far
    ).isnan()


@pytest.mark.parametrize("align_corners, normalized", [(False, True), (True, True), (False, False)])
@pytest.mark.parametrize("distance", ["l1", "l2", "charbonnier"])
def test_normal_equations(distance, align_corners, normalized, device, backend):
    """Against derivatives of every residual; the gradient is that of the loss."""
    x = torch.rand(2, 3, 40, 50, dtype=torch.float64, device=device)
    y = 2 + torch.rand(2, 3, 30, 45, dtype=torch.float64, device=device)
    M = homography(x).to(device)
    if not normalized:
        to_source, from_target = (
            torch.tensor(d).double().diag().to(device) for d in ([25, 20, 1], [1 / 22, 1 / 15, 1])
        )
        M = to_source @ (M + torch.tensor([[0, 0, 0.9], [0, 0, 0.9], [0, 0, 0]], device=device)) @ from_target
    options = (align_corners, normalized)

    def residuals(m: Tensor) -> Tensor:
        if normalized:
            return (G.homography_warp(x, m, (30, 45), align_corners=align_corners) - y).flatten(1)
        return (G.warp_perspective(x, torch.linalg.inv(m), (30, 45)) - y).flatten(1)

    M.requires_grad_()
    loss = G.photometric_homography_loss(x, y, M, distance, 0.01, *options)
    normal, gradient, same = G.photometric_normal_equations(x, y, M, distance, 0.01, *options)
    assert_close(same, loss.detach())
    assert_close(gradient, torch.autograd.grad(loss.sum(), M)[0].flatten(1)[:, :8], 1e-7, 1e-7)
    jacobian = torch.func.jacfwd(lambda m: residuals(m).sum(0))(M.detach())
    jacobian = jacobian.flatten(2)[..., :8].movedim(1, 0)
    ones = torch.ones_like(x)
    seen = G.photometric_homography_loss(ones, torch.zeros_like(y), M.detach(), "l2", 0.01, *options)
    assert_close(seen, torch.ones_like(seen))
    r = residuals(M.detach())
    weight = {"l1": 1 / r.abs(), "l2": 2 + 0 * r, "charbonnier": (r * r + 1e-4).rsqrt()}[distance]
    if normalized:
        inside = (G.homography_warp(ones, M.detach(), (30, 45), align_corners=align_corners) > 1 - 1e-9).flatten(1)
    else:
        inside = (G.warp_perspective(ones, torch.linalg.inv(M.detach()), (30, 45)) > 1 - 1e-9).flatten(1)
    weighted = jacobian * (weight * inside)[..., None]
    assert_close(normal, weighted.mT @ jacobian / inside.sum(1)[:, None, None], 1e-7, 1e-7)


@pytest.mark.parametrize("backend", ["auto", "reference"])
def test_normal_equations_of_one_homography(backend, device):
    x, y = torch.rand(2, 3, 2, 12, 14, dtype=torch.float64, device=device).unbind()
    M = homography(x).to(device)[:1]
    with K.backend(backend):
        shared = G.photometric_normal_equations(x, y, M)
        each = G.photometric_normal_equations(x, y, M.repeat(len(x), 1, 1))
    for a, b in zip(shared, each):
        assert_close(a, b)


def test_normal_equations_without_overlap(device):
    far = torch.tensor([[[1.0, 0, 9], [0, 1, 0], [0, 0, 1]]], device=device)
    image = torch.ones(1, 1, 4, 4, device=device)
    normal, gradient, loss = G.photometric_normal_equations(image, image, far)
    assert not normal.any() and not gradient.any() and loss.isnan().all()


class TestPhotometricOperators(PointOpTests):
    calls = {
        "photometric_normal_equations": [
            Call(
                (vector(3, 8, 9), vector(3, 8, 9), near(EYE, 0.01)),
                (PHOTOMETRIC_DISTANCE["charbonnier"], 0.1, True, True),
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=100,
                broadcasts=False,
                accepted=(" cut along ",),
            )
        ],
    }
