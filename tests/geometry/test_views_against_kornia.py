"""Calibration, homographies, epipolar geometry and solvers against Kornia 0.9, which defines names and conventions."""

import kornia
import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close
from view_tests import CAMERA, LENS, Scene, homographies, on_planes, rand, rotation

POINTS1, POINTS2, _ = on_planes(2, 12, noise=1.0)
H = homographies(2)
WEIGHTS = rand(2, 12, seed=7)
LINES1, LINES2 = POINTS1.reshape(2, 6, 2, 2), POINTS2.reshape(2, 6, 2, 2)
SCENE = Scene(2, 20, noise=0.5)
X1, X2, F = SCENE.x1, SCENE.x2, SCENE.F
ROTATIONS = torch.stack([rotation(0.3, 0.1, -0.2), rotation(1.0, -2.0, 0.5)])
SHIFTS = rand(2, 3, 1, low=-1)
PROJECTIONS = torch.stack([SCENE.P1 * 1.0, SCENE.P2 * -2.5])
CAMERAS = CAMERA.expand(2, 3, 3)
MATRICES = rand(4, 3, 3, low=-1, seed=5)
IMAGES = rand(2, 3, 20, 30)
WORLD = rand(2, 9, 3, high=3)
SEEN = (WORLD @ ROTATIONS[0].T + torch.tensor([0.0, 0, 5])) @ CAMERA.T
SEEN = SEEN[..., :2] / SEEN[..., 2:] + 0.3 * rand(2, 9, 2, low=-1)

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
    ("epipolar", "normalize_points", (POINTS1,), {}),
    ("epipolar", "normalize_points", (POINTS1,), {"weights": WEIGHTS, "eps": 0.5}),
    ("epipolar", "normalize_transformation", (MATRICES,), {}),
    ("epipolar", "find_fundamental", (X1, X2), {}),
    ("epipolar", "find_fundamental", (X1, X2, rand(2, 20)), {}),
    ("epipolar", "sampson_epipolar_distance", (X1, X2, F), {}),
    ("epipolar", "sampson_epipolar_distance", (X1, X2, F.expand(2, 3, 3)), {"squared": False}),
    ("epipolar", "sampson_epipolar_distance", (X1[0], X2[0], 0 * F), {}),
    ("epipolar", "symmetrical_epipolar_distance", (X1, X2, F), {}),
    ("epipolar", "symmetrical_epipolar_distance", (X1, X2, F), {"squared": False}),
    ("epipolar", "left_to_right_epipolar_distance", (X1, X2, F.expand(2, 3, 3)), {}),
    ("epipolar", "right_to_left_epipolar_distance", (X1, X2, F.expand(2, 3, 3)), {}),
    ("epipolar", "get_closest_point_on_epipolar_line", (X1, X2, F.expand(2, 3, 3)), {}),
    ("epipolar", "compute_correspond_epilines", (X1, F.expand(2, 3, 3)), {}),
    ("epipolar", "get_perpendicular", (rand(2, 12, 3), POINTS1), {}),
    ("epipolar", "essential_from_fundamental", (F, CAMERA, CAMERA + 1), {}),
    ("epipolar", "fundamental_from_essential", (SCENE.E, CAMERA, CAMERA * 2), {}),
    ("epipolar", "fundamental_from_projections", (PROJECTIONS, PROJECTIONS.flip(0)), {}),
    ("epipolar", "essential_from_Rt", (ROTATIONS, SHIFTS, ROTATIONS.flip(0), 2 * SHIFTS), {}),
    ("epipolar", "relative_camera_motion", (ROTATIONS, SHIFTS, ROTATIONS.flip(0), 2 * SHIFTS), {}),
    ("epipolar", "project_to_essential", (MATRICES,), {}),
    ("epipolar", "motion_from_essential_choose_solution", (SCENE.E, CAMERA, CAMERA, X1[0], X2[0]), {}),
    ("epipolar", "projection_from_KRt", (CAMERAS, ROTATIONS, SHIFTS), {}),
    ("epipolar", "KRt_from_projection", (PROJECTIONS,), {}),
    ("epipolar", "depth_from_point", (ROTATIONS, SHIFTS, WORLD), {}),
    ("epipolar", "cross_product_matrix", (rand(4, 3),), {}),
    ("epipolar", "intrinsics_like", (3.0, IMAGES), {}),
    ("epipolar", "scale_intrinsics", (CAMERAS, 2.0), {}),
    ("epipolar", "scale_intrinsics", (CAMERAS, torch.tensor([2.0, 0.5]).double()), {}),
    ("epipolar", "triangulate_points", (SCENE.P1, SCENE.P2, X1[0], X2[0]), {}),
    ("epipolar", "triangulate_points", (SCENE.P1, SCENE.P2, X1, X2), {"solver": "svd"}),
    ("solvers", "solve_quadratic", (rand(50, 3, low=-1),), {}),
    ("solvers", "multiply_deg_one_poly", (rand(5, 4), rand(5, 4, seed=1)), {}),
    ("solvers", "multiply_deg_two_one_poly", (rand(5, 10), rand(5, 4, seed=1)), {}),
    ("solvers", "determinant_to_polynomial", (rand(5, 3, 13),), {}),
    ("solvers", "null_vector_3x4", (rand(5, 3, 4),), {}),
    ("solvers", "find_affine", (POINTS1, POINTS2, WEIGHTS), {}),
    *[("calibration", "distort_points", (POINTS1, CAMERAS, LENS[:n].expand(2, n)), {}) for n in (4, 5, 8, 12, 14)],
    *[("calibration", "undistort_points", (POINTS1, CAMERAS, LENS[:n].expand(2, n)), {}) for n in (4, 5, 8, 12, 14)],
    ("calibration", "distort_points", (POINTS1, CAMERAS, LENS.expand(2, 14), CAMERAS + 2), {}),
    ("calibration", "undistort_points", (POINTS1, CAMERAS, LENS.expand(2, 14), CAMERAS + 2), {"num_iters": 2}),
    ("calibration", "undistort_image", (IMAGES, CAMERAS / 3, LENS.expand(2, 14)), {}),
    ("calibration", "tilt_projection", (LENS[:3], LENS[3:6]), {}),
    ("calibration", "tilt_projection", (LENS[:3, None], LENS[3:6, None], True), {}),
    ("calibration", "solve_pnp_dlt", (WORLD, SEEN, CAMERAS), {}),
    ("calibration", "solve_pnp_dlt", (WORLD, SEEN, CAMERAS, rand(2, 9) + 0.2), {}),
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


