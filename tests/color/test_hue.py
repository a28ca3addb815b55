"""HSV and HLS: known colors, ties, the seam of the color wheel, OpenCV's values."""

from __future__ import annotations

import colorsys
import itertools
import math

import cv2
import numpy as np
import pytest
import torch

import kvision as K
from op_tests import assert_close

C = K.color
TURN = 2 * math.pi

WHEEL = [  # (r, g, b), hue in sixths of a turn
    ((1, 0, 0), 0),
    ((1, 1, 0), 1),
    ((0, 1, 0), 2),
    ((0, 1, 1), 3),
    ((0, 0, 1), 4),
    ((1, 0, 1), 5),
    ((1, 0, 0.5), 5.5),
    ((0, 0, 0), 0),
    ((1, 1, 1), 0),
    ((0.5, 0.5, 0.5), 0),
]


def pixel(*values: float, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.tensor(values, dtype=dtype).view(3, 1, 1)


@pytest.mark.parametrize("rgb, sixths", WHEEL, ids=str)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16], ids=str)
def test_hsv_and_hls_of_primary_colors(rgb, sixths, dtype, device):
    x = pixel(*rgb, dtype=dtype).to(device)
    colored = float(max(rgb) > min(rgb))
    hsv = pixel(sixths * TURN / 6, colored, max(rgb)).to(dtype).to(device)
    hls = pixel(sixths * TURN / 6, (max(rgb) + min(rgb)) / 2, colored).to(dtype).to(device)
    rtol, atol = (1e-7, 1e-7) if dtype == torch.float64 else (None, None)
    assert_close(C.rgb_to_hsv(x), hsv, rtol, atol)
    assert_close(C.rgb_to_hls(x), hls, rtol, atol)


def test_colors_are_those_of_the_standard_library(device):
    x = torch.rand(3, 10, 10, dtype=torch.float64)
    hsv, hls = (convert(x.to(device)).cpu() for convert in (C.rgb_to_hsv, C.rgb_to_hls))
    for i, j in itertools.product(range(10), range(10)):
        h, s, v = colorsys.rgb_to_hsv(*x[:, i, j].tolist())
        assert hsv[:, i, j].tolist() == pytest.approx([TURN * h, s, v], abs=1e-6)
        h, lightness, s = colorsys.rgb_to_hls(*x[:, i, j].tolist())
        assert hls[:, i, j].tolist() == pytest.approx([TURN * h, lightness, s], abs=1e-6)


@pytest.mark.parametrize(
    "convert, back, code, inverse",
    [
        (C.rgb_to_hsv, C.hsv_to_rgb, cv2.COLOR_RGB2HSV, cv2.COLOR_HSV2RGB),
        (C.rgb_to_hls, C.hls_to_rgb, cv2.COLOR_RGB2HLS, cv2.COLOR_HLS2RGB),
    ],
)
def test_opencv_in_degrees(convert, back, code, inverse, device):
    array = np.random.default_rng(0).random((30, 40, 3), np.float32)
    theirs = cv2.cvtColor(array, code)
    scale = torch.tensor([360 / TURN, 1, 1], device=device)[:, None, None]
    ours = convert(K.image_to_tensor(array).to(device)) * scale
    np.testing.assert_allclose(K.tensor_to_image(ours), theirs, rtol=1e-4, atol=1e-3)
    rgb = back(K.image_to_tensor(theirs).to(device) / scale)
    np.testing.assert_allclose(K.tensor_to_image(rgb), cv2.cvtColor(theirs, inverse), atol=1e-5)


def test_hue_is_below_a_turn(device):
    """Reds with a trace of blue, in every type."""
    traces = 2.0 ** -torch.arange(1, 60, dtype=torch.float64)
    x = torch.stack([torch.ones_like(traces), torch.zeros_like(traces), traces])[..., None].to(device)
    for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16):
        for convert in (C.rgb_to_hsv, C.rgb_to_hls):
            hue = convert(x.to(dtype))[0]
            assert (hue.double() < TURN).all() and (hue >= 0).all()


