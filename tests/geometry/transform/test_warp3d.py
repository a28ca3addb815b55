import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from op_tests import assert_close
from warp_tests import FormulaWarpTests, WarpTests, degrees, middle, one

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
    operators = ("warp3d", "warp3d_volume_backward", "warp3d_matrix_backward")
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


class TestRotate3d(FormulaWarpTests):
    function = staticmethod(G.rotate3d)
    operators = (
        *("warp3d_by_formula", "warp3d_volume_backward", "warp3d_matrix_backward"),
        *("affine_matrix3d", "affine_matrix3d_backward"),
    )
    bytes = False
    variants = [{"yaw": one(degrees), "pitch": degrees, "roll": one(degrees), "center": middle}]
    shape = (2, 3, 4, 9, 11)
    small = (1, 1, 3, 4, 3)
    max_size = 3


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


@pytest.mark.native
def test_is_one_operator(device):
    volumes, matrix = torch.rand(2, 1, 4, 5, 6, device=device), homography(torch.ones(2, 1)).float().to(device)
    affine = matrix[:, :3].clone()
    with torch.profiler.profile() as profile:
        G.warp_perspective3d(volumes, matrix, (4, 5, 6))
        G.warp_affine3d(volumes, affine, (4, 5, 6))
    calls = [(e.key, e.count) for e in profile.key_averages() if e.key.startswith(("aten::", "kvision::"))]
    assert [c for c in calls if "empty" not in c[0]] == [("kvision::warp3d", 2)]


def test_identity_of_volumes(device):
    x, eye = torch.rand(2, 1, 4, 5, 6, device=device), torch.eye(4, device=device)[None]
    for align_corners in (True, False):
        for mode in ("bilinear", "nearest"):
            assert torch.equal(G.warp_affine3d(x, eye[:, :3], (4, 5, 6), mode, align_corners=align_corners), x)
            assert torch.equal(G.warp_perspective3d(x, eye, (4, 5, 6), mode, align_corners=align_corners), x)
            assert_close(G.homography_warp3d(x, eye, (4, 5, 6), mode, align_corners=align_corners), x, 0, 2e-6)


VOLUME = torch.rand(1, 1, 3, 4, 3, generator=torch.Generator().manual_seed(2)).double()
FUNCTIONS = {
    "volume": (
        lambda x, m: G.warp_perspective3d(x, m, (2, 3, 3)),
        (VOLUME, torch.eye(4)[None] + 0.03 * torch.rand(1, 4, 4)),
    ),
    "rotate3d": (lambda x, a: G.rotate3d(x, a, a * 0.3, a * 0.7), (VOLUME, torch.tensor([11.0]))),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.warp_affine3d(X, torch.eye(3, 4)[None], (1, 1, 1)), ValueError, "warp_affine3d: expected src of shape"),
    (lambda: G.warp_affine3d(V, torch.eye(3, 4)[None], (1, 1, 1), "bicubic"), ValueError, "warp_affine3d: mode must be"),
    (lambda: G.rotate3d(V, torch.ones(2), torch.ones(1), torch.ones(1)), ValueError, "rotate3d: expected yaw of shape"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
