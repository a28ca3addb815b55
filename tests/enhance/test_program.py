"""ColorProgram against its functions one after the other, and adjustments as operators of their own."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.core.exceptions import DeviceError, ImageError, ShapeError, TypeCheckError, ValueCheckError
from op_tests import OpTests, assert_close

E = K.enhance
MEAN, STD = (0.4, 0.5, 0.6), (0.2, 0.25, 0.3)
JITTER = (("brightness", 1.2), ("contrast", 0.7), ("saturation", 1.4), ("hue", 0.3), ("normalize", MEAN, STD))


def column(values: tuple[float, ...], x: Tensor) -> Tensor:
    return torch.tensor(values, dtype=x.dtype, device=x.device)


FUNCTIONS = {
    "brightness": E.adjust_brightness_accumulative,
    "shift": E.adjust_brightness,
    "contrast": E.adjust_contrast_with_mean_subtraction,
    "saturation": E.adjust_saturation_with_gray_subtraction,
    "hue": E.adjust_hue,
    "gamma": E.adjust_gamma,
    "solarize": E.solarize,
    "posterize": E.posterize,
    "invert": E.invert,
    "normalize": lambda x, m, s: E.normalize(x, *(column(v, x) if isinstance(v, tuple) else v for v in (m, s))),
    "denormalize": lambda x, m, s: E.denormalize(x, *(column(v, x) if isinstance(v, tuple) else v for v in (m, s))),
}


def one_after_the_other(x: Tensor, steps: tuple) -> Tensor:
    for name, *values in steps:
        x = FUNCTIONS[name](x, *values)
    return x


def colors(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Away from grays and ties, where gradients jump, and so far inside [0, 1] that nothing is clamped below."""
    x = 0.1 * torch.rand(shape, dtype=torch.float64)
    if shape[-3] == 3:
        x = x + torch.tensor([0.5, 0.3, 0.4], dtype=torch.float64)[:, None, None]
    return x.to(dtype).to(device)


@pytest.fixture
def image(device) -> Tensor:
    return torch.rand(4, 3, 20, 31, device=device)


