"""Guided blur against Kornia and a least-squares solver, on edges and on noise."""

import kornia
import pytest
import torch

import kvision as K
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError
from kvision.filters.smoothing.guided import _solve
from op_tests import assert_close, pairwise

guided_blur = K.filters.guided_blur
BORDERS = ("constant", "reflect", "replicate", "circular")


@pytest.mark.parametrize(
    ("border", "channels", "subsample"), pairwise(BORDERS, [(1, 1), (1, 3), (3, 2), (4, 4)], [1, 2, 3]), ids=str
)
def test_against_kornia(border, channels, subsample, device):
    guidance, x = (torch.rand(2, c, 25, 22, dtype=torch.float64, device=device) for c in channels)
    for size, eps in ((5, 0.1), ((3, 7), torch.rand(2, dtype=torch.float64, device=device) + 0.01)):
        actual = guided_blur(guidance, x, size, eps, border, subsample)
        assert_close(actual, kornia.filters.guided_blur(guidance, x, size, eps, border, subsample))
        assert_close(K.filters.GuidedBlur(size, eps, border, subsample)(guidance, x), actual)


def test_keeps_an_edge_and_flattens_noise(device):
    step = torch.zeros(1, 1, 32, 32, device=device)
    step[..., 16:] = 1
    noisy = step + 0.05 * torch.randn_like(step)
    smooth = guided_blur(noisy, noisy, 7, 0.02)
    assert (smooth - step).std() < 0.7 * (noisy - step).std()
    assert (smooth[..., 16:].min() - smooth[..., :16].max()) > 0.6


def test_huge_eps_is_the_mean_of_means(device):
    x = torch.rand(1, 3, 12, 13, dtype=torch.float64, device=device)
    assert_close(guided_blur(x, x, 3, 1e12), K.filters.box_blur(K.filters.box_blur(x, 3), 3), atol=1e-8)


@pytest.mark.parametrize("channels", [1, 2, 3, 6])
def test_elimination_against_a_solver(channels, device):
    root = torch.randn(2, channels, channels + 2, 3, 4, dtype=torch.float64, device=device)
    a = torch.einsum("bikhw,bjkhw->bijhw", root, root)
    y = torch.randn(2, channels, 5, 3, 4, dtype=torch.float64, device=device)
    expected = torch.linalg.solve(a.movedim((1, 2), (-2, -1)), y.movedim((1, 2), (-2, -1))).movedim((-2, -1), (1, 2))
    assert_close(_solve(a, y), expected, 1e-6, 1e-6)


def test_a_large_mean_costs_no_digits(device):
    """A guidance in [1000, 1001], and 16-bit photographs: within 1e-4 and a level of float64."""
    guidance, x = torch.rand(1, 3, 24, 31, device=device), torch.rand(1, 2, 24, 31, device=device)
    for eps in (1e-3, 1e-2):
        moved = guided_blur(guidance + 1000, x, 5, eps)
        assert_close(moved, guided_blur((guidance + 1000) - 1000, x, 5, eps), 0, 1e-4)
    photograph = 40000 + 20000 * K.filters.box_blur(guidance, 7) + 30 * guidance
    image = photograph.round()
    exact = guided_blur(image.double(), image.double(), 5, 1.0)
    assert (guided_blur(image, image, 5, 1.0) - exact).abs().max() < 0.01


def test_number_types(device):
    x = torch.randint(0, 256, (2, 3, 9, 8), device=device, dtype=torch.uint8)
    assert_close(guided_blur(x, x, 3, 100.0), guided_blur(x.float(), x.float(), 3, 100.0))
    half = (x / 255).half()
    assert_close(guided_blur(half, half, 3, 0.1), guided_blur(half.float(), half.float(), 3, 0.1).half())
    assert guided_blur(half, half.double(), 3, 0.1).dtype == torch.float64


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (([1.0], torch.rand(1, 1, 4, 4), 3, 0.1), TypeCheckError, "guided_blur: expected guidance to be a Tensor"),
        ((torch.rand(1, 1, 4, 4), None, 3, 0.1), TypeCheckError, "guided_blur: expected input to be a Tensor"),
        ((torch.rand(1, 1, 4, 4), torch.rand(1, 1, 4, 5), 3, 0.1), ShapeError, r"of shape \(1, N, 4, 4\), got"),
        ((torch.rand(1, 1, 4, 4), torch.rand(2, 1, 4, 4), 3, 0.1), ShapeError, "guided_blur: expected input"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 0, 0.1), ValueCheckError, "guided_blur: expected kernel_size"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, -0.1), ValueCheckError, "expected eps of at least 0, got -0.1"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, float("nan")), ValueCheckError, "got nan"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, "0.1"), TypeCheckError, "expected eps to be a number or a Tensor"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, torch.ones(2)), ShapeError, "eps with a batch size of 1 or 1"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, torch.ones(1, device="meta")), DeviceError, "eps on meta"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, 0.1, "mirror"), ValueCheckError, "guided_blur: border_type"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 9, 0.1), ShapeError, "guided_blur: expected input larger than its 'reflect'"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, 0.1, "reflect", 0), ValueCheckError, "guided_blur: expected subsample"),
        ((*[torch.rand(1, 1, 4, 4)] * 2, 3, 0.1, "reflect", 1.5), TypeCheckError, "guided_blur: expected subsample"),
    ],
)
def test_bad_input(arguments, error, message):
    with pytest.raises(error, match=message):
        guided_blur(*arguments)


@pytest.mark.parametrize("subsample", [1, 2])
def test_keeps_channels_last(subsample, device):
    x = torch.rand(2, 3, 8, 9, device=device)
    last = x.to(memory_format=torch.channels_last)
    result = K.filters.guided_blur(last, last, 3, 0.1, subsample=subsample)
    assert result.is_contiguous(memory_format=torch.channels_last)
    assert_close(result, K.filters.guided_blur(x, x, 3, 0.1, subsample=subsample))
    assert K.filters.guided_blur(x, x, 3, 0.1, subsample=subsample).is_contiguous()
