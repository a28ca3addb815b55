"""The same values as Kornia 0.9; docs/differences.md lists where not."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import assert_close

kornia = pytest.importorskip("kornia.enhance")
E = K.enhance
F = torch.tensor([0.3, 1.7])  # one factor a sample


@pytest.fixture
def x() -> torch.Tensor:
    return torch.rand(2, 3, 37, 45)


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.0, 2.3, F], ids=str)
@pytest.mark.parametrize(
    "name",
    [
        "adjust_brightness",
        "adjust_brightness_accumulative",
        "adjust_contrast",
        "adjust_contrast_with_mean_subtraction",
        "adjust_gamma",
        "adjust_hue",
        "adjust_hue_raw",
        "adjust_saturation",
        "adjust_saturation_raw",
        "adjust_saturation_with_gray_subtraction",
        "sharpness",
    ],
)
def test_factors(name, factor, x):
    assert_close(getattr(E, name)(x, factor), getattr(kornia, name)(x, factor), 2e-5, 5e-6)


@pytest.mark.parametrize(
    "name, arguments",
    [
        ("adjust_brightness", (0.7, False)),
        ("adjust_contrast", (1.7, False)),
        ("adjust_brightness_accumulative", (1.7, False)),
        ("adjust_gamma", (F, F)),
        ("adjust_log", (0.7,)),
        ("adjust_log", (2.0, True, False)),
        ("adjust_sigmoid", (0.4, 7.0)),
        ("adjust_sigmoid", (0.4, 7.0, True)),
        ("denormalize", (F.mean().expand(3), torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]))),
        ("integral_image", ()),
        ("integral_tensor", ((0, 2),)),
        ("invert", (torch.tensor(0.9),)),
        ("normalize", (torch.tensor([0.1, 0.2, 0.3]), torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]))),
        ("normalize", (0.5, torch.tensor([0.2]))),
        ("normalize_min_max", (0.2, 0.9)),
        ("posterize", (torch.tensor([1, 8]),)),
        ("posterize", (torch.tensor([[1, 2, 3], [8, 0, 5]]),)),
        ("shift_rgb", (F, 0.2 * F, -F)),
        ("solarize", (0.4 * F, 0.2 * F)),
    ],
)
def test_functions(name, arguments, x):
    tolerance = 1e-3 if "integral" in name else 5e-6
    expected = getattr(kornia, name)(x, *arguments)
    assert_close(getattr(E, name)(x, *arguments), expected, 2e-5, tolerance)


def test_posterize_of_every_level():
    levels = torch.arange(256.0).view(1, 1, 16, 16) / 255
    for bits in range(9):
        assert_close(E.posterize(levels, bits), kornia.posterize(levels, bits))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16], ids=str)
def test_equalize(dtype):
    x = torch.rand(2, 3, 64, 80).square().to(dtype)
    assert_close(E.equalize(x), kornia.equalize(x))
    assert_close(E.equalize3d(x[None]), kornia.equalize3d(x[None]))
    few = x[..., :3, :3]
    assert torch.equal(E.equalize(few), few)


@pytest.mark.parametrize("grid", [(8, 8), (1, 1), (2, 3), (3, 5), (1, 4), (4, 1)], ids=str)
@pytest.mark.parametrize("clip", [40.0, 2.0, 0.5, 0.0])
def test_clahe(grid, clip):
    x = torch.rand(2, 3, 64, 80).square()
    assert_close(E.equalize_clahe(x, clip, grid), kornia.equalize_clahe(x, clip, grid), 0, 2e-6)
    smooth = E.equalize_clahe(x[:1, :1], clip, grid, True)
    assert_close(smooth, kornia.equalize_clahe(x[:1, :1], clip, grid, True), 0, 1e-3)


def test_histograms():
    a = torch.rand(2, 500, dtype=torch.float64)
    b, bins, width = 1 - a * a, torch.linspace(0, 1, 50).double(), torch.tensor(0.03).double()
    assert_close(E.histogram(a, bins, width), kornia.histogram(a, bins, width))
    assert_close(E.histogram2d(a, b, bins, width), kornia.histogram2d(a, b, bins, width))


@pytest.mark.parametrize("kernel", ["triangular", "gaussian", "uniform", "epanechnikov"])
@pytest.mark.parametrize("bandwidth", [None, 7.0])
def test_image_histogram2d(kernel, bandwidth, x):
    for image in (x.double() * 300 - 20, x[0].double() * 255, x[0, 0].double() * 255):
        options = {"n_bins": 64, "bandwidth": bandwidth, "return_pdf": True, "kernel": kernel}
        assert_close(E.image_histogram2d(image, **options), kornia.image_histogram2d(image, **options))
        centers = torch.rand(20).double() * 255
        options = {"bandwidth": bandwidth, "centers": centers, "kernel": kernel}
        assert_close(E.image_histogram2d(image, **options), kornia.image_histogram2d(image, **options))


@pytest.mark.parametrize("quality", [0.0, 1.0, 10.0, 49.0, 50.0, 75.0, 100.0])
def test_jpeg(quality, x):
    """Kornia rounds the factors of its YCbCr to three digits."""
    each = torch.tensor([quality, 100 - quality])
    expected = kornia.jpeg_codec_differentiable(x, each)
    assert_close(E.jpeg_codec_differentiable(x, each), expected, 0, 5e-4)


def test_threshold_of_every_type(x):
    levels = (x * 255).byte()
    for kind in range(5):
        assert_close(E.threshold(x, 0.4, 1.0, kind), kornia.threshold(x, 0.4, 1.0, kind))
        for t in (-3, 0, 100.7, 254, 255, 300):
            assert torch.equal(E.threshold(levels, t, 200.0, kind), kornia.threshold(levels, t, 200.0, kind))


@pytest.mark.parametrize("dim", [0, 1, -1])
def test_zca(dim):
    z = torch.randn(20, 3, 2, dtype=torch.float64)
    options = {"dim": dim, "eps": 0.01, "return_inverse": True}
    actual, expected = E.zca_mean(z, **options), kornia.zca_mean(z, **options)
    assert_close(actual, expected, 1e-8, 1e-8)
    assert_close(E.linear_transform(z, *actual[:2], dim), kornia.linear_transform(z, *expected[:2], dim), 1e-8, 1e-8)