class ProgramTests(OpTests):
    mixed = ("input", "p0", "p1", "p2")
    channels = 3
    shape = (2, 3, 9, 14)
    small = (2, 3, 2, 3)
    max_size = 8  # a pixel knows no neighbors: what matters is how many there are
    tolerances = {torch.float16: (4e-3, 4e-3), torch.bfloat16: (3e-2, 3e-2), torch.float32: (5e-5, 5e-6)}

    def input(self, shape, dtype, device):
        return super().input(shape, dtype, device) if dtype == torch.uint8 else colors(shape, dtype, device)

    def test_wrong_kinds(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        for wrong in ([[1.0]], None, x.cfloat()):
            with pytest.raises(TypeCheckError):
                self.call(wrong, kwargs)


def color_jitter(input: Tensor, factor: Tensor | float = 0.8, mean: Tensor | None = None) -> Tensor:
    changed = {} if mean is None else {"normalize": (mean, STD)}
    return E.ColorProgram(*JITTER)(input, {"brightness": factor, **changed})


class TestColorJitter(ProgramTests):
    """Numbers and tensors, a mean, and a normalization with tensors for three channels."""

    function = staticmethod(color_jitter)
    operators = ("color_program_around_mean", "color_program_backward")
    variants = [{}, {"factor": lambda x: torch.rand(x.shape[0]) + 0.5, "mean": lambda x: torch.rand(1, 3)}]
    bytes = True
    # Of the smallest mean of a sample, whatever it is of its pixels.
    test_nan_stays_in_its_window = None

    def test_other_integers_become_float32(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        with pytest.raises(TypeCheckError):
            self.call(x.int(), kwargs)

    def check(self, actual, expected):
        if actual.dtype == torch.uint8:  # a level may round to its neighbor
            actual, expected = (t.to(torch.int16).clamp(1, 254) for t in (actual, expected))
            assert (actual - expected).abs().max() <= 1 if actual.numel() else True
            return
        super().check(actual, expected)


class AdjustmentTests(ProgramTests):
    operators = ("color_program", "color_program_backward")
    bytes = True
    # A product just above or below a half of a level.
    tolerances = {**ProgramTests.tolerances, torch.uint8: (0, 1)}

    def test_other_integers_become_float32(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        with pytest.raises(TypeCheckError):
            self.call(x.int(), kwargs)


class TestAdjustHue(AdjustmentTests):
    function = staticmethod(E.adjust_hue)
    variants = [{"factor": 0.4}, {"factor": lambda x: 0.2 * torch.rand(x.shape[0]) + 0.1}]


class TestAdjustSaturation(AdjustmentTests):
    function = staticmethod(E.adjust_saturation)
    variants = [{"factor": 0.7}, {"factor": lambda x: 0.2 * torch.rand(x.shape[0]) + 0.4}]


class TestAdjustGamma(AdjustmentTests):
    function = staticmethod(E.adjust_gamma)
    channels = None
    variants = [
        {"gamma": 1.7, "gain": 0.9},
        {"gamma": lambda x: torch.rand(x.shape[0]) + 0.5, "gain": lambda x: 0.3 * torch.rand(x.shape[0], 1) + 0.5},
    ]


class TestNormalize(AdjustmentTests):
    """Parameters of the channels, which become planes."""

    function = staticmethod(E.normalize)
    variants = [
        {"mean": 0.3, "std": 0.5},
        {"mean": lambda x: torch.rand(1, 3), "std": lambda x: torch.rand(1, 3) + 0.5},
    ]

    bytes = False
    test_other_integers_become_float32 = OpTests.test_other_integers_become_float32


class TestAdjustContrast(AdjustmentTests):
    """Around the mean of two channels, which become one."""

    function = staticmethod(E.adjust_contrast_with_mean_subtraction)
    operators = ("color_program_around_mean", "color_program_backward")
    channels = 2
    shape = (2, 2, 9, 14)
    variants = [{"factor": 0.7}, {"factor": lambda x: 0.5 * torch.rand(x.shape[0]) + 0.5}]
    test_nan_stays_in_its_window = None
    test_layout = None  # joining channels takes a copy, which is planar


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64, torch.int64], ids=str)
def test_parameters_as_they_are(dtype, device):
    """Of any type and any strides, of some or all of images and channels, and their gradients in their types."""
    x = torch.rand(2, 3, 5, 7, device=device)
    mean = (4 * torch.rand(3, 2, device=device)).to(dtype).t()
    std = (4 * torch.rand(1, 3, device=device) + 1).to(dtype).expand(2, 3)
    expected = (x - mean.float()[..., None, None]) / std.float()[..., None, None]
    assert_close(E.normalize(x, mean, std), expected, 1e-6, 1e-6)
    if dtype.is_floating_point:
        leaf = mean.clone().requires_grad_()
        (result,) = torch.autograd.grad(E.normalize(x, leaf, std).sum(), leaf)
        assert result.dtype == dtype
        assert_close(result.float(), -35 / std.float(), 1e-2, 0)


def test_more_tensors_than_the_kernels_take(image, device):
    factors = [torch.rand(4 if i % 2 else (), device=device) + 0.5 for i in range(8)]
    program = E.ColorProgram(*(("brightness", f) for f in factors))
    product = image
    for f in factors:
        product = (product * f.reshape(-1, 1, 1, 1)).clamp(0, 1)
    assert_close(program(image), product, 1e-5, 1e-6)


# --- ColorProgram ---------------------------------------------------------------------------------------------------


PROGRAMS = [
    JITTER,
    (("shift", 0.1), ("gamma", 1.4), ("solarize", 0.6), ("invert",)),
    (("normalize", 0.5, 0.25), ("denormalize", MEAN, STD)),
    (("posterize", 5), ("contrast", 0.5), ("shift", 0.1), ("contrast", 1.5)),  # first, for its levels jump
    (("hue", torch.tensor([0.1, -2.0, 3.0, 9.0])), ("saturation", torch.tensor(0.3))),
    (),
]


def moved(steps: tuple, device: torch.device) -> tuple:
    return tuple(tuple(v.to(device) if isinstance(v, Tensor) else v for v in step) for step in steps)


@pytest.mark.parametrize("steps", PROGRAMS, ids=lambda p: "-".join(name for name, *_ in p) or "empty")
def test_is_its_functions_one_after_the_other(steps, image, device):
    steps = moved(steps, device)
    program = E.ColorProgram(*steps)
    assert_close(program(image), one_after_the_other(image, steps), 2e-5, 1e-5)
    if not steps:
        assert_close(program(image[0]), image[0])
    assert [name for name, *_ in program.steps] == [name for name, *_ in steps]


def test_order_and_switches_of_every_sample(image, device):
    steps = (("brightness", 1.2), ("contrast", 0.7), ("saturation", 1.4), ("hue", 0.3))
    order = torch.stack([torch.randperm(4) for _ in range(4)]).to(device)
    enabled = torch.rand(4, 4, device=device) > 0.3
    actual = E.ColorProgram(*steps)(image, None, order, enabled)
    for x, y, positions, on in zip(image, actual, order.tolist(), enabled.tolist()):
        assert_close(y, one_after_the_other(x, tuple(steps[i] for i in positions if on[i])), 2e-5, 1e-5)
    only = E.ColorProgram(*steps)(image, enabled=torch.tensor([False, True, False, True], device=device))
    assert_close(only, one_after_the_other(image, (steps[1], steps[3])), 2e-5, 1e-5)
    with K.backend("reference"):
        assert_close(E.ColorProgram(*steps)(image, None, order, enabled), actual, 2e-5, 1e-5)


def test_several_means_in_any_order(image, device):
    steps = (("contrast", 0.7), ("hue", 0.3), ("contrast", 1.3), ("brightness", 0.9), ("contrast", 0.5))
    order = torch.stack([torch.randperm(5) for _ in range(4)]).to(device)
    enabled = torch.rand(4, 5, device=device) > 0.3
    program, x = E.ColorProgram(*steps), image.double().requires_grad_()
    for x_of_one, y, positions, on in zip(x, program(x, None, order, enabled), order.tolist(), enabled.tolist()):
        assert_close(y, one_after_the_other(x_of_one, tuple(steps[i] for i in positions if on[i])), 2e-5, 1e-5)
    results = []
    for name in ("auto", "reference"):
        with K.backend(name):
            results.append(torch.autograd.grad(program(x, None, order, enabled).square().sum(), x)[0])
    assert_close(*results, 1e-9, 1e-9)


def test_gradients_with_order(image, device):
    order = torch.stack([torch.randperm(5) for _ in range(4)]).to(device)
    enabled = torch.rand(4, 5, device=device) > 0.3
    values = [(torch.rand(4, device=device) + 0.5).requires_grad_() for _ in range(4)]
    x = image.double().requires_grad_()

    def gradients(x: Tensor) -> tuple[Tensor, ...]:
        changed = dict(zip(("brightness", "contrast", "saturation", "hue"), values))
        y = E.ColorProgram(*JITTER)(x, changed, order, enabled)
        return torch.autograd.grad(y.square().sum(), (x, *values))

    with K.backend("reference"):
        expected = gradients(x)
    for actual in (gradients(x), gradients(image.requires_grad_())):
        for a, e in zip(actual, expected):
            scale = float(e.abs().max())
            assert_close(a.double(), e.double(), 1e-3 if a.dtype == torch.float32 else 1e-6, 1e-4 * scale)


@pytest.mark.parametrize(
    "steps",
    [
        (("hue", 0.3), ("normalize", MEAN, STD), ("invert",)),
        (("normalize", MEAN, STD), ("invert",)),
        (("denormalize", MEAN, STD), ("gamma", 1.3), ("invert",)),
        (("invert",), ("contrast", 0.7), ("normalize", MEAN, STD)),
    ],
    ids=lambda steps: "-".join(name for name, *_ in steps),
)
def test_gradients_where_steps_are_affine(steps, image, device):
    """Of these the kernels need no pixels, in whatever order they come."""
    x, order = image.double().requires_grad_(), torch.stack([torch.randperm(len(steps)) for _ in range(4)]).to(device)
    weights = torch.rand_like(x)
    for given in (None, order):
        grads = []
        for name in ("auto", "reference"):
            with K.backend(name):
                y = E.ColorProgram(*steps)(x, order=given)
                grads.append(torch.autograd.grad((y * weights).sum(), x)[0])
        assert_close(grads[0], grads[1], 1e-9, 1e-9)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.bfloat16, torch.float32], ids=str)
