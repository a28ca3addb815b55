"""Conversions that are color programs: everything the shared suite asks of an operator."""

from __future__ import annotations

import math

import pytest
import torch

import kvision as K
from kvision import _backend
from kvision.color import program
from kvision.color.program import arguments, run
from kvision.color.steps import STEPS
from op_tests import OpTests

C = K.color


class ConversionTests(OpTests):
    operators = ("color_program", "color_program_backward")
    channels = 3
    small = (1, 3, 3, 4)
    max_size = 12  # a pixel knows no neighbors: what matters is how many there are
    # Of a hue or a root, half types keep the digits of the number it is taken from.
    tolerances = {torch.float16: (4e-3, 4e-3), torch.bfloat16: (3e-2, 3e-2)}
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)  # of the channels that are converted
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def input(self, shape, dtype, device):
        """Colors away from grays and from ties of their channels, where gradients jump."""
        x = torch.rand(shape, dtype=torch.float64)
        if len(shape) > 3 and shape[-3] == 3 and self.scale == (1.0, 1.0, 1.0):
            x = 0.05 + 0.3 * x + torch.tensor([0.3, 0.0, 0.6], dtype=torch.float64)[:, None, None]
        elif len(shape) > 3 and shape[-3] == 3:
            scale, shift = (torch.tensor(v, dtype=torch.float64)[:, None, None] for v in (self.scale, self.shift))
            x = (0.05 + 0.9 * x) * scale + shift
        return x.to(dtype).to(device)

    def test_value_of_bytes(self, variant, device, backend):
        """test_codes.py has those of conversions between RGB and other spaces."""
        if self.bytes or self.function.__name__ in ("rgb_to_grayscale", "bgr_to_grayscale"):
            super().test_value_of_bytes(variant, device, backend)

    def test_wrong_kinds(self, variant, device):
        """Of colors any number of leading axes is right, and no pixels are, too."""
        x, kwargs = self.setup(variant, device, torch.float32)
        name = self.function.__name__
        for wrong, error in [([[1.0]], TypeError), (None, TypeError), (x[0, 0], ValueError), (x[:, :2], ValueError)]:
            with pytest.raises(error, match=f"^{name}: ") as caught:
                self.call(wrong, kwargs)
            assert isinstance(caught.value, K.core.exceptions.BaseError)
        assert self.call(x[..., :0], kwargs).shape[-1] == 0


class TestRgbToHsv(ConversionTests):
    function = staticmethod(C.rgb_to_hsv)
    module = C.RgbToHsv


class TestHsvToRgb(ConversionTests):
    function = staticmethod(C.hsv_to_rgb)
    module = C.HsvToRgb
    scale = (math.pi / 3, 1.0, 1.0)  # one sector of the wheel


class TestRgbToHls(ConversionTests):
    function = staticmethod(C.rgb_to_hls)
    module = C.RgbToHls


class TestHlsToRgb(ConversionTests):
    function = staticmethod(C.hls_to_rgb)
    module = C.HlsToRgb
    scale = (math.pi / 3, 0.5, 1.0)


class TestRgbToXyz(ConversionTests):
    function = staticmethod(C.rgb_to_xyz)
    module = C.RgbToXyz


class TestYcbcrToRgb(ConversionTests):
    function = staticmethod(C.ycbcr_to_rgb)
    module = C.YcbcrToRgb
    scale = (0.5, 0.1, 0.1)
    shift = (0.25, 0.45, 0.45)


class TestRgbToLab(ConversionTests):
    function = staticmethod(C.rgb_to_lab)
    module = C.RgbToLab
    tolerances = {
        **ConversionTests.tolerances,
        torch.float32: (1e-4, 1e-4),
        torch.float16: (4e-3, 0.1),
        torch.bfloat16: (3e-2, 1.0),
    }


class TestLabToRgb(ConversionTests):
    function = staticmethod(C.lab_to_rgb)  # its module takes `clip` when called
    variants = [{}, {"clip": False}]
    scale = (40.0, 20.0, 20.0)
    shift = (40.0, -10.0, -10.0)
    tolerances = {**ConversionTests.tolerances, torch.float32: (1e-4, 1e-5)}


