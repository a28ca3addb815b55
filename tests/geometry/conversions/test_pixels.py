"""Pixels, normalized coordinates, and homographies between them."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
P2, P3, MATRIX, POSE = (2, 5, 2), (2, 5, 3), (2, 3, 3), (2, 4, 4)


class TestPixels(CompositionTests):
    cases = {
        "normalize_pixel_coordinates": Case(lambda p: G.normalize_pixel_coordinates(p, 3, 1), (P2,)),
        "denormalize_pixel_coordinates": Case(lambda p: G.denormalize_pixel_coordinates(p, 3, 1), (P2,)),
        "normalize_pixel_coordinates3d": Case(lambda p: G.normalize_pixel_coordinates3d(p, 3, 1, 5), (P3,)),
        "denormalize_pixel_coordinates3d": Case(lambda p: G.denormalize_pixel_coordinates3d(p, 3, 1, 5), (P3,)),
        "normalize_homography": Case(lambda m: G.normalize_homography(m, (3, 4), (1, 5)), (MATRIX,)),
        "denormalize_homography": Case(lambda m: G.denormalize_homography(m, (3, 4), (1, 5), False), (MATRIX,)),
        "normalize_homography3d": Case(lambda m: G.normalize_homography3d(m, (2, 3, 4), (2, 1, 5)), (POSE,)),
        "denormalize_homography3d": Case(lambda m: G.denormalize_homography3d(m, (2, 3, 4), (2, 1, 5)), (POSE,)),
        "normalize_points_with_intrinsics": Case(G.normalize_points_with_intrinsics, (P2, MATRIX)),
        "denormalize_points_with_intrinsics": Case(G.denormalize_points_with_intrinsics, (P2, MATRIX)),
    }
    compiled = ("normalize_homography",)


GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


SIZES = [((3, 4), (2, 5)), ((1, 4), (3, 1))]
CALLS = [
    *(("normalize_pixel_coordinates", (rand(2, 3, 2), *a)) for a, _ in SIZES),
    *(("denormalize_pixel_coordinates", (rand(2, 3, 2), *a)) for a, _ in SIZES),
    *(("normalize_pixel_coordinates3d", (rand(2, 3, 3), 2, *a)) for a, _ in SIZES),
    *(("denormalize_pixel_coordinates3d", (rand(2, 3, 3), 2, *a)) for a, _ in SIZES),
    *(("normalize_homography", (rand(2, 3, 3), *sizes, a)) for sizes in SIZES for a in (True, False)),
    *(("denormalize_homography", (rand(2, 3, 3), *sizes, a)) for sizes in SIZES for a in (True, False)),
    *(("normalize_homography3d", (rand(2, 4, 4), (2, *a), (3, *b))) for a, b in SIZES),
    *(("denormalize_homography3d", (rand(2, 4, 4), (2, *a), (3, *b))) for a, b in SIZES),
    *(("normalize_points_with_intrinsics", (rand(2, 5, 2), rand(*s, 3, 3))) for s in ((), (1,), (2,), (2, 1))),
    ("denormalize_points_with_intrinsics", (rand(2, 5, 2), rand(2, 3, 3))),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry
    result = getattr(G, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    expected = getattr(theirs, name)(*args)
    for ours, his in zip(*((y,) if isinstance(y, Tensor) else y for y in (result, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-7, 1e-9)


def test_normalized_homography_agrees_with_normalized_points(device):
    H, p = rand(1, 3, 3).to(device), rand(1, 6, 2).to(device)
    moved = G.normalize_pixel_coordinates(G.transform_points(H, p), 6, 7)
    normalized = G.transform_points(G.normalize_homography(H, (4, 5), (6, 7)), G.normalize_pixel_coordinates(p, 4, 5))
    assert_close(normalized, moved, 1e-9, 1e-9)


EYE, ONES = torch.eye(3), torch.ones(2, 4, 3)
BAD = [
    (lambda: G.normalize_pixel_coordinates(ONES, 3, 4), ValueError, r"pixel_coordinates of shape \(\*, 2\)"),
    (lambda: G.normalize_pixel_coordinates(ONES[..., :2], 0, 4), ValueError, "expected height to be an int of at least 1"),
    (lambda: G.normal_transform_pixel(2.5, 3), TypeError, "normal_transform_pixel: expected height to be an int"),
    (lambda: G.normalize_homography(EYE.int(), (2, 3), (2, 3)), TypeError, "normalize_homography: .* floating point"),
    (lambda: G.normalize_homography(EYE, 3.5, (2, 3)), TypeError, "normalize_homography: expected dsize_src"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
