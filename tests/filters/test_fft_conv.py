"""fft_conv against filter2d, SciPy and Kornia."""

import kornia
import pytest
import scipy.signal
import torch

import kvision as K
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close

fft_conv = K.filters.fft_conv
BORDERS = ("constant", "reflect", "replicate", "circular")


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("size", [(1, 1), (3, 3), (5, 2), (4, 7)], ids=str)
@pytest.mark.parametrize("batch", [1, 2])
def test_against_filter2d_and_kornia(border, size, batch, device):
    x = torch.rand(2, 3, 11, 9, dtype=torch.float64, device=device)
    kernel = torch.randn(batch, *size, dtype=torch.float64, device=device)
    for padding in ("same", "valid"):
        for behaviour in ("corr", "conv"):
            options = {"border_type": border, "normalized": True, "padding": padding, "behaviour": behaviour}
            actual = fft_conv(x, kernel, **options)
            assert_close(actual, K.filters.filter2d(x, kernel, **options), atol=1e-12)
            assert_close(actual, kornia.filters.fft_conv(x, kernel, **options), atol=1e-12)


def test_against_scipy(device):
    x, kernel = torch.rand(40, 30, device=device), torch.randn(21, 17, device=device)
    expected = scipy.signal.fftconvolve(x.cpu().numpy(), kernel.cpu().numpy(), mode="same")
    actual = fft_conv(x[None, None], kernel[None], "constant", behaviour="conv")
    assert_close(actual[0, 0].cpu(), torch.from_numpy(expected), atol=2e-5)


def test_number_types(device):
    x = torch.randint(0, 256, (2, 3, 9, 8), device=device, dtype=torch.uint8)
    kernel = torch.tensor([[[-1.0, 0.0, 3.0]]], device=device)
    assert torch.equal(fft_conv(x, kernel), K.filters.filter2d(x, kernel))
    assert fft_conv(x.int(), kernel).dtype == torch.float32
    for dtype in (torch.float16, torch.bfloat16):
        assert_close(fft_conv((x / 255).to(dtype), kernel), fft_conv((x / 255).to(dtype).float(), kernel).to(dtype))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (([[1.0]], torch.ones(1, 3, 3)), TypeCheckError, "fft_conv: expected input to be a Tensor, got list"),
        ((torch.rand(3, 4), torch.ones(1, 3, 3)), ShapeError, r"fft_conv: expected input of shape \(B, C, H, W\)"),
        ((torch.rand(1, 1, 4, 4), torch.ones(3, 3)), ShapeError, "fft_conv: expected kernel of shape"),
        ((torch.rand(3, 1, 4, 4), torch.ones(2, 3, 3)), ShapeError, "a kernel batch of 1 or the 3 of the input, got 2"),
        ((torch.rand(1, 1, 4, 4), torch.ones(1, 0, 3)), ShapeError, "at least one tap"),
        (
            (torch.rand(1, 1, 4, 4), torch.ones(1, 3, 3), "mirror"),
            ValueCheckError,
            "fft_conv: border_type must be one of",
        ),
        ((torch.rand(1, 1, 4, 1), torch.ones(1, 3, 3)), ShapeError, "larger than its 'reflect' border of 1 pixel"),
        (
            (torch.rand(1, 1, 4, 4), torch.ones(1, 5, 3), "reflect", False, "valid"),
            ShapeError,
            "no larger than the input",
        ),
        (
            (torch.rand(1, 1, 4, 4), torch.ones(1, 3, 3), "reflect", False, "full"),
            ValueCheckError,
            "padding must be one",
        ),
        (
            (torch.rand(1, 1, 4, 4), torch.ones(1, 3, 3), "reflect", False, "same", "correlate"),
            ValueCheckError,
            "behaviour must be one of corr, conv",
        ),
        ((torch.rand(1, 1, 4, 4), torch.ones(1, 3, 3, device="meta")), DeviceError, "input on cpu, kernel on meta"),
    ],
)
def test_bad_input(arguments, error, message):
    with pytest.raises(error, match=message):
        fft_conv(*arguments)