@pytest.mark.parametrize("name, count", [("solve_cubic", 4), ("solve_quartic", 5)])
def test_roots(name, count, device):
    coeffs = rand(500, count, low=-1)
    found = getattr(K.geometry, name)(coeffs.to(device)).cpu()
    expected = getattr(kornia.geometry.solvers, name)(coeffs)
    assert_close(found.sort(-1).values, expected.sort(-1).values, 1e-9, 1e-9)


def test_reweighting(device):
    """Kornia's first step differs, since its "lu" solves another problem; exact points have one solution."""
    x, y, _ = on_planes(2, 12)
    expected = kornia.geometry.find_homography_dlt_iterated(x, y, WEIGHTS)
    assert_close(K.find_homography_dlt_iterated(*(a.to(device) for a in (x, y, WEIGHTS))).cpu(), expected, 1e-6, 1e-6)


def test_seven_points(device):
    found = K.geometry.find_fundamental(X1[:, :7].to(device), X2[:, :7].to(device), method="7POINT").cpu()
    expected = kornia.geometry.epipolar.find_fundamental(X1[:, :7], X2[:, :7], method="7POINT")
    for a, e in zip(found, expected):
        e = e[e.isfinite().flatten(1).all(1) & (e != 0).any(-1).any(-1)]
        assert len(e) == (a[:, 2, 2] != 0).sum()
        assert_close(a[: len(e)][a[: len(e), 0, 0].argsort()], e[e[:, 0, 0].argsort()], 1e-6, 1e-8)


@pytest.mark.parametrize("essential", [SCENE.E, MATRICES], ids=["exact", "any"])
def test_decomposition(essential, device):
    """Signs and the order of both rotations are open."""
    theirs = kornia.geometry.epipolar.decompose_essential_matrix(essential)
    for function in (K.geometry.decompose_essential_matrix, K.geometry.decompose_essential_matrix_no_svd):
        found = [y.cpu().reshape(-1, 9 if y.shape[-1] == 3 else 3) for y in function(essential.to(device))]
        expected = [y.reshape(-1, 9 if y.shape[-1] == 3 else 3) for y in theirs]
        straight = ((found[0] - expected[0]).abs() + (found[1] - expected[1]).abs()).amax(-1)
        crossed = ((found[0] - expected[1]).abs() + (found[1] - expected[0]).abs()).amax(-1)
        assert torch.minimum(straight, crossed).max() < 1e-9
        assert_close(found[2].abs(), expected[2].abs())


def test_projections_from_fundamental(device):
    """The epipole's sign is open."""
    found = K.geometry.projections_from_fundamental(F[None].to(device)).cpu()
    expected = kornia.geometry.epipolar.projections_from_fundamental(F[None])
    assert_close(found.abs(), expected.abs(), 1e-7, 1e-9)
    assert_close(K.geometry.fundamental_from_projections(*found.unbind(-1)) / F, torch.ones_like(F)[None] * (
        K.geometry.fundamental_from_projections(*found.unbind(-1)) / F)[:, 2:, 2:], 1e-6, 1e-9)  # fmt: skip


def test_five_points(device):
    x, y = Scene(3, 20).normalized()
    for count in (5, 8, 20):
        found = K.geometry.find_essential(x[:, :count].to(device), y[:, :count].to(device)).cpu()
        expected = kornia.geometry.epipolar.find_essential(x[:, :count], y[:, :count])
        assert found.shape == expected.shape
        for ours, theirs in zip(found, expected):
            theirs = theirs[theirs.isfinite().flatten(1).all(1)]
            ours = ours[ours.isfinite().flatten(1).all(1)]
            assert len(ours) == len(theirs)
            apart = (ours[:, None] - theirs).flatten(2).norm(dim=-1)
            mirrored = (ours[:, None] + theirs).flatten(2).norm(dim=-1)
            assert torch.minimum(apart, mirrored).amin(0).max() < 1e-6


def test_scenes():
    scene = K.geometry.generate_scene(3, 20)
    assert {k: v.shape for k, v in scene.items()} == {
        k: v.shape for k, v in kornia.geometry.epipolar.generate_scene(3, 20).items()
    }
    assert (K.geometry.depth_from_point(scene["R"], scene["t"], scene["points3d"].expand(3, 20, 3)) > 0).all()
    low, high = torch.tensor(3.0), torch.tensor(4.0)
    camera = K.geometry.random_intrinsics(low, high)
    assert camera.shape == (1, 3, 3) and 3 <= camera[0, 0, 0] <= 4 and camera[0, 2, 2] == 1