@pytest.mark.parametrize("memory_format", [None, torch.contiguous_format, torch.channels_last], ids=str)
def test_types_and_layouts(dtype, memory_format, image, device):
    program = E.ColorProgram(("brightness", 1.2), ("saturation", 0.7), dtype=dtype, memory_format=memory_format)
    levels = (255 * image).byte().contiguous(memory_format=torch.channels_last)
    actual = program(levels)
    assert actual.dtype == dtype and actual.is_contiguous(memory_format=memory_format or torch.channels_last)
    with K.backend("reference"):
        expected = program(levels)
    assert (actual.double() - expected.double()).abs().max() <= (1 if dtype == torch.uint8 else 2e-2)
    unit = 255 if dtype == torch.uint8 else 1
    wide = E.ColorProgram(*((name, *v) for name, *v in program.steps))(levels.double() / 255)
    assert (actual.double() / unit - wide).abs().max() <= (0.51 / 255 if dtype == torch.uint8 else 4e-3)


def test_parameters_are_learned(image, device):
    target = E.adjust_hue(image, 0.5)
    program = E.ColorProgram(("hue", torch.nn.Parameter(torch.tensor(0.0, device=device))))
    assert dict(program.named_parameters()).keys() == {"angle_0"}
    optimizer = torch.optim.Adam(program.parameters(), 0.05)
    for _ in range(40):
        optimizer.zero_grad()
        (program(image) - target).square().mean().backward()
        optimizer.step()
    assert abs(program.angle_0.item() - 0.5) < 0.1


