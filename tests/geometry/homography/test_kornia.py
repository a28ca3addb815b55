"""Homographies against Kornia 0.9, which defines names and conventions."""

import kornia
import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close
from view_tests import homographies, on_planes, rand

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
    ours = getattr(getattr(K.geometry, home), name)
    theirs = getattr(getattr(kornia.geometry, home), name)
    moved = [a.to(device) if isinstance(a, Tensor) else a for a in args]
    kwargs_moved = {k: v.to(device) if isinstance(v, Tensor) else v for k, v in kwargs.items()}
    assert getattr(K.geometry, name, None) in (ours, None)
    found, expected = ours(*moved, **kwargs_moved), theirs(*args, **kwargs)
    for a, e in zip(*((y if isinstance(y, tuple) else (y,)) for y in (found, expected)), strict=True):
        a, e = a.cpu(), e[0] if e.shape != a.shape and e.shape[0] == 1 else e
        largest = e.double().nan_to_num(0, 0, 0).abs().amax()
        assert_close(a, e.to(a.dtype), 1e-7, 1e-7 * max(1.0, float(largest)))


def test_reweighting(device):
    """Kornia's first step differs, since its "lu" solves another problem; exact points have one solution."""
    x, y, _ = on_planes(2, 12)
    expected = kornia.geometry.find_homography_dlt_iterated(x, y, WEIGHTS)
    assert_close(K.find_homography_dlt_iterated(*(a.to(device) for a in (x, y, WEIGHTS))).cpu(), expected, 1e-6, 1e-6)
