"""Epipolar geometry against Kornia 0.9, which defines names and conventions."""

import kornia
import pytest
import torch

import kvision as K
from op_tests import assert_close
from view_tests import CAMERA, Scene, assert_values_of_kornia, on_planes, rand, rotation

POINTS1, POINTS2, _ = on_planes(2, 12, noise=1.0)
WEIGHTS = rand(2, 12, seed=7)
SCENE = Scene(2, 20, noise=0.5)
X1, X2, F = SCENE.x1, SCENE.x2, SCENE.F
ROTATIONS = torch.stack([rotation(0.3, 0.1, -0.2), rotation(1.0, -2.0, 0.5)])
SHIFTS = rand(2, 3, 1, low=-1)
PROJECTIONS = torch.stack([SCENE.P1 * 1.0, SCENE.P2 * -2.5])
CAMERAS = CAMERA.expand(2, 3, 3)
MATRICES = rand(4, 3, 3, low=-1, seed=5)
IMAGES = rand(2, 3, 20, 30)
WORLD = rand(2, 9, 3, high=3)

# Home, name, arguments, keyword arguments.
CALLS = [
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
]


@pytest.mark.parametrize("home, name, args, kwargs", CALLS, ids=[f"{c[1]}-{i}" for i, c in enumerate(CALLS)])
def test_values(home, name, args, kwargs, device):
    assert_values_of_kornia(home, name, args, kwargs, device)


def test_seven_points(device):
    result = K.geometry.find_fundamental(X1[:, :7].to(device), X2[:, :7].to(device), method="7POINT").cpu()
    expected = kornia.geometry.epipolar.find_fundamental(X1[:, :7], X2[:, :7], method="7POINT")
    for a, e in zip(result, expected):
        e = e[e.isfinite().flatten(1).all(1) & (e != 0).any(-1).any(-1)]
        assert len(e) == (a[:, 2, 2] != 0).sum()
        assert_close(a[: len(e)][a[: len(e), 0, 0].argsort()], e[e[:, 0, 0].argsort()], 1e-6, 1e-8)


@pytest.mark.parametrize("essential", [SCENE.E, MATRICES], ids=["exact", "any"])
def test_decomposition(essential, device):
    """Signs and the order of both rotations are open."""
    theirs = kornia.geometry.epipolar.decompose_essential_matrix(essential)
    for function in (K.geometry.decompose_essential_matrix, K.geometry.decompose_essential_matrix_no_svd):
        results = [y.cpu().reshape(-1, 9 if y.shape[-1] == 3 else 3) for y in function(essential.to(device))]
        expected = [y.reshape(-1, 9 if y.shape[-1] == 3 else 3) for y in theirs]
        straight = ((results[0] - expected[0]).abs() + (results[1] - expected[1]).abs()).amax(-1)
        crossed = ((results[0] - expected[1]).abs() + (results[1] - expected[0]).abs()).amax(-1)
        assert torch.minimum(straight, crossed).max() < 1e-9
        assert_close(results[2].abs(), expected[2].abs())


def test_projections_from_fundamental(device):
    """The epipole's sign is open."""
    result = K.geometry.projections_from_fundamental(F[None].to(device)).cpu()
    expected = kornia.geometry.epipolar.projections_from_fundamental(F[None])
    assert_close(result.abs(), expected.abs(), 1e-7, 1e-9)
    assert_close(K.geometry.fundamental_from_projections(*result.unbind(-1)) / F, torch.ones_like(F)[None] * (
        K.geometry.fundamental_from_projections(*result.unbind(-1)) / F)[:, 2:, 2:], 1e-6, 1e-9)  # fmt: skip


def test_five_points(device):
    x, y = Scene(3, 20).normalized()
    for count in (5, 8, 20):
        result = K.geometry.find_essential(x[:, :count].to(device), y[:, :count].to(device)).cpu()
        expected = kornia.geometry.epipolar.find_essential(x[:, :count], y[:, :count])
        assert result.shape == expected.shape
        for ours, theirs in zip(result, expected):
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
