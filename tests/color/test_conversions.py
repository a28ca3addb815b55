"""Tests of every color conversion: Kornia's values, gradients of any order, leading axes, types, layouts, errors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.core.exceptions import BaseError, ImageError, ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close

C = K.color


@dataclass(frozen=True)
class Case:
    of_rgb: Callable[[Tensor], Tensor] = lambda x: x  # its input, from RGB colors
    arguments: tuple[Any, ...] = ()
    module: type[torch.nn.Module] | None = None
    in_forward: bool = False  # the module takes the arguments in forward
    channels: int = 3
    integers: bool = True  # takes all of them


def alpha(x: Tensor) -> Tensor:
    return torch.cat([x, 0.5 * x[..., :1, :, :] + 0.25], -3)


def luma_only(x: Tensor) -> Tensor:
    return x[..., :1, :, :]


CASES = {
    "rgb_to_grayscale": Case(module=C.RgbToGrayscale, integers=False),
    "bgr_to_grayscale": Case(module=C.BgrToGrayscale, integers=False),
    "grayscale_to_rgb": Case(luma_only, module=C.GrayscaleToRgb, channels=1),
    "bgr_to_rgb": Case(module=C.BgrToRgb),
    "rgb_to_bgr": Case(module=C.RgbToBgr),
    "rgb_to_rgba": Case(arguments=(0.25,), module=C.RgbToRgba),
    "bgr_to_rgba": Case(arguments=(0.25,), module=C.BgrToRgba),
    "rgba_to_rgb": Case(alpha, module=C.RgbaToRgb, channels=4),
    "rgba_to_bgr": Case(alpha, module=C.RgbaToBgr, channels=4),
    "rgb_to_hsv": Case(arguments=(1e-6,), module=C.RgbToHsv),
    "hsv_to_rgb": Case(C.rgb_to_hsv, module=C.HsvToRgb),
    "rgb_to_hls": Case(module=C.RgbToHls),
    "hls_to_rgb": Case(C.rgb_to_hls, module=C.HlsToRgb),
    "rgb_to_xyz": Case(module=C.RgbToXyz),
    "xyz_to_rgb": Case(C.rgb_to_xyz, module=C.XyzToRgb),
    "rgb_to_ycbcr": Case(module=C.RgbToYcbcr),
    "ycbcr_to_rgb": Case(C.rgb_to_ycbcr, module=C.YcbcrToRgb),
    "rgb_to_y": Case(),
    "rgb_to_yuv": Case(module=C.RgbToYuv),
    "yuv_to_rgb": Case(C.rgb_to_yuv, module=C.YuvToRgb),
    "rgb_to_linear_rgb": Case(module=C.RgbToLinearRgb),
    "linear_rgb_to_rgb": Case(C.rgb_to_linear_rgb, module=C.LinearRgbToRgb),
    "rgb_to_luv": Case(module=C.RgbToLuv),
    "luv_to_rgb": Case(C.rgb_to_luv, module=C.LuvToRgb),
    "rgb_to_lab": Case(module=C.RgbToLab),
    "lab_to_rgb": Case(C.rgb_to_lab, arguments=(False,), module=C.LabToRgb, in_forward=True),
    "rgb_to_rgb255": Case(module=C.RgbToRgb255),
    "rgb255_to_rgb": Case(C.rgb_to_rgb255, module=C.Rgb255ToRgb),
    "rgb255_to_normals": Case(C.rgb_to_rgb255, module=C.Rgb255ToNormals),
    "normals_to_rgb255": Case(lambda x: 2 * x - 1, module=C.NormalsToRgb255),
    "sepia": Case(arguments=(True, 1e-5), module=C.Sepia),
}


@pytest.fixture(params=CASES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def case(name: str) -> Case:
    return CASES[name]


@pytest.fixture
def convert(name: str, case: Case) -> Callable[[Tensor], Tensor]:
    return lambda x: getattr(C, name)(x, *case.arguments)


def lattice(steps: int = 17) -> Tensor:
    """Every color of `steps` even levels a channel, black, white, grays and primaries among them: (1, 3, H, W)."""
    levels = torch.linspace(0, 1, steps, dtype=torch.float64)
    return torch.cartesian_prod(levels, levels, levels).T.reshape(1, 3, steps * steps, steps)


def colors(shape: tuple[int, ...], device: Any, dtype: torch.dtype = torch.float64) -> Tensor:
    """RGB colors with at least 0.05 between their channels and from the ends of the range: away from all kinks."""
    *leading, c, h, w = shape
    steps = torch.rand(*leading, h, w, c + 1, dtype=torch.float64) + 0.4
    ordered = (steps.cumsum(-1) / steps.sum(-1, keepdim=True))[..., :-1]
    mixed = ordered.gather(-1, torch.rand(ordered.shape).argsort(-1))
    return mixed.movedim(-1, -3).to(dtype).to(device)


# --------------------------------------------------------------------------------------------------------------- values


def test_every_function_is_tested_here_or_in_its_own_file():
    elsewhere = {"apply_colormap", "rgb_to_raw", "raw_to_rgb", "raw_to_rgb_2x2_downscaled"}
    elsewhere |= {"frames_to_rgb", "resize_frames", "rgb_to_frames", "warp_frames"}
    elsewhere |= {f"{a}_to_{b}" for a, b in itertools.permutations(("rgb", "yuv420", "yuv422"), 2) if "rgb" in (a, b)}
    functions = {name for name, value in vars(C).items() if hasattr(value, "__annotations__") and name.islower()}
    public = {name for name in functions if callable(getattr(C, name))}
    assert public - elsewhere == set(CASES)


OUTSIDE = 2 * torch.rand(2, 3, 31, 33, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 0.5


@pytest.mark.parametrize("rgb", [lattice(), OUTSIDE], ids=["in", "out"])
def test_values_are_kornias(name, case, convert, rgb, device):
    kornia = pytest.importorskip("kornia")
    x = case.of_rgb(rgb)
    expected = getattr(kornia.color, name)(x, *case.arguments)
    torch.testing.assert_close(convert(x.to(device)).cpu(), expected, rtol=1e-6, atol=1e-8, equal_nan=True)
    torch.testing.assert_close(
        convert(x.float().to(device)).cpu(), expected.float(), rtol=2e-3, atol=2e-3, equal_nan=True
    )


# The largest error of a channel there and back, in float64 and float32.
ROUND_TRIPS = [
    ("rgb_to_hsv", "hsv_to_rgb", 1e-7, 1e-6),  # 1e-7: eps
    ("rgb_to_hls", "hls_to_rgb", 1e-7, 1e-6),
    ("rgb_to_xyz", "xyz_to_rgb", 1e-14, 2e-6),
    ("rgb_to_ycbcr", "ycbcr_to_rgb", 1e-14, 1e-6),
    ("rgb_to_yuv", "yuv_to_rgb", 1e-14, 1e-6),
    ("rgb_to_linear_rgb", "linear_rgb_to_rgb", 1e-7, 1e-6),  # 1e-7: the standard's rounded numbers
    ("rgb_to_lab", "lab_to_rgb", 2e-4, 2e-4),  # the line's rounded numbers
    ("rgb_to_luv", "luv_to_rgb", 1e-4, 1e-4),
    ("rgb_to_rgb255", "rgb255_to_rgb", 1e-15, 1e-7),
    ("rgb_to_bgr", "bgr_to_rgb", 0, 0),
]


@pytest.mark.parametrize("forward, inverse, wide, narrow", ROUND_TRIPS)
def test_round_trips(forward, inverse, wide, narrow, device):
    for dtype, limit in ((torch.float64, wide), (torch.float32, narrow)):
        x = lattice().to(dtype).to(device)
        error = (getattr(C, inverse)(getattr(C, forward)(x)) - x).abs().max()
        assert error <= limit


# ------------------------------------------------------------------------------------------------------------ gradients


@pytest.mark.derivatives
def test_derivatives(case, convert, device):
    x = case.of_rgb(colors((1, 3, 2, 2), device)).requires_grad_()
    assert torch.autograd.gradcheck(convert, x, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(convert, x)


def test_gradients_are_finite_on_the_rgb_cube(case, convert, device):
    """Black, white, grays and primaries included."""
    for dtype in (torch.float32, torch.float16, torch.bfloat16):
        x = case.of_rgb(lattice(9).float()).to(dtype).to(device).requires_grad_()
        y = convert(x)
        assert y.isfinite().all(), dtype
        (gradient,) = torch.autograd.grad(y.sum(), x)
        assert gradient.isfinite().all(), dtype


# --------------------------------------------------------------------------------------------------------------- shapes


def test_leading_axes(case, convert, device):
    x = case.of_rgb(colors((2, 2, 3, 4, 5), device))
    y = convert(x)
    assert y.shape[:2] == (2, 2) and y.shape[-2:] == (4, 5)
    for i in range(2):
        assert_close(convert(x[i]), y[i])
        assert_close(convert(x[i, 0]), y[i, 0])


def test_no_images_and_no_pixels(name, case, convert, device):
    for shape in [(0, 3, 4, 5), (2, 0, 3, 4, 5), (2, 3, 0, 5), (3, 4, 0)]:
        if name == "sepia" and 0 in shape[-2:]:
            continue  # needs an image's maximum
        x = case.of_rgb(torch.rand(shape, device=device)).requires_grad_()
        y = convert(x)
        assert y.numel() == 0 and y.shape[:-3] == shape[:-3] and y.shape[-2:] == shape[-2:]
        y.sum().backward()


def test_transforms(case, convert, device):
    x = case.of_rgb(colors((3, 2, 3, 4, 5), device))
    assert_close(torch.func.vmap(convert)(x), torch.stack([convert(image) for image in x]))

    def loss(image: Tensor) -> Tensor:
        return convert(image).square().sum()

    leaf = x[0].clone().requires_grad_()
    assert_close(torch.func.grad(loss)(x[0]), torch.autograd.grad(loss(leaf), leaf)[0])


def test_layouts(case, convert, device):
    x = case.of_rgb(colors((2, 3, 4, 5), device))
    expected = convert(x)
    assert_close(convert(x.repeat_interleave(2, -1)[..., ::2]), expected)
    assert_close(convert(x.contiguous(memory_format=torch.channels_last)), expected)


@pytest.mark.tracing
@pytest.mark.parametrize("name", ["rgb_to_hsv", "rgb_to_lab", "rgba_to_rgb"])
def test_compiles_with_dynamic_batch(case, convert, device):
    torch._dynamo.reset()
    compiled = torch.compile(convert, fullgraph=True, backend="aot_eager")
    for batch in (2, 3):
        x = case.of_rgb(colors((batch, 3, 4, 5), device))
        torch._dynamo.mark_dynamic(x, 0)
        leaves = [x.clone().requires_grad_() for _ in range(2)]
        results = [f(leaf) for f, leaf in zip((compiled, convert), leaves)]
        assert_close(*results)
        assert_close(*(torch.autograd.grad(y.square().sum(), leaf)[0] for y, leaf in zip(results, leaves)))


# ---------------------------------------------------------------------------------------------------------------- types


def test_half_types_are_computed_in_float32(case, convert, device):
    x = case.of_rgb(colors((2, 3, 4, 5), device))
    for dtype in (torch.float16, torch.bfloat16):
        stored = x.to(dtype)
        assert_close(convert(stored), convert(stored.float()).to(dtype))
    expected = convert(x.float())
    with torch.autocast(device.type, dtype=torch.bfloat16):
        assert torch.equal(convert(x.float()), expected)


MOVED = {"grayscale_to_rgb", "bgr_to_rgb", "rgb_to_bgr", "rgb_to_rgba", "bgr_to_rgba"}  # no arithmetic


# Their bytes are 255ths or codes.
UNITS = {"rgb_to_linear_rgb", "linear_rgb_to_rgb"} | {
    name for space in ("hsv", "hls", "lab", "luv", "xyz", "ycbcr") for name in (f"rgb_to_{space}", f"{space}_to_rgb")
}


def test_integers(name, case, convert, device):
    for dtype in (torch.uint8, torch.int64, torch.bool):
        x = torch.randint(0, 2, (2, case.channels, 4, 5), device=device).to(dtype)
        if name in MOVED:
            assert convert(x).dtype == dtype
        elif dtype == torch.uint8 and name in UNITS:
            pass  # test_codes.py
        elif case.integers:
            assert_close(convert(x), convert(x.float()))
        elif dtype != torch.uint8:
            message = f"^{name}: expected image to be (uint8 or )?floating point, got {dtype}"
            with pytest.raises(TypeCheckError, match=message):
                convert(x)


def test_nan_stays_in_its_pixel(name, case, convert, device):
    x = case.of_rgb(colors((1, 3, 4, 5), device))
    spoiled = x.clone()
    spoiled[0, 0, 1, 2] = math.nan
    y, clean = convert(spoiled), convert(x)
    assert y[0, :, 1, 2].isnan().any()
    if name != "sepia":  # which divides by the image's maximum
        y[0, :, 1, 2] = clean[0, :, 1, 2]
        assert_close(y, clean)


def test_input_is_not_modified(case, convert, device):
    x = case.of_rgb(colors((2, 3, 4, 5), device))
    before, version = x.clone(), x._version
    convert(x).add_(1)
    assert torch.equal(x, before) and x._version == version


def test_modules(name, case, convert, device):
    if case.module is None:
        pytest.skip("no module form")
    x = case.of_rgb(colors((2, 3, 4, 5), device))
    module = case.module(*(() if case.in_forward else case.arguments))
    assert_close(module(x, *(case.arguments if case.in_forward else ())), convert(x))
    assert case.module.__name__ in repr(module) and not module.state_dict()


# --------------------------------------------------------------------------------------------------------------- errors


def test_wrong_kinds(name, case, convert, device):
    argument = "input" if name == "sepia" else "image"
    of_shape = ImageError if "255" in name else ShapeError
    x = torch.rand(2, case.channels, 4, 5, device=device)
    for wrong, error, text in [
        (None, TypeCheckError, "to be a Tensor, got NoneType"),
        ([[1.0]], TypeCheckError, "to be a Tensor, got list"),
        (x.to(torch.complex64), TypeCheckError, "to be real, got torch.complex64"),
        (x[0, 0], of_shape, rf"of shape \(\*, {case.channels}, H, W\), got \(4, 5\)"),
        (x[:, :0], of_shape, rf"of shape \(\*, {case.channels}, H, W\), got \(2, 0, 4, 5\)"),
        (torch.cat([x, x], 1), of_shape, rf"of shape \(\*, {case.channels}, H, W\), got"),
    ]:
        with pytest.raises(error, match=f"^{name}: expected {argument} {text}"):
            convert(wrong)


@pytest.mark.parametrize(
    "call, error, text",
    [
        (lambda x: C.rgb_to_hsv(x, -1.0), ValueCheckError, "rgb_to_hsv: expected eps"),
        (lambda x: C.rgb_to_hls(x, math.nan), ValueCheckError, "rgb_to_hls: expected eps"),
        (lambda x: C.rgb_to_luv(x, "0"), TypeCheckError, "rgb_to_luv: expected eps"),
        (lambda x: C.luv_to_rgb(x, -1.0), ValueCheckError, "luv_to_rgb: expected eps"),
        (lambda x: C.lab_to_rgb(x, 1), TypeCheckError, "lab_to_rgb: expected clip"),
        (lambda x: C.sepia(x, 1), TypeCheckError, "sepia: expected rescale"),
        (lambda x: C.sepia(x, True, -1), ValueCheckError, "sepia: expected eps"),
        (lambda x: C.sepia(x[..., :0]), ShapeError, "sepia: expected input with H, W of at least 1"),
        (lambda x: C.rgb_to_grayscale(x, [1, 1, 1]), TypeCheckError, "rgb_to_grayscale: expected rgb_weights"),
        (lambda x: C.rgb_to_grayscale(x, torch.ones(4)), ShapeError, "rgb_to_grayscale: expected rgb_weights"),
        (lambda x: C.rgb_to_rgba(x, 1), TypeCheckError, "rgb_to_rgba: expected alpha_val"),
        (lambda x: C.bgr_to_rgba(x, x), ShapeError, "bgr_to_rgba: expected alpha_val"),
        (lambda x: C.rgba_to_rgb(alpha(x), (1, 1)), ValueCheckError, "rgba_to_rgb: expected background_color"),
        (lambda x: C.rgba_to_rgb(alpha(x), 1.0), TypeCheckError, "rgba_to_rgb: expected background_color"),
        (lambda x: C.rgba_to_rgb(alpha(x), torch.ones(3)), ShapeError, "rgba_to_rgb: expected background_color"),
        (lambda x: C.rgba_to_rgb(alpha(x), x[..., :2, :]), ShapeError, "rgba_to_rgb: expected background_color"),
        (lambda x: C.rgba_to_rgb(alpha(x), x[None]), ShapeError, "rgba_to_rgb: expected background_color"),
    ],
)
def test_wrong_arguments(call, error, text, device):
    with pytest.raises(error, match=f"^{text}") as caught:
        call(torch.rand(2, 3, 4, 5, device=device))
    assert isinstance(caught.value, BaseError)
