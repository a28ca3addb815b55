import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close
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
    operators = ("photometric", "warp", "warp_image_gradient")
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
    found = G.photometric_homography_loss(x, y, M, distance)
    assert_close(found, expected)
    assert_close(*(torch.autograd.grad(loss.sum(), M)[0] for loss in (found, expected)), 1e-7, 1e-7)


def test_where_nothing_is_seen(device):
    far = torch.tensor([[[1.0, 0, 9], [0, 1, 0], [0, 0, 1]]], device=device)
    assert G.photometric_homography_loss(
        torch.ones(1, 1, 4, 4, device=device), torch.ones(1, 1, 4, 4, device=device), far
    ).isnan()
