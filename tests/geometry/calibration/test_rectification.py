"""Rectification of pairs of cameras: OpenCV's results, and what they are for."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close

G = K.geometry
RESULTS = ("R1", "R2", "P1", "P2", "Q")


def pair(seed: int, is_row: bool = True, strength: float = 1.0) -> tuple[Tensor, ...]:
    """Camera matrices, distortion, rotation and translation of two cameras."""
    rng = np.random.default_rng(seed)
    cameras, dists = [], []
    for _ in range(2):
        fx, fy, cx, cy = [450, 430, 320, 240] + rng.normal(size=4) * 15
        cameras.append([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        dists.append(strength * rng.normal(size=5) * [3e-2, 5e-3, 5e-4, 5e-4, 1e-3])
    t = 0.1 * rng.normal(size=(3, 1))
    t[0 if is_row else 1] = rng.choice([-1, 1])
    R = G.axis_angle_to_rotation_matrix(torch.from_numpy(0.08 * rng.normal(size=(1, 3))))[0]
    left, right = (torch.tensor(camera).double() for camera in cameras)
    return left, torch.from_numpy(dists[0]), right, torch.from_numpy(dists[1]), R, torch.from_numpy(t)


def rectified(values: tuple[Tensor, ...], size: tuple[int, int] = (480, 640), **options: object) -> list[Tensor]:
    *lenses, R, t = values
    result = G.stereo_rectify(*lenses, size, R, t, **options)
    return [getattr(result, name) for name in RESULTS]


@pytest.mark.parametrize("is_row", [True, False])
@pytest.mark.parametrize("alpha", [None, 0.0, 0.4, 1.0])
@pytest.mark.parametrize("zero_disparity", [True, False])
def test_equals_opencv(is_row: bool, alpha: float | None, zero_disparity: bool) -> None:
    cv2 = pytest.importorskip("cv2")
    for seed, new in ((0, None), (1, (300, 700))):
        values = pair(seed, is_row, strength=0.1)
        *lenses, R, t = (x.numpy() for x in values)
        theirs = cv2.stereoRectify(
            *lenses,
            (640, 480),
            R,
            t,
            flags=cv2.CALIB_ZERO_DISPARITY if zero_disparity else 0,
            alpha=-1 if alpha is None else alpha,
            newImageSize=(0, 0) if new is None else new[::-1],
        )
        ours = rectified(values, alpha=alpha, zero_disparity=zero_disparity, new_image_size=new)
        for a, b in zip(ours, theirs):
            assert_close(a, torch.from_numpy(b), 1e-5, 1e-5)


@pytest.mark.parametrize("is_row", [True, False])
def test_points_are_in_one_row_or_column(is_row: bool) -> None:
    """Points in space, seen through both lenses: rows agree, and the disparity gives the point back."""
    camera1, dist1, camera2, dist2, R, t = pair(2, is_row)
    R1, R2, P1, P2, Q = rectified((camera1, dist1, camera2, dist2, R, t), alpha=0.5)
    random = torch.Generator().manual_seed(0)
    X = torch.rand(3, 50, generator=random, dtype=torch.float64) - 0.5 + torch.tensor([[0.0], [0.0], [4.0]])
    rectified_pixels = []
    for camera, dist, points, rotation, P in ((camera1, dist1, X, R1, P1), (camera2, dist2, R @ X + t, R2, P2)):
        plane = (points[:2] / points[2]).T
        seen = G.distort_points(plane, camera, dist, torch.eye(3, dtype=torch.float64))
        back = G.undistort_points(seen, camera, dist, torch.eye(3, dtype=torch.float64), 20)
        x, y, z = P[:, :3] @ rotation @ torch.nn.functional.pad(back, (0, 1), value=1.0).T
        rectified_pixels.append(torch.stack([x / z, y / z]))
    left, right = rectified_pixels
    along, across = (0, 1) if is_row else (1, 0)
    assert_close(left[across], right[across], 1e-5, 1e-5)
    disparity = left[along] - right[along]
    x, y, z, w = Q @ torch.stack([left[0], left[1], disparity, torch.ones(50)])
    assert_close(torch.stack([x, y, z]) / w, R1 @ X, 1e-5, 1e-5)


def test_batches_and_gradients(device: torch.device) -> None:
    """Pairs side by side and one above the other in one call; leading axes broadcast."""
    each = [pair(seed, is_row) for seed, is_row in ((3, True), (4, False))]
    batch = tuple(torch.stack(x).to(device) for x in zip(*each))
    ours = rectified(batch, alpha=0.3)
    for i, one in enumerate(each):
        for a, b in zip(ours, rectified(one, alpha=0.3)):
            assert_close(a[i].cpu(), b, 1e-9, 1e-9)
    shared = rectified((*each[0][:4], batch[4].cpu(), batch[5].cpu()))
    assert [x.shape for x in shared] == [(2, 3, 3), (2, 3, 3), (2, 3, 4), (2, 3, 4), (2, 4, 4)]
    half = [x.float() for x in each[0]]
    for a, b in zip(rectified(tuple(half)), rectified(each[0])):
        assert a.dtype == torch.float32
        assert_close(a.double(), b, 1e-4, 1e-2)

    values = tuple(x.clone().requires_grad_() for x in each[0])
    assert torch.autograd.gradcheck(
        lambda *values: rectified(values, alpha=0.3), values, eps=1e-6, atol=1e-3, rtol=1e-3
    )


def test_without_distortion_and_rotation() -> None:
    camera, t = torch.tensor([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]]), torch.tensor([[-0.5], [0], [0]])
    result = G.stereo_rectify(camera, None, camera, None, (48, 64), torch.eye(3), t)
    assert_close(result.R1, torch.eye(3))
    assert_close(result.P1[:, :3], camera)
    assert result.Q[3, 2].item() == 2


def test_errors() -> None:
    *lenses, R, t = pair(0)
    with pytest.raises(ValueError, match=r"stereo_rectify: expected t of shape \(\*, 3, 1\), got \(3,\)"):
        G.stereo_rectify(*lenses, (480, 640), R, t[:, 0])
    with pytest.raises(ValueError, match="stereo_rectify: expected alpha within 0 and 1, got 2"):
        G.stereo_rectify(*lenses, (480, 640), R, t, alpha=2)
    with pytest.raises(TypeError, match="stereo_rectify: expected zero_disparity to be a bool, got 0"):
        G.stereo_rectify(*lenses, (480, 640), R, t, zero_disparity=0)
