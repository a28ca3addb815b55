"""XYZ, Lab, Luv and linear light: known colors, OpenCV's and scikit-image's values."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import skimage.color
import torch

import kvision as K

C = K.color

KNOWN = {  # of CIE 15's formulas, to the digits that rounded matrices agree on
    "rgb_to_lab": {
        (1, 0, 0): (53.24, 80.09, 67.20),
        (0, 1, 0): (87.73, -86.18, 83.18),
        (0, 0, 1): (32.30, 79.19, -107.86),
        (1, 1, 1): (100, 0, 0),
        (0, 0, 0): (0, 0, 0),
        (0.5, 0.5, 0.5): (53.39, 0, 0),
    },
    "rgb_to_luv": {
        (1, 0, 0): (53.24, 175.01, 37.76),
        (0, 1, 0): (87.73, -83.08, 107.40),
        (0, 0, 1): (32.30, -9.40, -130.34),
        (1, 1, 1): (100, 0, 0),
        (0, 0, 0): (0, 0, 0),
    },
    "rgb_to_linear_rgb": {(0, 0.5, 1): (0, 0.2140, 1), (0.04, 0.05, 0.2): (0.003096, 0.003936, 0.03310)},
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_colors(name, device):
    for rgb, expected in KNOWN[name].items():
        x = torch.tensor(rgb, dtype=torch.float64, device=device).view(3, 1, 1)
        assert getattr(C, name)(x).flatten().tolist() == pytest.approx(expected, rel=1e-3, abs=0.03)


@pytest.fixture(scope="module")
def array() -> np.ndarray:
    return np.random.default_rng(0).random((30, 40, 3), np.float32)


@pytest.mark.parametrize(
    "convert, back, code, inverse, error",
    [
        (C.rgb_to_xyz, C.xyz_to_rgb, cv2.COLOR_RGB2XYZ, cv2.COLOR_XYZ2RGB, 1e-5),
        (C.rgb_to_lab, C.lab_to_rgb, cv2.COLOR_RGB2LAB, cv2.COLOR_LAB2RGB, 0.6),  # OpenCV interpolates in a table
        (C.rgb_to_luv, C.luv_to_rgb, cv2.COLOR_RGB2LUV, cv2.COLOR_LUV2RGB, 0.6),
    ],
)
def test_opencv(convert, back, code, inverse, error, array, device):
    theirs = cv2.cvtColor(array, code)
    ours = convert(K.image_to_tensor(array).to(device))
    np.testing.assert_allclose(K.tensor_to_image(ours), theirs, atol=error)
    rgb = back(K.image_to_tensor(theirs).to(device))
    np.testing.assert_allclose(K.tensor_to_image(rgb), cv2.cvtColor(theirs, inverse), atol=2e-2)


@pytest.mark.parametrize(
    "convert, expected, error",
    [(C.rgb_to_lab, skimage.color.rgb2lab, 0.02), (C.rgb_to_luv, skimage.color.rgb2luv, 0.02)],
)
def test_scikit_image(convert, expected, error, array, device):
    ours = convert(K.image_to_tensor(array.astype(np.float64)).to(device))
    np.testing.assert_allclose(K.tensor_to_image(ours), expected(array.astype(np.float64)), atol=error)


def test_clip(device):
    x = torch.tensor([[50.0, 120, 0], [110, 0, 0], [-5, 0, 0]], dtype=torch.float64, device=device).T[..., None]
    free, clipped = C.lab_to_rgb(x, clip=False), C.lab_to_rgb(x)
    assert free.max() > 1 and free.min() < 0
    assert torch.equal(clipped, free.clamp(0, 1)) and torch.equal(C.LabToRgb()(x), clipped)


@pytest.mark.parametrize("eps", [0, 1e-12])
def test_black_without_eps(eps, device):
    x = torch.zeros(3, 1, 1, device=device, requires_grad=True)
    for convert in (C.rgb_to_luv, C.luv_to_rgb):
        y = convert(x, eps)
        (gradient,) = torch.autograd.grad(y.sum(), x)
        assert not y.any() and gradient.isfinite().all()


def test_the_branches_of_the_transfer_function_meet(device):
    for convert, threshold in ((C.rgb_to_linear_rgb, 0.04045), (C.linear_rgb_to_rgb, 0.0031308)):
        x = torch.tensor([threshold, threshold + 1e-12, 0], dtype=torch.float64, device=device).view(3, 1, 1)
        low, high, _ = convert(x).flatten().tolist()
        assert abs(high - low) < 1e-7
