"""Adjustments: values computed by hand, and those of PIL."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import OpTests, assert_close

E = K.enhance


def color(*channels: float) -> Tensor:
    return torch.tensor(channels).view(-1, 1, 1)


LATTICE = torch.cartesian_prod(*[torch.linspace(0, 1, 9)] * 3).T.reshape(3, 27, 27)
BYTES = torch.arange(256).repeat(3, 1).flatten()[:762].reshape(3, 2, 127).byte()


@pytest.mark.parametrize(
    "function, factor",
    [
        (E.adjust_brightness, 0.0),
        (E.adjust_brightness_accumulative, 1.0),
        (E.adjust_contrast, 1.0),
        (E.adjust_contrast_with_mean_subtraction, 1.0),
        (E.adjust_gamma, 1.0),
        (E.adjust_hue, 0.0),
        (E.adjust_saturation, 1.0),
        (E.adjust_saturation_with_gray_subtraction, 1.0),
        (E.sharpness, 1.0),
    ],
)
def test_identity(function, factor, device):
    x = LATTICE.to(device)
    assert_close(function(x, factor), x)
    assert_close(function(x[None], torch.tensor([factor], device=device)), x[None])


def test_hue_turns_primaries_round():
    red, green, blue = (torch.eye(3)[i].view(3, 1, 1) for i in range(3))
    third = 2 * math.pi / 3
    for start, end in ((red, green), (green, blue), (blue, red)):
        assert_close(E.adjust_hue(start, third), end)
        assert_close(E.adjust_hue(end, -third), start)
        assert_close(E.adjust_hue(start, third + 20 * math.pi), end, 0, 1e-4)


def test_hue_undone(device):
    x = LATTICE.to(device)
    for angle in (0.1, 3.0, -2.0, 6.2):
        assert_close(E.adjust_hue(E.adjust_hue(x, angle), -angle), x, 0, 2e-5)


def test_hue_of_hsv_stays_below_a_turn():
    hue = torch.tensor([0.0, 1e-8, 6.2831850]).view(1, 1, 3).expand(3, 1, 3)
    for angle in (0.0, -1e-8, -1e-9, 2 * math.pi):
        assert ((0 <= (h := E.adjust_hue_raw(hue, angle)[0])) & (h < 2 * math.pi)).all()


def test_saturation_ends_at_gray_and_at_full():
    x = color(0.8, 0.4, 0.6)
    assert_close(E.adjust_saturation(x, 0.0), color(0.8, 0.8, 0.8))
    assert_close(E.adjust_saturation(x, -1.0), color(0.8, 0.8, 0.8))
    assert_close(E.adjust_saturation(x, 9.0), color(0.8, 0.0, 0.4))
    gray = LATTICE[:1].expand(3, -1, -1)
    assert_close(E.adjust_saturation(gray, 5.0), gray)


def test_gamma_of_black_and_below():
    x = torch.tensor([[-1.0, 0.0, 0.25]])
    assert_close(E.adjust_gamma(x, 0.5), torch.tensor([[0.0, 0.0, 0.5]]))
    assert_close(E.adjust_gamma(x, 0.0, 0.5), torch.full((1, 3), 0.5))
    assert_close(E.adjust_gamma(x, torch.tensor([0.0])), torch.ones(1, 3))
    assert_close(E.adjust_gamma(x, torch.tensor([0.5])), torch.tensor([[0.0, 0.0, 0.5]]))


def test_sigmoid_of_steep_curves_keeps_its_gradient_finite():
    x = torch.tensor([[-50.0, 0.5, 50.0]], requires_grad=True)
    y = E.adjust_sigmoid(x, gain=1000.0)
    y.sum().backward()
    assert_close(y.detach(), torch.tensor([[0.0, 0.5, 1.0]]))
    assert_close(x.grad, torch.tensor([[0.0, 250.0, 0.0]]))


def test_logarithm_and_its_inverse():
    x = torch.linspace(0, 1, 50)[None]
    assert_close(E.adjust_log(E.adjust_log(x), inv=True), x)


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.7])
@pytest.mark.parametrize(
    "function, name",
    [
        (E.adjust_brightness_accumulative, "Brightness"),
        (E.adjust_contrast_with_mean_subtraction, "Contrast"),
        (E.adjust_saturation_with_gray_subtraction, "Color"),
        (E.sharpness, "Sharpness"),
    ],
)
def test_pil_enhancers(function, name, factor):
    """PIL rounds its gray and its result to levels."""
    image, enhance = pytest.importorskip("PIL.Image"), pytest.importorskip("PIL.ImageEnhance")
    pixels = torch.randint(0, 256, (40, 50, 3), dtype=torch.uint8)
    expected = np.asarray(getattr(enhance, name)(image.fromarray(pixels.numpy())).enhance(factor))
    actual = 255 * function(K.image_to_tensor(pixels.numpy()).float() / 255, factor)
    assert (actual - torch.from_numpy(expected.copy()).permute(2, 0, 1)).abs().max() <= 2.1


def test_pil_solarize_and_posterize():
    image, ops = pytest.importorskip("PIL.Image"), pytest.importorskip("PIL.ImageOps")
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    x = torch.from_numpy(levels).float() / 255
    for t in (1, 100, 255):
        expected = np.asarray(ops.solarize(image.fromarray(levels), t))
        assert_close((255 * E.solarize(x, t / 255)).round(), torch.from_numpy(expected.copy()).float())
    for bits in range(1, 9):
        expected = np.asarray(ops.posterize(image.fromarray(levels), bits))
        assert_close((255 * E.posterize(x, bits)).round(), torch.from_numpy(expected.copy()).float())


def test_posterize_keeps_the_bytes_of_every_type(device):
    levels = torch.arange(256, device=device).view(16, 16)
    for dtype in (torch.float64, torch.float32, torch.float16):
        for bits in (1, 4, 7):
            y = E.posterize((levels.float() / 255).to(dtype), bits)
            assert torch.equal((255 * y.double()).round().long(), levels >> (8 - bits) << (8 - bits))


def test_sharpness_of_images_without_interior(device):
    for size in ((1, 1), (2, 5), (5, 2)):
        x = torch.rand(2, 3, *size, device=device)
        assert torch.equal(E.sharpness(x, 3.0), x)


def test_inversion_of_bytes():
    assert torch.equal(E.invert(BYTES, 255), 255 - BYTES)
    assert E.invert(BYTES, torch.tensor(255.0)).dtype == torch.uint8


def test_gray_images_have_no_saturation():
    x = torch.rand(2, 1, 4, 4)
    assert torch.equal(E.adjust_saturation_with_gray_subtraction(x, 0.3), x)


class TestMix(OpTests):
    """Weights are numbers, or tensors in front of which there is the batch."""

    function = staticmethod(lambda input, src2, **weights: E.add_weighted(input, src2=src2, **weights))
    operators = ("add_weighted", "color_program")
    mixed = ("input", "p0")  # of color_program, as always
    other = staticmethod(lambda x: x.flip(-1))
    variants = [
        {"src2": other, "alpha": 0.6, "beta": -0.7, "gamma": 0.2},
        {"src2": other, "alpha": lambda x: torch.rand(x.shape[0], 1, 1, 1), "beta": 0.5, "gamma": 0.0},
        {"src2": other, "alpha": 0.3, "beta": lambda x: torch.rand(x.shape[1], 1, 1), "gamma": lambda x: torch.rand(1)},
    ]
    max_size = 9

    def call(self, x, kwargs):
        return self.function(x, **{**kwargs, "src2": kwargs["src2"].to(x.dtype)})

    test_wrong_kinds = None  # test_all.py; images of any shape are right


def test_weights_broadcast(device):
    x, y = torch.rand(2, 2, 3, 4, 5, device=device)
    a, b = torch.rand(2, 1, 1, 1, device=device), torch.rand(3, 1, 1, device=device)
    c = torch.rand(5, device=device)
    assert_close(E.add_weighted(x, a, y, b, c), x * a + y * b + c)
    levels = (255 * x).byte()
    assert_close(E.add_weighted(levels, 0.5, levels, 0.5, 0.0), levels.float())


def test_integers_sum_up_exactly():
    x = torch.full((2, 300, 300), 255, dtype=torch.uint8)
    y = E.integral_image(x)
    assert y.dtype == torch.int64 and y[0, -1, -1] == 255 * 90000


def test_rectangle_sums_from_integral_image():
    cv2 = pytest.importorskip("cv2")
    x = torch.rand(20, 30, dtype=torch.float64)
    assert_close(E.integral_image(x), torch.from_numpy(cv2.integral(x.numpy())[1:, 1:]))