class TestRgbToLuv(ConversionTests):
    function = staticmethod(C.rgb_to_luv)
    module = C.RgbToLuv
    tolerances = TestRgbToLab.tolerances


class TestLuvToRgb(ConversionTests):
    function = staticmethod(C.luv_to_rgb)
    module = C.LuvToRgb
    scale = (40.0, 20.0, 20.0)
    shift = (40.0, -10.0, -10.0)
    tolerances = TestLabToRgb.tolerances


class TestRgbToLinearRgb(ConversionTests):
    function = staticmethod(C.rgb_to_linear_rgb)
    module = C.RgbToLinearRgb


class TestRgbToGrayscale(ConversionTests):
    function = staticmethod(C.rgb_to_grayscale)
    module = C.RgbToGrayscale
    bytes = True

    def test_other_integers_become_float32(self, variant, device):
        with pytest.raises(TypeError, match="rgb_to_grayscale: "):
            self.call(self.input(self.shape, torch.uint8, device).int(), {})


@pytest.mark.parametrize(
    "plan, parameters",
    [
        ([-1, -1, 1, 99], []),
        ([-1, -1, 1, -1], []),
        ([-1, -1, 1, 0], [1.0]),
        ([-1, -1, 2, 13, 1], [1.0] * 4),
        ([-1, -1, 1, 5, 0], []),
        ([-1, -1, 2, 5], []),
        ([-1, -1, -1], []),
        ([-1, -1, 2**62], []),
        ([5, -1, 1, 5], []),
        ([-1, 2, 1, 5], []),
        ([-1], []),
    ],
    ids=str,
)
def test_invalid_program_is_refused(plan, parameters):
    if "cpu" in _backend.unserved:
        pytest.skip("the operators are declared by libkvision.so")
    with pytest.raises(RuntimeError, match="color_program: "):
        torch.ops.kvision.color_program(torch.rand(1, 3, 4, 4), *[None] * 7, plan, parameters)


@pytest.mark.parametrize(
    "weights",
    [
        (9798.0, 19235.0, 3735.0),
        (32767.0, 32767.0, -32768.0),
        (32768.0, 0.0, 0.0),
        (-40000.0, 0.0, 60000.0),
        (9798.5, 19234.75, 3735.75),
    ],
    ids=str,
)
@pytest.mark.parametrize("channels_last", [False, True])
def test_luma_of_bytes_takes_any_weights(weights, channels_last, device):
    """The kernels that multiply integers of 16 bits leave other weights to those of floating-point numbers."""
    x = torch.randint(0, 256, (2, 3, 24, 37), dtype=torch.uint8, device=device)
    if channels_last:
        x = x.to(memory_format=torch.channels_last)
    y = run(x, [STEPS["luma_u8_fixed_point"].number], arguments(weights))
    exact = sum(w * x[:, k : k + 1].double() for k, w in enumerate(weights))
    expected = ((exact + 16384) / 32768).floor().clamp(0, 255).to(torch.uint8)
    assert torch.equal(y, expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.uint8], ids=str)
def test_fast_path_of_steps_with_numbers(dtype, device, backend):
    """Calls without gradient take the kernel with fewer arguments; results equal those of the operator."""
    if backend == "reference" or device.type in _backend.unserved:
        pytest.skip("this test is about the kernels")
    x = torch.rand(2, 3, 5, 7, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    x = (x * 255).to(device, dtype) if dtype == torch.uint8 else x.to(device, dtype)
    serves = program._program_of_numbers.serves
    assert serves(x) and not serves(x[:0]) and not serves(torch.nn.Parameter(x, requires_grad=False))
    for call in (
        lambda x: K.enhance.adjust_gamma(x, 0.7, 1.1),
        lambda x: K.enhance.adjust_contrast_with_mean_subtraction(x, 1.3),
        lambda x: K.enhance.adjust_hue(x, 0.4),
    ):
        y = call(x)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(program._program_of_numbers, "_on_cpu", frozenset())
            patch.setattr(program._program_of_numbers, "_on_cuda", frozenset())
            assert not serves(x) and torch.equal(call(x), y)
        with K.backend("reference"):
            assert not serves(x)
        if dtype != torch.uint8:
            leaf = x.clone().requires_grad_()
            assert not serves(leaf) and call(leaf).requires_grad
