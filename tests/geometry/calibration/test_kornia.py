"""Calibration against Kornia 0.9, which defines names and conventions."""

import pytest
import torch

from view_tests import CAMERA, LENS, assert_values_of_kornia, on_planes, rand, rotation

POINTS1, POINTS2, _ = on_planes(2, 12, noise=1.0)
ROTATIONS = torch.stack([rotation(0.3, 0.1, -0.2), rotation(1.0, -2.0, 0.5)])
CAMERAS = CAMERA.expand(2, 3, 3)
IMAGES = rand(2, 3, 20, 30)
WORLD = rand(2, 9, 3, high=3)
PROJECTED = (WORLD @ ROTATIONS[0].T + torch.tensor([0.0, 0, 5])) @ CAMERA.T
SEEN = PROJECTED[..., :2] / PROJECTED[..., 2:] + 0.3 * rand(2, 9, 2, low=-1)

# Home, name, arguments, keyword arguments.
CALLS = [
    *[("calibration", "distort_points", (POINTS1, CAMERAS, LENS[:n].expand(2, n)), {}) for n in (4, 5, 8, 12, 14)],
    *[
        ("calibration", "undistort_points", (POINTS1, CAMERAS, LENS[:n].expand(2, n)), {"num_iters": 99})
        for n in (4, 5, 8, 12, 14)
    ],
    ("calibration", "distort_points", (POINTS1, CAMERAS, LENS.expand(2, 14), CAMERAS + 2), {}),
    ("calibration", "undistort_points", (POINTS1, CAMERAS, LENS.expand(2, 14), CAMERAS + 2), {"num_iters": 99}),
    ("calibration", "undistort_image", (IMAGES, CAMERAS / 3, LENS.expand(2, 14)), {}),
    ("calibration", "tilt_projection", (LENS[:3], LENS[3:6]), {}),
    ("calibration", "tilt_projection", (LENS[:3, None], LENS[3:6, None], True), {}),
    ("calibration", "solve_pnp_dlt", (WORLD, SEEN, CAMERAS), {}),
    ("calibration", "solve_pnp_dlt", (WORLD, SEEN, CAMERAS, rand(2, 9) + 0.2), {}),
]


@pytest.mark.parametrize("home, name, args, kwargs", CALLS, ids=[f"{c[1]}-{i}" for i, c in enumerate(CALLS)])
def test_values(home, name, args, kwargs, device):
    assert_values_of_kornia(home, name, args, kwargs, device)
