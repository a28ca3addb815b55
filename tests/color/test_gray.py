"""Gray: OpenCV's levels, any weights."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

import kvision as K
from op_tests import assert_close

C = K.color


CODES = [(C.rgb_to_grayscale, cv2.COLOR_RGB2GRAY), (C.bgr_to_grayscale, cv2.COLOR_BGR2GRAY)]


def check_bytes(convert, code, first: int, device) -> None:
    """All levels of two channels, combined with one level of the first."""
    levels = np.arange(256, dtype=np.uint8)
    array = np.stack(np.meshgrid(np.uint8(first), levels, levels, indexing="ij"), -1)[0]
    gray = convert(K.image_to_tensor(array).to(device))
    assert gray.dtype == torch.uint8
    assert np.array_equal(K.tensor_to_image(gray), cv2.cvtColor(array, code))


@pytest.mark.parametrize("convert, code", CODES)
def test_bytes_are_opencvs(convert, code, device):
    for first in (0, 1, 127, 254, 255):
        check_bytes(convert, code, first, device)


@pytest.mark.slow
@pytest.mark.parametrize("convert, code", CODES)
def test_all_bytes_are_opencvs(convert, code, device):
    for first in range(256):
        check_bytes(convert, code, first, device)


def test_floats_are_opencvs(device):
    array = np.random.default_rng(0).random((20, 30, 3), np.float32)
    x = K.image_to_tensor(array).to(device)
    expected = torch.from_numpy(cv2.cvtColor(array, cv2.COLOR_RGB2GRAY))[None]
    torch.testing.assert_close(C.rgb_to_grayscale(x).cpu(), expected, rtol=1e-6, atol=1e-6)


def test_weights_of_any_scale(device):
    x = torch.rand(2, 3, 4, 5, dtype=torch.float64, device=device, requires_grad=True)
    weights = torch.tensor([2.0, -1.0, 5.0], dtype=torch.float64, device=device, requires_grad=True)
    expected = 2 * x[:, :1] - x[:, 1:2] + 5 * x[:, 2:]
    assert_close(C.rgb_to_grayscale(x, weights), expected)
    assert_close(C.RgbToGrayscale(weights.detach())(x), expected)
    assert torch.autograd.gradcheck(C.rgb_to_grayscale, (x, weights))


@pytest.mark.parametrize("weights", [(0.5, 0.5, 0.0), (0.25, 0.25, 0.5), (0.125, 0.75, 0.125)])
def test_halves_of_bytes_are_exact(weights, device):
    levels = torch.arange(256, device=device)
    x = torch.stack(torch.meshgrid(levels, levels, levels[::37], indexing="ij")).flatten(2).byte()
    weights = torch.tensor(weights, device=device)
    expected = (x * weights[:, None, None]).sum(0, keepdim=True).round().clamp(0, 255).byte()
    assert torch.equal(C.rgb_to_grayscale(x, weights), expected)


def test_weights_of_bytes_round_and_saturate(device):
    x = torch.tensor([1, 2, 200], dtype=torch.uint8, device=device).view(3, 1, 1)
    for weights, expected in (
        ((0.5, 0.0, 0.0), 0),
        ((0.5, 0.5, 0.0), 2),
        ((0.0, 0.0, 2.0), 255),
        ((-1.0, 0.0, 0.0), 0),
    ):
        gray = C.rgb_to_grayscale(x, torch.tensor(weights, device=device))
        assert gray.dtype == torch.uint8 and gray.item() == expected


def test_weights_on_another_device(device):
    with pytest.raises(K.core.exceptions.DeviceError, match="^rgb_to_grayscale: "):
        C.rgb_to_grayscale(torch.rand(3, 4, 5, device=device), torch.ones(3, device="meta"))


def test_gray_in_three_channels_has_its_own_memory(device):
    gray = torch.rand(1, 4, 5, device=device)
    rgb = C.grayscale_to_rgb(gray)
    rgb[0] = 2
    assert torch.equal(rgb[1:], gray.expand(2, -1, -1)) and gray.max() < 1


def test_flat_names():
    assert K.rgb_to_grayscale is C.rgb_to_grayscale and K.bgr_to_rgb is C.bgr_to_rgb