def test_parameters_of_a_call(image, device):
    program = E.ColorProgram(("brightness", 1.0), ("contrast", 0.5), ("brightness", 0.7), ("normalize", MEAN, STD))
    changed = program(image, {0: 0.8, "contrast": 0.9, "normalize": (0.0, 1.0)})
    assert_close(
        changed, E.ColorProgram(("brightness", 0.8), ("contrast", 0.9), ("brightness", 0.7))(image), 1e-5, 1e-6
    )
    with pytest.raises(ValueCheckError, match="not one step 'brightness'"):
        program(image, {"brightness": 1.0})


@pytest.mark.tracing
def test_compiles_without_graph_breaks(image, device):
    torch._dynamo.reset()
    program = E.ColorProgram(*JITTER)
    compiled = torch.compile(program, fullgraph=True, backend="aot_eager")
    factor = torch.tensor([0.5, 1.0, 1.5, 2.0], device=device, requires_grad=True)
    order = torch.stack([torch.randperm(5) for _ in range(4)]).to(device)
    results = [f(image, {"brightness": factor}, order) for f in (program, compiled)]
    assert_close(results[1], results[0])
    grads = [torch.autograd.grad(y.square().sum(), factor)[0] for y in results]
    assert_close(grads[1], grads[0])


def test_any_leading_axes(image):
    program = E.ColorProgram(*JITTER)
    expected = program(image)
    assert_close(program(image[:, None]), expected[:, None])
    assert_close(program(image[1]), expected[1])
    assert program(image[:0]).shape == (0, 3, 20, 31)


def test_repr():
    program = E.ColorProgram(("hue", torch.zeros(2)), ("normalize", MEAN, STD), dtype=torch.float16)
    assert repr(program) == (
        "ColorProgram(hue(Tensor(2,)), normalize((0.4, 0.5, 0.6), (0.2, 0.25, 0.3)), dtype=torch.float16)"
    )
    assert program.steps[1] == ("normalize", MEAN, STD)


X = torch.rand(2, 3, 4, 4)


@pytest.mark.parametrize(
    "call, error, text",
    [
        (lambda: E.ColorProgram("hue"), TypeCheckError, "tuples of a name"),
        (lambda: E.ColorProgram(("blur", 1.0)), ValueCheckError, "step must be one of brightness"),
        (lambda: E.ColorProgram(("hue",)), ValueCheckError, "hue takes angle; got 0"),
        (lambda: E.ColorProgram(("hue", "1")), TypeCheckError, "angle of hue to be a number"),
        (lambda: E.ColorProgram(("normalize", (0.5, 0.5), 1.0)), ValueCheckError, "mean of normalize to be 3 numbers"),
        (lambda: E.ColorProgram(("hue", math.nan)), ValueCheckError, "angle of hue"),
        (lambda: E.ColorProgram(*[("invert",)] * 17), ValueCheckError, "at most 16 steps, got 17"),
        (lambda: E.ColorProgram(dtype=torch.int32), TypeCheckError, "dtype to be floating point or uint8"),
        (lambda: E.ColorProgram(memory_format=1), ValueCheckError, "memory_format must be"),
        (lambda: E.ColorProgram()(X[:, :2]), ImageError, r"\(\*, 3, H, W\)"),
        (lambda: E.ColorProgram()(X.int()), TypeCheckError, "image to be floating point or uint8"),
        (lambda: E.ColorProgram()(X[..., :0]), ShapeError, "H, W of at least 1"),
        (lambda: E.ColorProgram(("hue", 0.0))(X, {"hue": torch.rand(3)}), ShapeError, r"\(\) or \(2,\), got \(3,\)"),
        (lambda: E.ColorProgram(("hue", 0.0))(X, {"hue": torch.rand(2, device="meta")}), DeviceError, "one device"),
        (lambda: E.ColorProgram(("hue", 0.0))(X, {"tint": 1.0}), ValueCheckError, "not one step 'tint'"),
        (lambda: E.ColorProgram(("hue", 0.0))(X, [1.0]), TypeCheckError, "by the names of steps"),
        (
            lambda: E.ColorProgram(("hue", 0.0))(X, order=torch.zeros(1)),
            TypeCheckError,
            "order to be a Tensor of torch.int64",
        ),
        (lambda: E.ColorProgram(("hue", 0.0))(X, enabled=torch.ones(2).bool()), ShapeError, "enabled of shape"),
    ],
)
def test_errors(call, error, text):
    with pytest.raises(error, match=f"^ColorProgram: .*{text}"):
        call()
