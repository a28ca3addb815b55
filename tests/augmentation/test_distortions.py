"""Maps of grids, lenses and vortices against NumPy, OpenCV and the formulas of their models."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
import torch

import kvision.augmentation as A

H, W = 21, 30


def coordinates(augment: Any, device: torch.device, **params: Any) -> np.ndarray:
    """Where the pixels (H, W) of one image read x and y, with given parameters."""
    drawn = {name: torch.as_tensor(value, dtype=torch.float32)[None] for name, value in params.items()}
    moved = augment.displacements((1, 3, H, W), drawn, augment.flags, torch.empty(0, device=device))[0].cpu().numpy()
    return moved + np.stack(np.meshgrid(np.arange(W), np.arange(H)))


def test_grid_distortion_is_linear_between_its_lines(device: torch.device) -> None:
    steps = torch.rand(2, 1, 5)
    factors = 1 + 0.6 * steps[:, 0].numpy() - 0.3
    for normalized in (True, False):
        augment = A.GridDistortion(5, (-0.3, 0.3), normalized)
        x, y = coordinates(augment, device, steps=steps)
        for read, own, size in ((x[0], factors[0], W), (y[:, 0], factors[1], H)):
            lines = np.concatenate([[0], own.cumsum() / (own.sum() if normalized else 5)]) * size
            expected = np.interp(np.arange(size) + 0.5, np.linspace(0, size, 6), lines) - 0.5
            np.testing.assert_allclose(read, expected, atol=1e-4)


def test_piecewise_affine_is_affine_in_triangles(device: torch.device) -> None:
    nodes = torch.randn(2, 5, 6)
    rows, columns = 3, 4  # of 5 and 6 at most
    augment = A.PiecewiseAffine((0.1, 0.1), (3, 5), (4, 6))
    x, y = coordinates(augment, device, nodes=nodes, scale=0.1, rows=rows, columns=columns)
    node_x, node_y = np.meshgrid(np.linspace(0, W - 1, columns), np.linspace(0, H - 1, rows))
    moves = nodes[:, :rows, :columns].numpy() * 0.1 * H / 3
    moved = np.stack([(node_x + moves[0]).clip(0, W - 1), (node_y + moves[1]).clip(0, H - 1)])
    for row in range(0, H, 3):
        for column in range(0, W, 2):
            i, j = (
                min(int(row * (rows - 1) / (H - 1)), rows - 2),
                min(int(column * (columns - 1) / (W - 1)), columns - 2),
            )
            v, u = row * (rows - 1) / (H - 1) - i, column * (columns - 1) / (W - 1) - j
            corners = [(i, j), (i, j + 1), (i + 1, j)] if u + v <= 1 else [(i + 1, j + 1), (i, j + 1), (i + 1, j)]
            of_nodes = np.array([[node_x[c], node_y[c], 1] for c in corners]).T
            weights = np.linalg.solve(of_nodes, [column, row, 1])
            expected = sum(weight * moved[:, c[0], c[1]] for weight, c in zip(weights, corners))
            np.testing.assert_allclose((x[row, column], y[row, column]), expected, atol=1e-4)


@pytest.mark.parametrize("k", [-0.1, 0.3])
def test_lenses_are_those_of_opencv(k: float, device: torch.device) -> None:
    camera = np.array([[W, 0, W / 2], [0, H, H / 2], [0, 0, 1.0]])
    expected = cv2.initUndistortRectifyMap(camera, np.array([k, k, 0, 0]), None, camera, (W, H), cv2.CV_32FC1)
    np.testing.assert_allclose(coordinates(A.OpticalDistortion(), device, distort=k), np.stack(expected), atol=2e-4)
    # An equidistant image, as a fisheye of OpenCV without coefficients gives it, and with one.
    focal = np.hypot(W / 2, H / 2)
    camera = np.array([[focal, 0, (W - 1) / 2], [0, focal, (H - 1) / 2], [0, 0, 1.0]])
    pixels = np.stack(np.meshgrid(np.arange(W), np.arange(H)), -1).reshape(-1, 1, 2).astype(np.float64)
    rays = cv2.fisheye.undistortPoints(pixels, camera, np.zeros(4))
    read = cv2.fisheye.distortPoints(rays, camera, np.array([k, 0, 0, 0])).reshape(H, W, 2)
    ours = coordinates(A.OpticalDistortion(mode="fisheye"), device, distort=k)
    np.testing.assert_allclose(ours, read.transpose(2, 0, 1), atol=1e-3)


def test_swirl_turns_by_its_distance(device: torch.device) -> None:
    """As in scikit-image, where the radius is in pixels."""
    x, y = coordinates(A.Swirl(), device, strength=1.5, radius=0.8, center_x=0.4, center_y=0.6)
    center = np.array([0.4 * W - 0.5, 0.6 * H - 0.5])
    at = np.stack(np.meshgrid(np.arange(W), np.arange(H)), -1) - center
    distance = np.hypot(at[..., 0], at[..., 1])
    angle = 1.5 * np.exp(-distance / (0.8 * H / 5 / np.log(2))) + np.arctan2(at[..., 1], at[..., 0])
    np.testing.assert_allclose(x, center[0] + distance * np.cos(angle), atol=1e-4)
    np.testing.assert_allclose(y, center[1] + distance * np.sin(angle), atol=1e-4)


def test_chromatic_aberration_moves_red_and_blue(device: torch.device) -> None:
    image = torch.rand(1, 3, H, W)
    camera = np.array([[W, 0, W / 2], [0, H, H / 2], [0, 0, 1.0]])
    params = {"primary_red": -0.1, "secondary_red": 0.2, "primary_blue": 0.05, "secondary_blue": 0.3}
    drawn = {name: torch.tensor([value]) for name, value in params.items()}
    for mode, signs in (("green_purple", (-1, -1)), ("red_blue", (-1, 1)), ("random", (-1, 1))):
        y = A.ChromaticAberration(mode=mode, p=1.0)(image.to(device), params={**drawn, "batch_prob": torch.ones(1)})
        assert torch.equal(y[:, 1].cpu(), image[:, 1])
        for channel, sign, k1, k2 in ((0, signs[0], 0.1, 0.2), (2, signs[1], 0.05, 0.3)):
            lens = np.array([sign * k1, sign * k2, 0, 0])
            x_map, y_map = cv2.initUndistortRectifyMap(camera, lens, None, camera, (W, H), cv2.CV_32FC1)
            at_x, at_y = x_map.clip(0, W - 1), y_map.clip(0, H - 1)
            left, top = np.floor(at_x).astype(int).clip(0, W - 2), np.floor(at_y).astype(int).clip(0, H - 2)
            u, v, plane = at_x - left, at_y - top, image[0, channel].numpy()
            expected = (1 - v) * ((1 - u) * plane[top, left] + u * plane[top, left + 1])
            expected += v * ((1 - u) * plane[top + 1, left] + u * plane[top + 1, left + 1])
            np.testing.assert_allclose(y[0, channel].cpu().numpy(), expected, atol=1e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: A.GridDistortion(0), "GridDistortion: expected num_steps"),
        (lambda: A.GridDistortion(distort_range=(-1.5, 0.0)), "GridDistortion: expected distort_range"),
        (lambda: A.PiecewiseAffine(nb_rows_range=(1, 4)), "PiecewiseAffine: expected nb_rows_range"),
        (lambda: A.OpticalDistortion(mode="lens"), "OpticalDistortion: .*mode"),
        (lambda: A.Swirl(radius_range=(0.0, 1.0)), "Swirl: expected radius"),
        (lambda: A.ChromaticAberration(mode="blue"), "ChromaticAberration: .*mode"),
        (lambda: A.ChromaticAberration(p=1.0)(torch.zeros(1, 1, 4, 4)), "expected images with 3 channels"),
    ],
)
def test_wrong_arguments(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