@pytest.mark.parametrize("back", [C.hsv_to_rgb, C.hls_to_rgb])
def test_hue_is_an_angle(back, device):
    x = torch.rand(3, 6, 7, dtype=torch.float64, device=device)
    turned = x.clone()
    turned[0] += TURN * torch.randint(-3, 4, (6, 7), device=device).double()
    assert_close(back(turned), back(x), 1e-9, 1e-9)
    seam = torch.tensor([0.0, TURN, -1e-12, TURN + 1e-12], dtype=torch.float64, device=device).view(1, 1, 4)
    y = back(torch.cat([seam, torch.full_like(seam, 0.5), torch.full_like(seam, 0.5)]))
    assert_close(y, y[..., :1].expand_as(y), 0, 1e-9)


@pytest.mark.parametrize("convert", [C.rgb_to_hsv, C.rgb_to_hls])
def test_gradient_at_the_seam(convert, device):
    """Hue jumps by a turn at red; its slope does not: one sixth of a turn per unit of green, and less so of blue."""
    for green, blue in ((0, 0), (1e-3, 0), (0, 1e-3)):
        x = pixel(1, green, blue).to(device).requires_grad_()
        (slope,) = torch.autograd.grad(convert(x)[0].sum(), x)
        assert slope.flatten()[1:].tolist() == pytest.approx([TURN / 6, -TURN / 6], rel=1e-2)


@pytest.mark.parametrize("convert", [C.rgb_to_hsv, C.rgb_to_hls])
@pytest.mark.parametrize("level", [0.0, 0.25, 0.5, 1.0])
def test_grays_have_hue_zero_and_gradient_zero(convert, level, device):
    x = pixel(level, level, level).to(device).requires_grad_()
    y = convert(x)
    assert y[0].item() == 0
    (slope,) = torch.autograd.grad(y[0].sum(), x)
    assert not slope.any()


def test_eps(device):
    x = pixel(0.5, 0.25, 0.0).to(device)
    assert C.rgb_to_hsv(x, eps=0.5)[1].item() == pytest.approx(0.5 / (0.5 + 0.5))
    h, _, s = C.rgb_to_hls(x, eps=0.5).flatten().tolist()
    assert (h, s) == pytest.approx((0.25 / (0.5 + 0.5) * TURN / 6, 0.5 / (0.5 + 0.5)))
    for convert in (C.rgb_to_hsv, C.rgb_to_hls):
        assert convert(torch.zeros(3, 1, 1, device=device), eps=0).tolist() == torch.zeros(3, 1, 1).tolist()


@pytest.mark.slow
def test_every_color_of_bytes_survives(device):
    levels = torch.arange(256, device=device)
    for red in range(256):
        g, b = torch.meshgrid(levels, levels, indexing="ij")
        x = torch.stack([torch.full_like(g, red), g, b]).float() / 255
        for convert, back in ((C.rgb_to_hsv, C.hsv_to_rgb), (C.rgb_to_hls, C.hls_to_rgb)):
            assert torch.equal((back(convert(x)) * 255).round(), (x * 255).round())


def check_bytes(first: int, device) -> None:
    """All levels of two channels, combined with one of the first, equal OpenCV's; and back, where it rounds down."""
    levels = np.arange(256, dtype=np.uint8)
    array = np.stack(np.meshgrid(np.uint8(first), levels, levels, indexing="ij"), -1)[0]
    x = K.image_to_tensor(array).to(device)
    hsv = C.rgb_to_hsv(x, opencv=True)
    assert hsv.dtype == torch.uint8
    assert np.array_equal(K.tensor_to_image(hsv), cv2.cvtColor(array, cv2.COLOR_RGB2HSV))
    if first < 180:  # a hue
        back = K.tensor_to_image(C.hsv_to_rgb(x, opencv=True)).astype(int)
        assert abs(back - cv2.cvtColor(array, cv2.COLOR_HSV2RGB)).max() <= 1


def test_bytes_are_opencvs(device):
    for first in (0, 1, 127, 179, 255):
        check_bytes(first, device)


@pytest.mark.slow
def test_all_bytes_are_opencvs(device):
    for first in range(256):
        check_bytes(first, device)
