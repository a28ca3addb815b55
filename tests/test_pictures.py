"""Photographs through kvision and through OpenCV, SciPy, scikit-image and Kornia.

Which calls equal which is said once: of Kornia by the table of sample calls, of the others by the cases of benchmarks, and
by PARITY where the arguments or the tolerance are others. docs/differences.md lists what differs by definition.
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
from benchmarks.cases.filters import CASES as FILTERS
from benchmarks.peers import PEERS
from benchmarks.sample_calls import SampleCall, filters
from benchmarks.sample_calls.windows import WINDOWS
from op_tests import TOLERANCES

pytestmark = pytest.mark.interface

F = K.filters
MIRROR, REPLICATE = cv2.BORDER_REFLECT_101, cv2.BORDER_REPLICATE  # "reflect" and "replicate" here
FLOAT, EXACT = TOLERANCES[torch.float32], (0, 0)
A_LEVEL = (0, 1)  # of 255
CASES = {case.name: case for case in FILTERS}


class Parity(NamedTuple):
    ours: Callable[[Tensor], Tensor]  # of (1, C, H, W)
    theirs: Callable[[Any], Any]  # of (H, W, C)
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
    "gaussian 5 of bytes, OpenCV": Parity(  # OpenCV computes it in fixed point
        lambda x: F.gaussian_blur2d(x, 5, 1.5),
        lambda p: cv2.GaussianBlur(p, (5, 5), 1.5, borderType=MIRROR),
        np.uint8,
        A_LEVEL,
    ),
    "box 5 of bytes, OpenCV": Parity(
        lambda x: F.box_blur(x, 5), lambda p: cv2.blur(p, (5, 5), borderType=MIRROR), np.uint8, EXACT
    ),
    "median 3 of bytes, OpenCV": Parity(
        lambda x: F.median_blur(x, 3, "replicate"), lambda p: cv2.medianBlur(p, 3), np.uint8, EXACT
    ),
    "median 5 of bytes, OpenCV": Parity(
        lambda x: F.median_blur(x, 5, "replicate"), lambda p: cv2.medianBlur(p, 5), np.uint8, EXACT
    ),
    "laplacian 3 of bytes, OpenCV": Parity(
        lambda x: F.laplacian(x, 3, normalized=False),
        lambda p: cv2.filter2D(p, -1, laplacian_kernel(3), borderType=MIRROR),
        np.uint8,
        EXACT,
    ),
    "bilateral 9, OpenCV": Parity(  # OpenCV has a disc, so corners must not count, and a table of weights
        lambda x: F.bilateral_blur(x, 9, 0.3, (0.8, 0.8)),
        lambda p: cv2.bilateralFilter(p, d=9, sigmaColor=0.3, sigmaSpace=0.8, borderType=MIRROR),
        tolerance=(0, 2e-4),
    ),
    "canny, OpenCV": Parity(lambda x: F.canny(gray(x), 0.2, 0.5)[1], canny_of_opencv, tolerance=EXACT, outliers=5e-4),
}

NAMES = """sobel spatial_gradient laplacian canny gaussian_blur2d box_blur median_blur unsharp_mask bilateral_blur guided_blur
motion_blur""".split()
# The filters of benchmarks whose peers compute the same.
PEERS_OF_CASES = [
    *((case, peer) for case in ("gauss5", "gauss31", "median3") for peer in ("opencv", "scipy", "skimage")),
    *((case, peer) for case in ("box5", "box31", "laplacian3", "unsharp5") for peer in ("opencv", "scipy")),
    ("median5", "opencv"),
]
SAME_IN_KORNIA = [
    *(call for call in filters.CALLS if call.name.removeprefix("filters.") in NAMES),
    *(window.call for window in WINDOWS if str(window) == "spatial_gradient order=2"),
]


@pytest.fixture(scope="module", params=["astronaut", "camera", "chelsea", "coffee", "kodim08"])
def photo(request: pytest.FixtureRequest) -> np.ndarray:
    """uint8 (H, W, C): photographs of scikit-image, and one of the optional sample data."""
    if not request.param.startswith("kodim"):
        return np.atleast_3d(getattr(skimage.data, request.param)())
    folder: Path = request.getfixturevalue("data")
    return cv2.cvtColor(cv2.imread(str(folder / "photos" / f"{request.param}.png")), cv2.COLOR_BGR2RGB)


@pytest.mark.parametrize("row", PARITY)
def test_parity(row: str, photo: np.ndarray, device: torch.device) -> None:
    ours, theirs, dtype, tolerance, outliers = PARITY[row]
    picture = photo if dtype is np.uint8 else photo.astype(np.float32) / 255
    expected = torch.from_numpy(np.atleast_3d(theirs(picture))).permute(2, 0, 1)[None]
    actual = ours(tensor(picture).to(device))
    assert actual.dtype == tensor(picture).dtype
    assert_agree(actual, expected, tolerance, outliers)


@pytest.mark.parametrize("case, peer", PEERS_OF_CASES)
def test_peers_of_benchmarks(case: str, peer: str, photo: np.ndarray, device: torch.device) -> None:
    if peer == "skimage" and photo.shape[2] == 1:
        pytest.skip("takes the columns of a gray image for channels")
    x, case = tensor(photo.astype(np.float32) / 255), CASES[case]
    expected, actual = PEERS[peer].bind(case.peers[peer], [x], case.result).result(), case.call(x.to(device))
    if case.name.startswith("median") and peer == "opencv":  # replicates the border
        actual, expected = (y[..., case.border : -case.border, case.border : -case.border] for y in (actual, expected))
    assert_agree(actual, expected, (2e-5, 1e-5))  # a Laplacian sums numbers that nearly cancel


@pytest.mark.parametrize(
    "call", SAME_IN_KORNIA, ids=lambda call: "-".join([call.name, *map(str, call.others.values())])
)
def test_kornia(call: SampleCall, photo: np.ndarray, device: torch.device) -> None:
    x = tensor(photo.astype(np.float32) / 255)
    images = {name: gray(x) if name == "guidance" else x for name in call.axes}
    actual, expected = (call.call(library, to) for library, to in ((K, on(images, device)), (kornia, images)))
    if "canny" in call.name:  # rounding decides a few ridges, and hysteresis follows them
        assert_agree(actual[1], expected[1], EXACT, 5e-4)
    else:
        assert_agree(actual, expected)


def tensor(picture: np.ndarray) -> Tensor:
    return torch.from_numpy(picture).permute(2, 0, 1)[None]


def on(tensors: dict[str, Tensor], device: torch.device) -> dict[str, Tensor]:
    return {name: x.to(device) for name, x in tensors.items()}


def assert_agree(
    actual: Tensor, expected: Tensor, tolerance: tuple[float, float] = FLOAT, outliers: float = 0.0
) -> None:
    assert actual.shape == expected.shape
    actual, expected = actual.cpu().double(), expected.double()
    off = ~torch.isclose(actual, expected, *tolerance)
    assert off.double().mean() <= outliers, float((actual - expected).abs().max())
