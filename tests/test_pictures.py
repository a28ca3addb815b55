"""Photographs through kvision and through OpenCV, SciPy, scikit-image and Kornia.

PARITY is the table of parity with other libraries: which call equals which, and the tolerance. docs/differences.md
lists what differs by definition. The tests of each filter cover borders and sizes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import kornia
import numpy as np
import pytest
import scipy.ndimage
import skimage.data
import skimage.filters
import torch
from torch import Tensor

import kvision as K
from op_tests import TOLERANCES

pytestmark = pytest.mark.interface

F = K.filters
MIRROR, REPLICATE = cv2.BORDER_REFLECT_101, cv2.BORDER_REPLICATE  # "reflect" and "replicate" here
FLOAT, EXACT = TOLERANCES[torch.float32], (0, 0)
A_LEVEL = (0, 1)  # of 255


class Parity(NamedTuple):
    ours: Callable[[Tensor], Tensor]  # of (1, C, H, W)
    theirs: Callable[[Any], Any]  # of (H, W, C); of (1, C, H, W) for Kornia
    dtype: type = np.float32  # values in [0, 1], or bytes
    tolerance: tuple[float, float] = FLOAT  # relative, absolute
    outliers: float = 0.0  # the fraction of pixels that may exceed the tolerance


def hypot_of(derivative: Callable[[Any, int, int], Any]) -> Callable[[Any], Any]:
    return lambda p: np.hypot(derivative(p, 1, 0), derivative(p, 0, 1))


def planes(filter_of_plane: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda p: np.stack([filter_of_plane(p[..., c]) for c in range(p.shape[2])], axis=2)


def laplacian_kernel(size: int) -> Any:
    kernel = np.ones((size, size), np.float32)
    kernel[size // 2, size // 2] = 1 - size * size
    return kernel


def canny_of_opencv(p: Any) -> Any:
    """Canny by OpenCV from 16-bit derivatives, because its blur and derivatives of bytes lose faint edges."""
    blurred = cv2.GaussianBlur(np.ascontiguousarray(p[..., 0]), (5, 5), 1, borderType=MIRROR)
    dx, dy = (cv2.Sobel(blurred, cv2.CV_32F, *d, borderType=REPLICATE) for d in [(1, 0), (0, 1)])
    scale = 8000  # the largest derivative is 4
    dx, dy = (np.round(scale * d).astype(np.int16) for d in (dx, dy))
    return cv2.Canny(dx, dy, 0.2 * scale, 0.5 * scale, L2gradient=True) / np.float32(255)


def gray(x: Tensor) -> Tensor:
    return x[:, :1]


def sobel(x: Tensor) -> Tensor:
    return F.sobel(x, eps=0.0)


PARITY = {
    "sobel, OpenCV": Parity(
        sobel, hypot_of(lambda p, *d: cv2.Sobel(p, cv2.CV_32F, *d, ksize=3, scale=1 / 8, borderType=REPLICATE))
    ),
    "sobel, SciPy": Parity(sobel, planes(hypot_of(lambda p, x, y: scipy.ndimage.sobel(p, x, mode="nearest") / 8))),
    "sobel, scikit-image": Parity(sobel, planes(lambda p: skimage.filters.sobel(p, mode="nearest") / np.sqrt(2))),
    "sobel, Kornia": Parity(F.sobel, kornia.filters.sobel),
    "gaussian 5, OpenCV": Parity(
        lambda x: F.gaussian_blur2d(x, 5, 1.5), lambda p: cv2.GaussianBlur(p, (5, 5), 1.5, borderType=MIRROR)
    ),
    "gaussian 31, OpenCV": Parity(
        lambda x: F.gaussian_blur2d(x, 31, 5.0), lambda p: cv2.GaussianBlur(p, (31, 31), 5.0, borderType=MIRROR)
    ),
    "gaussian 5 of bytes, OpenCV": Parity(  # OpenCV computes it in fixed point
        lambda x: F.gaussian_blur2d(x, 5, 1.5),
        lambda p: cv2.GaussianBlur(p, (5, 5), 1.5, borderType=MIRROR),
        np.uint8,
        A_LEVEL,
    ),
    "gaussian 9, SciPy": Parity(
        lambda x: F.gaussian_blur2d(x, 9, 1.0),
        planes(lambda p: scipy.ndimage.gaussian_filter(p, 1.0, radius=4, mode="mirror")),
    ),
    "gaussian 9, scikit-image": Parity(
        lambda x: F.gaussian_blur2d(x, 9, 1.0),
        lambda p: skimage.filters.gaussian(p, 1.0, mode="mirror", truncate=4, channel_axis=2),
    ),
    "gaussian 7, Kornia": Parity(
        lambda x: F.gaussian_blur2d(x, 7, (1.0, 2.0)), lambda x: kornia.filters.gaussian_blur2d(x, 7, (1.0, 2.0))
    ),
    "box 5, OpenCV": Parity(lambda x: F.box_blur(x, 5), lambda p: cv2.blur(p, (5, 5), borderType=MIRROR)),
    "box 31, OpenCV": Parity(lambda x: F.box_blur(x, 31), lambda p: cv2.blur(p, (31, 31), borderType=MIRROR)),
    "box 5 of bytes, OpenCV": Parity(
        lambda x: F.box_blur(x, 5), lambda p: cv2.blur(p, (5, 5), borderType=MIRROR), np.uint8, EXACT
    ),
    "box 5, SciPy": Parity(
        lambda x: F.box_blur(x, 5), planes(lambda p: scipy.ndimage.uniform_filter(p, 5, mode="mirror"))
    ),
    "box 5, Kornia": Parity(lambda x: F.box_blur(x, 5), lambda x: kornia.filters.box_blur(x, 5)),
    "median 3 of bytes, OpenCV": Parity(
        lambda x: F.median_blur(x, 3, "replicate"), lambda p: cv2.medianBlur(p, 3), np.uint8, EXACT
    ),
    "median 5 of bytes, OpenCV": Parity(
        lambda x: F.median_blur(x, 5, "replicate"), lambda p: cv2.medianBlur(p, 5), np.uint8, EXACT
    ),
    "median 5, OpenCV": Parity(
        lambda x: F.median_blur(x, 5, "replicate"), lambda p: cv2.medianBlur(p, 5), tolerance=EXACT
    ),
    "median 3, SciPy": Parity(
        lambda x: F.median_blur(x, 3),
        planes(lambda p: scipy.ndimage.median_filter(p, 3, mode="mirror")),
        tolerance=EXACT,
    ),
    "median 3, scikit-image": Parity(
        lambda x: F.median_blur(x, 3, "replicate"),
        planes(lambda p: skimage.filters.median(p, np.ones((3, 3)), mode="nearest")),
        np.uint8,
        EXACT,
    ),
    "median 3, Kornia": Parity(
        lambda x: F.median_blur(x, 3), lambda x: kornia.filters.median_blur(x, 3), tolerance=EXACT
    ),
    "laplacian 3, OpenCV": Parity(
        lambda x: F.laplacian(x, 3, normalized=False),
        lambda p: cv2.filter2D(p, -1, laplacian_kernel(3), borderType=MIRROR),
        tolerance=(2e-5, 1e-5),  # sums of nine numbers that nearly cancel
    ),
    "laplacian 3 of bytes, OpenCV": Parity(
        lambda x: F.laplacian(x, 3, normalized=False),
        lambda p: cv2.filter2D(p, -1, laplacian_kernel(3), borderType=MIRROR),
        np.uint8,
        EXACT,
    ),
    "laplacian 5, SciPy": Parity(
        lambda x: F.laplacian(x, 5),
        planes(lambda p: scipy.ndimage.convolve(p, laplacian_kernel(5) / 48, mode="mirror")),
    ),
    "laplacian 5, Kornia": Parity(lambda x: F.laplacian(x, 5), lambda x: kornia.filters.laplacian(x, 5)),
    "bilateral 9, OpenCV": Parity(  # OpenCV has a disc, so corners must not count, and a table of weights
        lambda x: F.bilateral_blur(x, 9, 0.3, (0.8, 0.8)),
        lambda p: cv2.bilateralFilter(p, d=9, sigmaColor=0.3, sigmaSpace=0.8, borderType=MIRROR),
        tolerance=(0, 2e-4),
    ),
    "bilateral 5, Kornia": Parity(
        lambda x: F.bilateral_blur(x, 5, 0.1, (1.5, 1.5)),
        lambda x: kornia.filters.bilateral_blur(x, 5, 0.1, (1.5, 1.5)),
    ),
    "unsharp mask 5, Kornia": Parity(
        lambda x: F.unsharp_mask(x, 5, (1.5, 1.5)), lambda x: kornia.filters.unsharp_mask(x, (5, 5), (1.5, 1.5))
    ),
    "spatial gradient 2, Kornia": Parity(
        lambda x: F.spatial_gradient(x, order=2)[0], lambda x: kornia.filters.spatial_gradient(x, order=2)[0]
    ),
    "motion 7, Kornia": Parity(
        lambda x: F.motion_blur(x, 7, 30.0, 0.5), lambda x: kornia.filters.motion_blur(x, 7, 30.0, 0.5)
    ),
    "guided 5, Kornia": Parity(
        lambda x: F.guided_blur(gray(x), x, 5, 0.01),
        lambda x: kornia.filters.guided_blur(gray(x), x, 5, 0.01),
    ),
    "canny, OpenCV": Parity(lambda x: F.canny(gray(x), 0.2, 0.5)[1], canny_of_opencv, tolerance=EXACT, outliers=5e-4),
    "canny, Kornia": Parity(  # rounding decides a few ridges, and hysteresis follows them
        lambda x: F.canny(x)[1], lambda x: kornia.filters.canny(x)[1], tolerance=EXACT, outliers=5e-4
    ),
}


@pytest.fixture(scope="module", params=["astronaut", "camera", "chelsea", "coffee", "kodim08"])
def photo(request: pytest.FixtureRequest) -> np.ndarray:
    """uint8 (H, W, C): photographs of scikit-image, and one of the optional sample data."""
    if not request.param.startswith("kodim"):
        return np.atleast_3d(getattr(skimage.data, request.param)())
    folder: Path = request.getfixturevalue("data")
    return cv2.cvtColor(cv2.imread(str(folder / "photos" / f"{request.param}.png")), cv2.COLOR_BGR2RGB)


@pytest.mark.parametrize("row", PARITY)
def test_parity(row: str, photo: np.ndarray, device: torch.device) -> None:
    ours, theirs, dtype, (rtol, atol), outliers = PARITY[row]
    picture = photo if dtype is np.uint8 else photo.astype(np.float32) / 255
    x = torch.from_numpy(picture).permute(2, 0, 1)[None]
    actual = ours(x.to(device)).cpu()
    if row.endswith("Kornia"):
        expected = theirs(x)
    else:
        expected = torch.from_numpy(np.atleast_3d(theirs(picture))).permute(2, 0, 1)[None]
    assert actual.shape == expected.shape and actual.dtype == x.dtype
    off = ~torch.isclose(actual.double(), expected.double(), rtol, atol)
    assert off.double().mean() <= outliers, float((actual.double() - expected.double()).abs().max())
