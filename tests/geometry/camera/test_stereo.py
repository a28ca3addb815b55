"""Rectified pairs of cameras."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G, C = K.geometry, K.geometry.camera


def pair(shift: Tensor) -> G.StereoCamera:
    left = torch.zeros(*shift.shape, 3, 4, dtype=shift.dtype, device=shift.device)
    left = left + torch.eye(3, 4, dtype=shift.dtype, device=shift.device)
    right = torch.cat(
        [left[..., :3], -shift[:, None, None] * torch.eye(3, 1, dtype=shift.dtype, device=shift.device)], -1
    )
    return G.StereoCamera(left, right)


class TestStereo(CompositionTests):
    cases = {
        "StereoCamera": Case(lambda d, s: pair(s).reproject_disparity_to_3D(d), ((2, 3, 4, 1), (2,))),
    }
    compiled = ("StereoCamera",)


def rand(*shape: int, seed: int = 4) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) + 0.1


def cameras(batch: int) -> tuple[Tensor, Tensor]:
    left = torch.zeros(batch, 3, 4, dtype=torch.float64)
    left[:, :, :3] = torch.tensor([[100.0, 0, 32], [0, 90, 20], [0, 0, 1]])
    right = left.clone()
    right[:, 0, 3] = -20 - torch.arange(batch)
    return left, right


@pytest.mark.parametrize("batch", [1, 2])
def test_stereo_equals_kornia(batch, device):
    theirs = pytest.importorskip("kornia").geometry
    ours, his = G.StereoCamera(*(c.to(device) for c in cameras(batch))), theirs.StereoCamera(*cameras(batch))
    for name in ("fx", "fy", "cx_left", "cx_right", "cy", "tx", "Q"):
        assert_close(getattr(ours, name).cpu(), getattr(his, name))
    disparity = 10 * rand(2, 4, 5, 1)
    disparity[0, 0, 0] = 0
    for a, b in zip(
        ours.reproject_disparity_to_3D(disparity.to(device), True), his.reproject_disparity_to_3D(disparity, True)
    ):
        assert_close(a.cpu(), b, 1e-9, 1e-9)
    assert ours.batch_size == batch
    assert ours.device.type == device.type


def test_stereo_depth(device):
    """A point seen by both cameras comes back."""
    left, right = (c.to(device) for c in cameras(1))
    point = torch.tensor([[0.2, -0.1, 4.0]], dtype=torch.float64, device=device)
    seen = [G.transform_points(torch.cat([P, P.new_tensor([[[0, 0, 0, 1]]])], 1), point) for P in (left, right)]
    (u, v), (u2, _) = (G.convert_points_from_homogeneous(p)[0] for p in seen)
    x, y = int(u.round()), int(v.round())
    disparity = (u - u2).reshape(1, 1, 1, 1).expand(1, 40, 64, 1)
    result = G.StereoCamera(left, right).reproject_disparity_to_3D(disparity)[0, y, x]
    assert_close(result[2], point[0, 2])
    assert (result - point[0]).abs().max() < 0.5 * 4 / 90


def test_principal_points_of_a_pair_may_differ(device):
    """Z = f b / (d + cx_right - cx_left), as of the pairs of Middlebury."""
    left, right = (c.to(device) for c in cameras(2))
    right[:, 0, 2] += torch.tensor([3.0, -5.5], device=device)
    disparity = (10 + 5 * rand(2, 4, 5, 1)).to(device)
    ours = G.StereoCamera(left, right)
    z = (ours.fx * ours.tx)[:, None, None, None] / (disparity + (right - left)[:, 0, 2, None, None, None])
    result = ours.reproject_disparity_to_3D(disparity)
    assert_close(result[..., 2:], z)
    # Both cameras see the points at pixels that are as far apart as the disparity says.
    seen = [
        G.project_points(result, camera[:, None, None, :, :3]) + camera[:, None, None, :2, 3] / result[..., 2:]
        for camera in (left, right)
    ]
    assert_close(seen[0] - seen[1], torch.cat([disparity, torch.zeros_like(disparity)], -1), 1e-9, 1e-9)
    columns = torch.arange(5, dtype=torch.float64, device=device).expand(2, 4, 5)
    assert_close(seen[0][..., 0], columns, 1e-9, 1e-9)


LEFT, RIGHT = cameras(1)
BAD = [
    (lambda: G.StereoCamera(LEFT[0], RIGHT[0]), ValueError, "StereoCamera: expected rectified_left_camera of shape"),
    (lambda: G.StereoCamera(LEFT, 2 * RIGHT), ValueError, "StereoCamera: expected cameras that are equal but"),
    (lambda: G.StereoCamera(LEFT, LEFT), ValueError, r"expected rectified_right_camera\[:, 0, 3\] to be negative"),
    (lambda: G.StereoCamera(LEFT, RIGHT.float()), TypeError, "StereoCamera: expected cameras of one type"),
    (lambda: G.StereoCamera(LEFT, RIGHT).reproject_disparity_to_3D(rand(1, 3, 4)), ValueError, "expected disparity_tensor"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
