"""Homographies against Kornia 0.9, which defines names and conventions."""

import kornia
import pytest
import torch

import kvision as K
from op_tests import assert_close
from view_tests import assert_values_of_kornia, homographies, on_planes, rand

POINTS1, POINTS2, _ = on_planes(2, 12, noise=1.0)
H = homographies(2)
WEIGHTS = rand(2, 12, seed=7)
LINES1, LINES2 = POINTS1.reshape(2, 6, 2, 2), POINTS2.reshape(2, 6, 2, 2)

# Home, name, arguments, keyword arguments.
CALLS = [
    ("homography", "oneway_transfer_error", (POINTS1, POINTS2, H), {}),
    ("homography", "oneway_transfer_error", (POINTS1, POINTS2, H), {"squared": False}),
    ("homography", "oneway_transfer_error", (POINTS1[:1], POINTS2[:1], torch.zeros(1, 3, 3).double()), {}),
    ("homography", "symmetric_transfer_error", (POINTS1, POINTS2, H), {}),
    ("homography", "symmetric_transfer_error", (POINTS1, POINTS2, H), {"squared": False}),
    ("homography", "symmetric_transfer_error", (POINTS1[:1], POINTS2[:1], torch.ones(1, 3, 3).double()), {}),
    ("homography", "sampson_homography_distance", (POINTS1, POINTS2, H), {}),
    ("homography", "sampson_homography_distance", (POINTS1, POINTS2, H), {"squared": False}),
    ("homography", "sampson_homography_distance", (POINTS1[:1], POINTS2[:1], torch.zeros(1, 3, 3).double()), {}),
    ("homography", "line_segment_transfer_error_one_way", (LINES1, LINES2, H), {}),
    ("homography", "line_segment_transfer_error_one_way", (LINES1, LINES2, H), {"squared": True}),
    ("homography", "sample_is_valid_for_homography", (rand(9, 4, 2), rand(9, 4, 2, seed=1)), {}),
    ("homography", "find_homography_dlt", (POINTS1, POINTS2), {"solver": "svd"}),
    ("homography", "find_homography_dlt", (POINTS1, POINTS2, WEIGHTS), {"solver": "svd"}),
    ("homography", "find_homography_lines_dlt", (LINES1, LINES2), {}),
    ("homography", "find_homography_lines_dlt", (LINES1[0], LINES2[0], WEIGHTS[:1, :6]), {}),
    ("homography", "find_homography_lines_dlt_iterated", (LINES1, LINES2, WEIGHTS[:, :6]), {"soft_inl_th": 9.0}),
]


@pytest.mark.parametrize("home, name, args, kwargs", CALLS, ids=[f"{c[1]}-{i}" for i, c in enumerate(CALLS)])
def test_values(home, name, args, kwargs, device):
    assert_values_of_kornia(home, name, args, kwargs, device)


def test_reweighting(device):
    """Kornia's first step differs, since its "lu" solves another problem; exact points have one solution."""
    x, y, _ = on_planes(2, 12)
    expected = kornia.geometry.find_homography_dlt_iterated(x, y, WEIGHTS)
    assert_close(K.find_homography_dlt_iterated(*(a.to(device) for a in (x, y, WEIGHTS))).cpu(), expected, 1e-6, 1e-6)
