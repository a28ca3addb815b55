"""Bayer mosaics."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError
from op_tests import OpTests, assert_close

C = K.color
# Colors of a cell, row by row.
CELLS = {C.CFA.BG: "RGGB", C.CFA.GB: "GRBG", C.CFA.RG: "BGGR", C.CFA.GR: "GBRG"}


@pytest.fixture(params=CELLS, ids=lambda cfa: cfa.name)
def cfa(request: pytest.FixtureRequest) -> C.CFA:
    return request.param


def color_at(cfa: C.CFA, i: int, j: int) -> str:
    return CELLS[cfa][2 * (i % 2) + j % 2]


def test_mosaic(cfa, device):
    for dtype in (torch.float64, torch.float16, torch.uint8, torch.int64):
        x = (torch.rand(2, 2, 3, 5, 6, device=device) * 200).to(dtype)
        y = C.rgb_to_raw(x, cfa)
        assert y.shape == (2, 2, 1, 5, 6) and y.dtype == dtype
        for i in range(5):
            for j in range(6):
                assert torch.equal(y[..., 0, i, j], x[..., "RGB".index(color_at(cfa, i, j)), i, j])


def naive(x: torch.Tensor, cfa: C.CFA) -> torch.Tensor:
    """Each missing color as the mean of its nearest sites, of 2 or 4, in the mirrored mosaic."""
    h, w = x.shape
    y = torch.zeros(3, h, w, dtype=x.dtype)
    for c, color in enumerate("RGB"):
        for i in range(h):
            for j in range(w):
                rings = ([(0, 0)], [(-1, 0), (1, 0), (0, -1), (0, 1)], [(-1, -1), (-1, 1), (1, -1), (1, 1)])
                for ring in rings:
                    sites = [(i + di, j + dj) for di, dj in ring if color_at(cfa, i + di, j + dj) == color]
                    if sites:
                        inside = [
                            (abs(a) if a < h else 2 * h - 2 - a, abs(b) if b < w else 2 * w - 2 - b) for a, b in sites
                        ]
                        y[c, i, j] = sum(x[a, b] for a, b in inside) / len(inside)
                        break
    return y


@pytest.mark.parametrize("size", [(2, 2), (2, 6), (6, 8)], ids=str)
def test_demosaic(cfa, size, device):
    kornia = pytest.importorskip("kornia")
    x = torch.rand(2, 1, *size, dtype=torch.float64)
    y = C.raw_to_rgb(x.to(device), cfa).cpu()
    assert_close(y[0], naive(x[0, 0], cfa))
    theirs = kornia.color.CFA[cfa.name]
    assert_close(y, kornia.color.raw_to_rgb(x, theirs))
    assert_close(C.rgb_to_raw(y, cfa), x)
    small = C.raw_to_rgb_2x2_downscaled(x.to(device), cfa).cpu()
    assert_close(small, kornia.color.raw_to_rgb_2x2_downscaled(x, theirs))


class TestRawToRgb(OpTests):
    function = staticmethod(C.raw_to_rgb)
    module = C.RawToRgb
    operators = ("raw_to_rgb", "raw_to_rgb_backward")
    variants = [{"cfa": cfa} for cfa in CELLS]
    channels = 1
    shape = (2, 1, 14, 18)
    small = (1, 1, 4, 6)
    bytes = True

    def input(self, shape, dtype, device):
        """Of even height and width."""
        return super().input((*shape[:-2], *(n + n % 2 for n in shape[-2:])), dtype, device)

    test_nan_stays_in_its_window = None  # of two channels; test_nan_reaches_the_pixels_around_it below

    test_wrong_kinds = None  # test_errors below; any number of leading axes is right


def test_opencv_inside(cfa, device):
    array = np.random.default_rng(0).integers(0, 256, (12, 14), np.uint8)
    theirs = cv2.cvtColor(array, getattr(cv2, f"COLOR_Bayer{cfa.name}2RGB"))
    ours = K.tensor_to_image(C.raw_to_rgb(K.image_to_tensor(array).to(device), cfa))
    assert ours.dtype == np.uint8
    difference = np.abs(ours.astype(int) - theirs)[1:-1, 1:-1]
    assert difference.max() <= 1  # OpenCV rounds halves up


def test_bytes_round_once(cfa, device):
    x = torch.randint(0, 256, (1, 1, 8, 8), dtype=torch.uint8, device=device)
    for convert in (C.raw_to_rgb, C.raw_to_rgb_2x2_downscaled):
        assert torch.equal(convert(x, cfa), convert(x.float(), cfa).round().to(torch.uint8))
        assert_close(convert(x.int(), cfa), convert(x.float(), cfa))


CONVERSIONS = [
    (C.rgb_to_raw, C.RgbToRaw, 3),
    (C.raw_to_rgb, C.RawToRgb, 1),
    (C.raw_to_rgb_2x2_downscaled, C.RawToRgb2x2Downscaled, 1),
]


@pytest.mark.parametrize("convert, module, channels", CONVERSIONS)
def test_batches_types_layouts_and_gradients(convert, module, channels, cfa, device):
    x = torch.rand(3, 2, channels, 4, 6, dtype=torch.float64, device=device)
    y = convert(x, cfa)
    assert_close(convert(x[0], cfa), y[0])
    assert_close(convert(x[0, 0], cfa), y[0, 0])
    assert_close(torch.func.vmap(lambda s: convert(s, cfa))(x), y)
    assert_close(module(cfa)(x), y)
    assert cfa.name in repr(module(cfa))
    assert convert(x[:0], cfa).shape == (0, *y.shape[1:])
    assert_close(convert(x[0].half(), cfa), convert(x[0].half().float(), cfa).half())
    assert_close(convert(x[0].contiguous(memory_format=torch.channels_last), cfa), y[0])
    leaf = x[:1, 0].requires_grad_()
    assert torch.autograd.gradcheck(lambda s: convert(s, cfa), leaf)
    assert torch.autograd.gradgradcheck(lambda s: convert(s, cfa), leaf)


def test_nan_reaches_the_pixels_around_it(cfa, device):
    x = torch.rand(1, 1, 8, 8, device=device)
    x[..., 3, 4] = float("nan")
    bad = C.raw_to_rgb(x, cfa).isnan()
    assert bad[..., 3, 4].any() and not bad[..., :2, :].any() and not bad[..., 5:, :].any()
    assert not bad[..., :3].any() and not bad[..., 6:].any()


@pytest.mark.parametrize("convert, module, channels", CONVERSIONS)
def test_errors(convert, module, channels, device):
    name = convert.__name__
    x = torch.rand(2, channels, 4, 6, device=device)
    for wrong, cfa, error, text in [
        (None, C.CFA.BG, TypeCheckError, "image to be a Tensor"),
        (x[0, 0], C.CFA.BG, ShapeError, rf"image of shape \(\*, {channels}, H, W\)"),
        (torch.cat([x, x], 1), C.CFA.BG, ShapeError, rf"image of shape \(\*, {channels}, H, W\)"),
        (x, "BG", TypeCheckError, "cfa to be a CFA, got 'BG'"),
        (x, 0, TypeCheckError, "cfa to be a CFA, got 0"),
    ]:
        with pytest.raises(error, match=f"^{name}: expected {text}"):
            convert(wrong, cfa)
    if channels == 1:
        for wrong in (x[..., :5], x[..., :3, :]):
            with pytest.raises(ShapeError, match=f"^{name}: expected image with even H and W, got"):
                convert(wrong, C.CFA.BG)


@pytest.mark.parametrize("cfa", C.CFA)
def test_no_images(cfa, device):
    for shape in ((0, 1, 4, 6), (2, 1, 0, 6), (2, 1, 4, 0), (1, 0, 6), (5, 2, 1, 0, 0)):
        *leading, _, h, w = shape
        x = torch.rand(shape, device=device, requires_grad=True)
        full, half = C.raw_to_rgb(x, cfa), C.raw_to_rgb_2x2_downscaled(x, cfa)
        assert full.shape == (*leading, 3, h, w) and half.shape == (*leading, 3, h // 2, w // 2)
        assert torch.autograd.grad(full.sum(), x)[0].shape == shape
        assert C.raw_to_rgb(x.detach().byte(), cfa).dtype == torch.uint8
