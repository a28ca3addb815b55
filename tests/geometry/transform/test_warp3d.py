import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from op_tests import assert_close
from warp_tests import WarpTests

G = K.geometry


def homography(x: Tensor) -> Tensor:
    """From voxels of the source to those of the result, (B, 4, 4), another one for each sample."""
    m = torch.tensor(
        [
            [0.9137, 0.2341, -0.0513, 1.3717],
            [-0.1309, 1.0739, 0.0917, -1.6133],
            [0.0713, -0.1171, 0.9531, 0.6127],
            [0.0071, -0.0113, 0.0059, 1.09],
        ],
        dtype=torch.float64,
    )
    return m + 0.0171 * torch.arange(len(x))[:, None, None]


class TestWarpPerspective3d(WarpTests):
    function = staticmethod(G.warp_perspective3d)
    operators = ("warp3d", "warp3d_volume_gradient", "warp3d_matrix_gradient")
    bytes = False
    variants = [
        {"M": homography, "dsize": (4, 5, 9)},
        {"M": lambda x: homography(x[:1]), "dsize": (3, 6, 7), "flags": "nearest", "border_mode": "reflection"},
    ]
    shape = (2, 3, 4, 9, 11)
    small = (1, 1, 3, 4, 3)
    max_size = 3
    errors = [
        ({"M": lambda x: torch.eye(3)[None]}, ValueError, r"expected M of shape \(B, 4, 4\)"),
        ({"dsize": (2, 3)}, ValueError, "dsize"),
        ({"flags": "bicubic"}, ValueError, "mode must be one of bilinear, nearest; got 'bicubic'"),
    ]


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
@pytest.mark.parametrize("mode", ["bilinear", "nearest"])
def test_values_and_gradients_are_those_of_grid_sample(mode, padding, align_corners, device):
    x = torch.rand(2, 3, 5, 6, 7, dtype=torch.float64, device=device, requires_grad=True)
    M = (torch.linalg.inv(homography(x).to(device)) * 0.3 + torch.eye(4, device=device)).detach().requires_grad_()
    axes = [(torch.arange(n, dtype=x.dtype, device=device) * 2 + 1 - n) / (n - align_corners) for n in (4, 8, 5)]
    z, y, x_ = torch.meshgrid(*axes, indexing="ij")
    moved = torch.stack([x_, y, z, torch.ones_like(z)], -1) @ M.mT[:, None, None]
    weight = torch.rand(2, 3, 4, 8, 5, dtype=torch.float64, device=device)
    theirs = F.grid_sample(x, moved[..., :3] / moved[..., 3:], mode, padding, align_corners)
    ours = G.homography_warp3d(x, M, (4, 8, 5), mode, padding, align_corners)
    assert_close(ours, theirs)
    for ours_, theirs_ in zip(*(torch.autograd.grad((y * weight).sum(), (x, M)) for y in (ours, theirs))):
        assert_close(ours_, theirs_)


def test_is_one_operator(device):
    volumes, matrix = torch.rand(2, 1, 4, 5, 6, device=device), homography(torch.ones(2, 1)).float().to(device)
    affine = matrix[:, :3].clone()
    with torch.profiler.profile() as profile:
        G.warp_perspective3d(volumes, matrix, (4, 5, 6))
        G.warp_affine3d(volumes, affine, (4, 5, 6))
    calls = [(e.key, e.count) for e in profile.key_averages() if e.key.startswith(("aten::", "kvision::"))]
    assert [c for c in calls if "empty" not in c[0]] == [("kvision::warp3d", 2)]
