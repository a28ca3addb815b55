"""Tests of every function of kvision.enhance."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close

E = K.enhance


def of_image(call: Callable[..., Tensor], *parameters: tuple[int, ...], channels: int = 3, **more: Any) -> Case:
    """A case of two small images and of parameters of these shapes."""
    return Case(call, ((2, channels, 5, 6), *parameters), **more)


class TestFunctions(CompositionTests):
    cases = {
        "add_weighted": of_image(lambda x, a: E.add_weighted(x, a, x * x, 0.3, 0.1), (2, 1, 1, 1)),
        "adjust_brightness": of_image(lambda x, f: E.adjust_brightness(x, f - 0.5), (2,)),
        "adjust_brightness_accumulative": of_image(E.adjust_brightness_accumulative, (2, 3)),
        "adjust_brightness_of_channels": of_image(
            lambda x, f: E.adjust_brightness(x, f, False), (2, 2, 1, 1), channels=2
        ),
        "adjust_contrast": of_image(E.adjust_contrast, (2,)),
        "adjust_contrast_with_mean_subtraction": of_image(E.adjust_contrast_with_mean_subtraction, (2,)),
        "adjust_contrast_with_mean_subtraction_of_two": of_image(
            E.adjust_contrast_with_mean_subtraction, (2,), channels=2
        ),
        "adjust_gamma": of_image(lambda x, g, a: E.adjust_gamma(x, 2 * g, a), (2,), (2,)),
        "adjust_hue": of_image(lambda x, f: E.adjust_hue(x, 6 * f), (2,)),
        "adjust_hue_raw": of_image(E.adjust_hue_raw, (2,)),
        "adjust_log": of_image(lambda x, f: E.adjust_log(x, f, inv=True), (2,)),
        "adjust_saturation": of_image(lambda x, f: E.adjust_saturation(x, 2 * f), (2,)),
        "adjust_saturation_raw": of_image(lambda x, f: E.adjust_saturation_raw(x, 2 * f), (2,)),
        "adjust_saturation_with_gray_subtraction": of_image(E.adjust_saturation_with_gray_subtraction, (2,)),
        "adjust_sigmoid": of_image(lambda x, c, g: E.adjust_sigmoid(x, c, 9 * g), (2,), (2,)),
        "denormalize": of_image(E.denormalize, (2, 3), (2, 3)),
        "equalize": of_image(E.equalize, differentiable=False),
        "equalize3d": of_image(E.equalize3d, differentiable=False),
        "equalize_clahe": of_image(lambda x: E.equalize_clahe(x, 2.0, (3, 2)), differentiable=False),
        "equalize_clahe_differentiable": of_image(lambda x: E.equalize_clahe(x, 200.0, (2, 1), True), channels=1),
        "image_histogram2d": of_image(lambda x: E.image_histogram2d(x, 0.0, 1.0, 7, return_pdf=True)[1]),
        "image_histogram2d_gaussian": of_image(lambda x: E.image_histogram2d(x, 0.0, 1.0, 16, kernel="gaussian")[0]),
        "integral_image": of_image(E.integral_image),
        "invert": of_image(lambda x: E.invert(x, 0.7)),
        "jpeg_codec_differentiable": of_image(lambda x, q: E.jpeg_codec_differentiable(x, 90 * q), (2,)),
        "normalize": of_image(E.normalize, (2, 3), (2, 3)),
        "normalize_min_max": of_image(lambda x: E.normalize_min_max(x, -1.0, 2.0)),
        "posterize": of_image(lambda x: E.posterize(x, 3), differentiable=False),
        "sharpness": of_image(lambda x, f: E.sharpness(x, 2 * f), (2,)),
        "shift_rgb": of_image(lambda x, f: E.shift_rgb(x, f, 0.1, -f), (2,)),
        "solarize": of_image(lambda x, a: E.solarize(x, 0.6, a / 2), (2,)),
        "threshold": of_image(lambda x: E.threshold(x, 0.5, 0.7, 3)),
    }
    compiled = "adjust_gamma", "equalize_clahe", "sharpness"
    of_batches = {  # what takes no other axes in front, or has parameters that do not follow them
        "add_weighted",
        "adjust_contrast_with_mean_subtraction_of_two",
        "denormalize",
        "equalize3d",
        "image_histogram2d",
        "image_histogram2d_gaussian",
        "jpeg_codec_differentiable",
        "normalize",
        "shift_rgb",
    }

    def test_samples_are_independent(self, case, device):
        values = self.values(case, device)
        whole = case.call(*values)
        for i in range(2):
            assert_close(case.call(*(v[i : i + 1] for v in values)), whole[i : i + 1])

    def test_any_rank(self, name, case, device):
        """Axes in front are a batch, with parameters for the first of them or for all; without a batch it is one image."""
        if name in self.of_batches:
            pytest.skip("takes batches, or its parameters differ")
        x, *parameters = self.values(case, device)
        each = [p[:, None] for p in parameters]
        expected = case.call(x, *parameters)
        assert_close(case.call(x[0], *(p[0] for p in parameters)), expected[0])
        assert_close(case.call(x[:, None], *each), expected[:, None])
        assert_close(case.call(x[:, None].expand(2, 3, *x.shape[1:]), *each)[:, 1], expected)

    @pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
    def test_halves(self, name, case, dtype, device):
        x, *parameters = (v.float() for v in self.values(case, device, dtype))
        y = case.call(x.to(dtype), *parameters)
        if name.startswith("image_histogram2d"):  # counts need more than a half
            assert_close(y, case.call(x, *parameters))
            return
        assert y.dtype == dtype
        if (
            case.differentiable and name != "equalize_clahe_differentiable"
        ):  # the others jump where a product is rounded
            assert_close(y, case.call(x, *parameters).to(dtype))

    def test_gradients_are_finite_on_plain_colors(self, case, device):
        """Black, white, grays, saturated primaries: where maxima tie and powers have no slope."""
        self.needs_gradient(case)
        like, *parameters = self.values(case, device, torch.float32)
        primary = torch.tensor([1.0, 0, 0][: like.shape[1]], device=device).view(-1, 1, 1)
        gray = torch.tensor([0.0, 1.0, 0.5, 1 / 3], device=device).view(4, 1, 1, 1)
        for color in torch.cat([gray.expand(4, len(primary), 1, 1), primary[None], 1 - primary[None]]):
            x = color.expand_as(like).clone().requires_grad_()
            values = [x, *(p.clone().requires_grad_() for p in parameters)]
            y = case.call(*values)
            grads = torch.autograd.grad(y.sum(), values, allow_unused=True)
            assert y.isfinite().all()
            assert all(g is None or g.isfinite().all() for g in grads)

    def test_nan_stays_where_it_is(self, name, case, device):
        spread = "mean_subtraction", "min_max", "jpeg", "integral", "sharpness", "histogram"
        if any(word in name for word in spread):
            pytest.skip("its pixels depend on others")
        x, *parameters = self.values(case, device)
        x[0, :, 2, 3] = torch.nan
        y = case.call(x, *parameters)
        expected = torch.zeros_like(x[:, :1], dtype=torch.bool)
        expected[0, :, 2, 3] = name != "threshold"  # which keeps no value it cannot compare
        assert torch.equal(y.isnan().any(1, keepdim=True), expected)


# --- modules --------------------------------------------------------------------------------------------------------

MODULES = [
    ("AdjustBrightness", (0.2,), E.adjust_brightness),
    ("AdjustBrightnessAccumulative", (1.2,), E.adjust_brightness_accumulative),
    ("AdjustContrast", (1.2,), E.adjust_contrast),
    ("AdjustContrastWithMeanSubtraction", (1.2,), E.adjust_contrast_with_mean_subtraction),
    ("AdjustGamma", (1.2, 0.8), E.adjust_gamma),
    ("AdjustHue", (1.2,), E.adjust_hue),
    ("AdjustLog", (0.5, True, False), E.adjust_log),
    ("AdjustSaturation", (1.2,), E.adjust_saturation),
    ("AdjustSaturationWithGraySubtraction", (1.2,), E.adjust_saturation_with_gray_subtraction),
    ("AdjustSigmoid", (0.3, 5.0, True), E.adjust_sigmoid),
    ("Denormalize", (0.5, torch.tensor([0.1, 0.2, 0.3])), E.denormalize),
    ("IntegralImage", (), E.integral_image),
    ("IntegralTensor", ((1, 2),), E.integral_tensor),
    ("Invert", (0.8,), E.invert),
    ("Normalize", (torch.tensor([0.1, 0.2, 0.3]), 0.5), E.normalize),
    ("Rescale", (0.5,), lambda x, factor: x * factor),
    ("Threshold", (0.5, 0.9, E.ThresholdType.THRESH_TOZERO), E.threshold),
]


@pytest.mark.parametrize("name, arguments, function", MODULES, ids=[m[0] for m in MODULES])
def test_module(name, arguments, function, device):
    x = torch.rand(2, 3, 5, 6, device=device)
    module = getattr(E, name)(*arguments).to(device)
    assert_close(module(x), function(x, *(a.to(device) if isinstance(a, Tensor) else a for a in arguments)))
    assert repr(module).startswith(name) and not module.state_dict()


def test_parameters_of_modules_are_learned(device):
    module = E.AdjustGamma(torch.nn.Parameter(torch.tensor(1.0))).to(device)
    x = torch.rand(2, 3, 5, 6, device=device)
    (module(x) - x.square()).square().mean().backward()
    assert module.gamma.grad < 0  # towards 2


def test_modules_of_two_tensors(device):
    x, y = torch.rand(2, 2, 3, 20, 17, device=device)
    assert_close(E.AddWeighted(0.2, 0.7, 0.1)(x, y), E.add_weighted(x, 0.2, y, 0.7, 0.1))
    quality = torch.tensor([20.0, 80.0], device=device)
    assert_close(E.JPEGCodecDifferentiable().to(device)(x, quality), E.jpeg_codec_differentiable(x, quality))


# --- errors ---------------------------------------------------------------------------------------------------------

X = torch.rand(2, 3, 4, 4)
ADJUST = [
    (E.adjust_brightness, (0.1,)),
    (E.adjust_brightness_accumulative, (0.1,)),
    (E.adjust_contrast, (0.1,)),
    (E.adjust_contrast_with_mean_subtraction, (0.1,)),
    (E.adjust_gamma, (0.1,)),
    (E.adjust_hue, (0.1,)),
    (E.adjust_hue_raw, (0.1,)),
    (E.adjust_log, ()),
    (E.adjust_saturation, (0.1,)),
    (E.adjust_saturation_raw, (0.1,)),
    (E.adjust_saturation_with_gray_subtraction, (0.1,)),
    (E.adjust_sigmoid, ()),
    (E.equalize, ()),
    (E.equalize3d, ()),
    (E.equalize_clahe, ()),
    (E.jpeg_codec_differentiable, (50.0,)),
    (E.posterize, (3,)),
    (E.sharpness, (0.1,)),
    (E.shift_rgb, (0.1, 0.1, 0.1)),
    (E.solarize, ()),
]


@pytest.mark.parametrize("function, arguments", ADJUST, ids=[f.__name__ for f, _ in ADJUST])
def test_refuses_other_shapes(function, arguments):
    for wrong in ([1.0], (X * 255).int(), X.cfloat()):
        with pytest.raises(TypeCheckError, match=f"^{function.__name__}: expected (image|input) to be"):
            function(wrong, *arguments)
    with pytest.raises((ShapeError, K.core.exceptions.ImageError), match=f"^{function.__name__}: expected"):
        function(torch.tensor(0.5), *arguments)


OF_BYTES = [case for case in ADJUST if not case[0].__name__.endswith(("_raw", "_differentiable"))]


@pytest.mark.parametrize("size", [(9, 40), (35, 61)], ids=str)  # large enough for a table of all bytes, and not
@pytest.mark.parametrize("function, arguments", OF_BYTES, ids=[f.__name__ for f, _ in OF_BYTES])
def test_bytes_are_255ths(function, arguments, size, device):
    """uint8 gives what the same image in [0, 1] gives, rounded; either way at halves of levels, which float32 may miss."""
    x = torch.randint(0, 256, (2, 3, *size), dtype=torch.uint8, device=device)
    y = function(x, *arguments)
    assert y.dtype == torch.uint8 and y.shape == x.shape
    exact = x.double() / torch.full((), 255.0, dtype=torch.float64, device=device)  # CUDA multiplies by 1 / 255
    assert (y - 255 * function(exact, *arguments)).abs().max() < 0.501
    slices = function(x.contiguous(memory_format=torch.channels_last)[..., 1:], *arguments)
    # CUDA computes bytes in float32, where kernels for another layout may round halves of levels the other way.
    apart = (slices.int() - function(x[..., 1:].clone(), *arguments).int()).abs().max()
    assert apart <= (1 if device.type == "cuda" else 0)


ONE_FACTOR = [case for case in ADJUST if case[1] == (0.1,)]


@pytest.mark.parametrize("function, arguments", ONE_FACTOR, ids=[f.__name__ for f, _ in ONE_FACTOR])
def test_refuses_wrong_parameters(function, arguments):
    with pytest.raises(TypeCheckError, match="to be a number, got '1'"):
        function(X, "1")
    with pytest.raises(ShapeError, match=r"got \(3,\)"):
        function(X, torch.rand(3))
    with pytest.raises(ShapeError, match=r"got \(2, 3, 4, 4, 1\)"):
        function(X, torch.rand(2, 3, 4, 4, 1))
    with pytest.raises(DeviceError):
        function(X, torch.rand(2, device="meta"))


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda: E.adjust_contrast(X, -0.1), ValueCheckError, "at least 0, got -0.1"),
        (lambda: E.adjust_gamma(X, -0.1), ValueCheckError, "adjust_gamma: expected gamma"),
        (lambda: E.adjust_gamma(X, 1.0, -1.0), ValueCheckError, "adjust_gamma: expected gain"),
        (lambda: E.adjust_hue(X[:, :2], 0.1), K.core.exceptions.ImageError, r"\(\*, 3, H, W\), got \(2, 2, 4, 4\)"),
        (lambda: E.adjust_hue(X, torch.rand(2, 3)), ShapeError, "one factor for all channels"),
        (lambda: E.solarize(X, 0.5, 0.6), ValueCheckError, r"additions in \[-0.5, 0.5\], got 0.6"),
        (lambda: E.posterize(X, 9), ValueCheckError, "bits of 0 to 8, got 9"),
        (lambda: E.posterize(X, 0.5), TypeCheckError, "bits to be an int or a Tensor, got 0.5"),
        (lambda: E.equalize_clahe(X, "2"), TypeCheckError, "clip_limit to be a number"),
        (lambda: E.equalize_clahe(X, 2.0, (0, 2)), ValueCheckError, "grid_size"),
        (lambda: E.equalize_clahe(X, 2.0, 8), TypeCheckError, r"grid_size to be \(y, x\), got 8"),
        (lambda: E.jpeg_codec_differentiable(X, 101.0), ValueCheckError, r"jpeg_quality in \[0, 100\], got 101.0"),
        (lambda: E.jpeg_codec_differentiable(X, torch.rand(3)), ShapeError, r"jpeg_quality of shape \(B,\) for B = 2"),
        (lambda: E.jpeg_codec_differentiable(X, 9.0, torch.rand(8)), ShapeError, r"table_y of shape \(B, 8, 8,?\)"),
        (lambda: E.shift_rgb(X, torch.rand(2, 3), 0.0, 0.0), ShapeError, r"r_shift of shape \(B,\), got \(2, 3\)"),
        (lambda: E.normalize(X, torch.rand(2), 1.0), ShapeError, r"normalize: expected mean .* got \(2,\)"),
        (lambda: E.denormalize(X, 0.0, torch.rand(3, 3)), ShapeError, r"denormalize: expected std .* got \(3, 3\)"),
        (lambda: E.normalize([1.0], 0.0, 1.0), TypeCheckError, "normalize: expected data to be a Tensor, got list"),
        (lambda: E.normalize_min_max(X[0, 0, 0]), ShapeError, r"\(\*, H, W\)"),
        (lambda: E.normalize_min_max(X, "0"), TypeCheckError, "min_val"),
        (lambda: E.add_weighted(X, 1.0, X[:1], 1.0, 0.0), ShapeError, "src2 of the shape of src1"),
        (lambda: E.add_weighted(X, torch.rand(3), X, 1.0, 0.0), ShapeError, "alpha to broadcast"),
        (lambda: E.invert(X, "1"), TypeCheckError, "max_val"),
        (lambda: E.histogram(X, X, 0.1), ShapeError, r"x of shape \(B, D\)"),
        (lambda: E.histogram(X[0, 0], X, torch.rand(())), ShapeError, r"bins of shape \(K,\)"),
        (lambda: E.histogram2d(X[0, 0], X[0, 0, :2], X[0, 0, 0], 0.1), ShapeError, r"x2 of shape \(4, 4\)"),
        (lambda: E.image_histogram2d(X[None]), ShapeError, "image_histogram2d: expected image"),
        (lambda: E.image_histogram2d(X, 1.0, 1.0), ValueCheckError, "max above min"),
        (lambda: E.image_histogram2d(X, bandwidth=0.0), ValueCheckError, "bandwidth above 0"),
        (lambda: E.image_histogram2d(X, kernel="box"), ValueCheckError, "kernel must be one of triangular"),
        (lambda: E.integral_image(X[0, 0, 0]), ShapeError, r"\(\*, H, W\)"),
        (lambda: E.integral_tensor(X, (0, -4)), ValueCheckError, "different axes of 4"),
        (lambda: E.integral_tensor(X, (4,)), ValueCheckError, "different axes of 4"),
        (lambda: E.integral_tensor(X, 1), TypeCheckError, "tuple of ints"),
        (lambda: E.threshold(X, 0.5, 1.0, 8), NotImplementedError, "otsu_threshold"),
        (lambda: E.threshold(X, 0.5, 1.0, 5), ValueCheckError, "type must be one of 0, 1, 2, 3, 4"),
        (lambda: E.threshold(X, None), TypeCheckError, "thresh to be a number"),
        (lambda: E.Rescale(torch.rand(2)), TypeCheckError, "factor without axes"),
        (lambda: E.Rescale("2"), TypeCheckError, "factor to be a number"),
        (lambda: E.Normalize(("1",), 1.0), TypeCheckError, "mean to hold numbers"),
        (lambda: E.zca_mean(X, 4), IndexError, "dim to be an axis of 4, got 4"),
        (lambda: E.zca_mean(X[:1]), ShapeError, "at least 2 samples"),
        (lambda: E.zca_mean(X, 0.5), TypeCheckError, "dim to be an int"),
        (lambda: E.linear_transform(X, torch.eye(3), X[:1, 0, 0]), ShapeError, "transform_matrix of shape"),
        (lambda: E.ZCAWhitening()(X), RuntimeError, "call fit first"),
        (lambda: E.ZCAWhitening().fit(X).inverse_transform(X), RuntimeError, "compute_inv"),
    ],
)
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
