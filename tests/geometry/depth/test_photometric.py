"""The photometric distance of views warped by depth."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from depth_scenes import camera, depth, motion
from kvision._modes import INTERPOLATION, PADDING
from op_tests import assert_close
from warp_tests import FLOAT_COORDS, WarpTests, one

G = K.geometry


def projection(x: Tensor) -> Tensor:
    k, m = camera(x), motion(x)
    return torch.cat([k @ m[:, :3, :3] @ torch.linalg.inv(k), k @ m[:, :3, 3:]], 2)


def views_of(x: Tensor) -> Tensor:
    return torch.stack([x, x.flip(3)], 1)


def target(x: Tensor) -> Tensor:
    """Smooth, and never equal to what is in [0, 1]: no difference changes its sign."""
    rows = torch.linspace(1.2, 1.5, x.shape[2], dtype=torch.float64)
    return (rows[:, None] * torch.linspace(1, 1.3, x.shape[3], dtype=torch.float64)).expand(*x.shape[:3], -1).clone()


class TestPhotometricDepth(WarpTests):
    operators = ("photometric_depth", "depth_warp", "depth_warp_image_backward")
    bytes = False
    max_size = 7
    small = (1, 1, 4, 4)
    tolerances = {**FLOAT_COORDS, torch.float32: (5e-5, 5e-5)}
    variants = [
        {"target": target, "depth": depth, "projections": lambda x: torch.stack([projection(x)] * 2, 1)},
        {
            "target": one(target),
            "depth": one(depth),
            "projections": lambda x: torch.stack([projection(x)] * 2, 1),
            "distance": "charbonnier",
        },
    ]
    errors = [
        ({"distance": "huber"}, ValueError, "distance must be one of l1, l2, charbonnier; got 'huber'"),
        ({"target": lambda x: x[:, :1]}, ValueError, "expected target of shape"),
        ({"projections": lambda x: torch.eye(3)[None, None]}, ValueError, "expected projections of shape"),
    ]

    def function(self, input: Tensor, **kwargs) -> Tensor:
        return G.photometric_depth_loss(views_of(input), **kwargs)

    function.__name__ = "photometric_depth_loss"

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the views are made by this test")

    def test_vmap(self, variant, device):
        pytest.skip("the views of a sample are made of another one")


@pytest.mark.parametrize("distance", ["l1", "l2", "charbonnier"])
def test_is_the_mean_over_the_warped_views(distance, device):
    x = torch.rand(2, 3, 15, 19, dtype=torch.float64, device=device)
    views, y, d = views_of(x), torch.rand_like(x), depth(x).to(device).requires_grad_()
    projections = torch.stack([projection(x), projection(x).flip(0)], 1).to(device).requires_grad_()
    total = terms = 0
    for i in range(2):
        warped, seen = (
            G.depth.warp.depth_warp_of(v, d, projections[:, i], INTERPOLATION["bilinear"], PADDING["fill"], True)
            for v in (views[:, i], torch.ones_like(y))
        )
        difference, seen = warped - y, (seen > 1 - 1e-9).double()
        value = {"l1": difference.abs(), "l2": difference**2, "charbonnier": (difference**2 + 1e-6).sqrt()}[distance]
        total, terms = total + (value * seen).sum((1, 2, 3)), terms + seen.sum((1, 2, 3))
    result, expected = G.photometric_depth_loss(views, y, d, projections, distance), total / terms.detach()
    assert_close(result, expected)
    for a, e in zip(*(torch.autograd.grad(loss.sum(), (d, projections)) for loss in (result, expected))):
        assert_close(a, e, 1e-7, 1e-7)


def test_no_pixel_in_view_gives_nan(device):
    x = torch.ones(1, 1, 4, 4, device=device)
    d = torch.zeros_like(x, requires_grad=True)
    loss = G.photometric_depth_loss(x[:, None], x, d, torch.eye(3, 4, device=device)[None, None])
    loss.backward()
    assert loss.isnan()
    assert not d.grad.any()
