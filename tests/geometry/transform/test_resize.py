"""Resizing: kernels against their definition, and both against torch, OpenCV, Pillow and known values."""

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F

import kvision as K
from op_tests import assert_close
from warp_tests import ResizeTests

G = K.geometry


class TestResize(ResizeTests):
    function = staticmethod(G.resize)
    module = G.Resize
    max_size = 9
    variants = [
        {"size": (7, 27)},
        {"size": (20, 5), "align_corners": True},
        {"size": (6, 9), "interpolation": "nearest"},
        {"size": (17, 23), "interpolation": "nearest-exact"},
        {"size": (5, 40), "interpolation": "area"},
        {"size": (8, 30), "interpolation": "bicubic"},
        {"size": (5, 7), "antialias": True},
        {"size": (4, 6), "interpolation": "bicubic", "antialias": True},
        {"size": (3, 25), "interpolation": "lanczos", "antialias": True},
        {"size": (16, 9), "interpolation": "lanczos", "align_corners": True},
    ]
    errors = [
        ({"size": 1.5}, TypeError, "expected size"),
        ({"size": (0, 3)}, ValueError, "expected size"),
        ({"interpolation": "linear"}, ValueError, "interpolation must be one of bilinear, nearest"),
        ({"size": 3, "side": "top"}, ValueError, "side must be one of short, long, vert, horz"),
        ({"antialias": "box"}, TypeError, "antialias to be a bool"),
        ({"align_corners": 1}, TypeError, "align_corners to be a bool"),
    ]

    def test_wrong_kinds(self, variant, device):
        x = torch.rand(2, 3, 4, 5, device=device)
        for wrong, error in [
            ([[1.0]], TypeError),
            (None, TypeError),
            (x.to(torch.complex64), TypeError),
            (x[0, 0, 0], ValueError),
            (x[..., :0], ValueError),
        ]:
            with pytest.raises(error, match="^resize: "):
                G.resize(wrong, **variant)


SIZES = [(9, 50), (50, 9), (9, 13), (50, 77), (66, 80), (33, 40), (1, 1)]
WINDOWS = [
    *[(name, align, False) for name in ("bilinear", "bicubic") for align in (False, True)],
    *[(name, False, True) for name in ("bilinear", "bicubic", "lanczos")],
    *[(name, False, False) for name in ("nearest", "nearest-exact", "area")],
]


@pytest.mark.parametrize("name, align_corners, antialias", WINDOWS)
def test_values_and_gradients_of_torch(name, align_corners, antialias, device):
    if name == "lanczos" and not lanczos_of_torch():
        pytest.skip("this torch has no Lanczos windows")
    corners = {"align_corners": align_corners} if name in ("bilinear", "bicubic") else {}
    for size in SIZES:
        x = torch.rand(2, 3, 33, 40, dtype=torch.float64)
        a, b = x.clone().requires_grad_(), x.to(device, copy=True).requires_grad_()
        expected = F.interpolate(a, size, mode=name, antialias=antialias, **corners)
        result = G.resize(b, size, name, align_corners, antialias=antialias)
        assert_close(result.cpu(), expected, 1e-12, 1e-12)
        weights = torch.rand(expected.shape, dtype=torch.float64)
        (expected * weights).sum().backward()
        (result * weights.to(device)).sum().backward()
        assert_close(b.grad.cpu(), a.grad, 1e-11, 1e-11)


def lanczos_of_torch():
    try:
        F.interpolate(torch.zeros(1, 1, 2, 2), (1, 1), mode="lanczos", antialias=True)
    except (NotImplementedError, ValueError):  # the latter up to torch 2.11, which knows no such mode
        return False
    return True


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ["bilinear", "bicubic", "lanczos"])
def test_antialias_equals_pillow(name, size, device):
    pillow = pytest.importorskip("PIL.Image")
    x = np.random.default_rng(0).random((33, 40), np.float32)
    filter = getattr(pillow.Resampling, name.upper())
    expected = torch.from_numpy(np.asarray(pillow.fromarray(x).resize(size[::-1], filter)).copy())
    result = G.resize(torch.from_numpy(x).to(device), size, name, antialias=True)
    assert_close(result.cpu(), expected, 0, 2e-6)


@pytest.mark.parametrize("size", [(25, 20), (9, 50), (50, 77), (100, 80)])
@pytest.mark.parametrize(
    "name, flag, tolerance",
    [
        ("bilinear", cv2.INTER_LINEAR, 2e-6),
        ("bicubic", cv2.INTER_CUBIC, 4e-6),
        ("nearest", cv2.INTER_NEAREST, 0),
    ],
)
def test_values_of_opencv(name, flag, tolerance, size, device):
    """OpenCV's coordinates are float32 numbers; ours are fractions."""
    x = np.random.default_rng(0).random((50, 40), np.float32)
    expected = cv2.resize(x, size[::-1], interpolation=flag)
    result = G.resize(torch.from_numpy(x).to(device), size, name)
    assert_close(result.cpu(), torch.from_numpy(expected), 0, tolerance)


@pytest.mark.parametrize("size", [(17, 13), (9, 50), (50, 77), (100, 80)])
def test_nearest_exact_equals_opencv(size, device):
    """But for coordinates between two pixels, which its 16 bits of fraction may round to either."""
    x = np.random.default_rng(0).random((50, 40), np.float32)
    expected = cv2.resize(x, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    between = [(2 * np.arange(n) + 1) * m % (2 * n) == 0 for n, m in zip(size, x.shape)]
    unsure = between[0][:, None] | between[1]
    result = G.resize(torch.from_numpy(x).to(device), size, "nearest-exact").cpu().numpy()
    assert (result == expected)[~unsure].all() and unsure.mean() < 0.3


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_area_of_integer_factors_equals_opencv(factor, device):
    x = np.random.default_rng(0).random((60, 30), np.float32)
    expected = cv2.resize(x, (30 // factor, 60 // factor), interpolation=cv2.INTER_AREA)
    result = G.resize(torch.from_numpy(x).to(device), (60 // factor, 30 // factor), "area")
    assert_close(result.cpu(), torch.from_numpy(expected))


@pytest.mark.parametrize("factor", [0.5, 0.37, 1.5])
def test_bytes_of_opencv(factor, device):
    """OpenCV computes bytes with weights of 11 bits."""
    x = np.random.default_rng(0).integers(0, 256, (64, 48, 3), np.uint8)
    size = (int(64 * factor), int(48 * factor))
    expected = torch.from_numpy(cv2.resize(x, size[::-1])).permute(2, 0, 1)
    result = G.resize(torch.from_numpy(x).permute(2, 0, 1).to(device), size)
    assert (result.cpu().int() - expected.int()).abs().max() <= 1


@pytest.mark.parametrize("name", ["bilinear", "bicubic", "lanczos", "nearest", "nearest-exact", "area"])
@pytest.mark.parametrize("align_corners", [False, True])
def test_the_same_size_is_the_same_image(name, align_corners, device):
    x = torch.rand(2, 3, 37, 41, device=device)
    x[0, 0, 3, 4], x[1, 1, 5, 6] = float("nan"), float("inf")
    for antialias in (False, True):
        result = G.resize(x, (37, 41), name, align_corners, antialias=antialias)
        assert_close(result, x, 0, 0)


def test_nearest_is_exact_at_any_size(device):
    """floor(i in / out) in whole numbers; in float32 torch misses it by a pixel here and there."""
    for source in (49, 1023, 4095):
        for result in (3, 98, 147, 6141):
            x = torch.arange(float(source), device=device).expand(1, 1, 1, source)
            i = torch.arange(result, device=device)
            actual = G.resize(x, (1, result), "nearest")[0, 0, 0].long()
            assert torch.equal(actual, i * source // result)
            actual = G.resize(x, (1, result), "nearest-exact")[0, 0, 0].long()
            assert torch.equal(actual, (2 * i + 1) * source // (2 * result))


def test_coordinates_in_long_rows_are_exact(device):
    """As good at the far end as at the near one: coordinates in float32 would be off by 1e-3 of a pixel there."""
    teeth = (torch.arange(20000, dtype=torch.float64, device=device) % 16).expand(1, 1, 1, -1)
    with K.backend("reference"):
        expected = G.resize(teeth, (1, 29989))
    assert_close(G.resize(teeth.float(), (1, 29989)).double(), expected, 0, 4e-6)


@pytest.mark.native
@pytest.mark.parametrize("size", [(1, 1), (2, 7)])
def test_large_windows(size, device):
    """Thousands of pixels for one: beyond what a block of threads has memory for on CUDA."""
    x = torch.rand(1, 2, 40, 12007, device=device)
    for name in ("bilinear", "area"):
        result = G.resize(x, size, name, antialias=name == "bilinear")
        with K.backend("reference"):
            assert_close(result, G.resize(x.double(), size, name, antialias=name == "bilinear").float(), 2e-5)


def test_one_operator_a_call(device, backend):
    """No step of Python's own on the way."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x = torch.rand(1, 3, 16, 16, device=device)
    for call in (lambda: G.resize(x, (8, 8)), lambda: G.pyrdown(x), lambda: G.pyrup(x)):
        call()
        with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profile:
            call()
        names = [event.name for event in profile.events()]
        operators = [name for name in names if "::" in name and not name.startswith("aten::empty")]
        assert operators == ["kvision::resize"], operators
        assert device.type == "cpu" or names.count("cudaLaunchKernel") == 1, names


OCTAVES = [
    *[("bilinear", antialias) for antialias in (False, True)],
    *[("bicubic", antialias) for antialias in (False, True)],
    ("lanczos", False),
]


@pytest.mark.native
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize("size", [(16, 16), (74, 48), (40, 528)], ids=str)
def test_half_and_twice_the_size(size, down, dtype, device):
    """CUDA has kernels for these: with rims of their own, several strips across and down, and NaN that stay where they are."""
    x = torch.rand(2, 3, *size, device=device)
    x = (x * 255).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    result = [n // 2 if down else 2 * n for n in size]
    calls = [lambda x, options=options: G.resize(x, result, options[0], antialias=options[1]) for options in OCTAVES]
    pyramid = G.pyrdown if down else G.pyrup
    calls += [lambda x, border=border: pyramid(x, border) for border in ("reflect", "replicate", "constant")]
    for call in calls:
        check_like_reference(call, x)
    if dtype == torch.float32:
        x[0, 0, 5, 7], x[1, 2, -1, -1] = float("nan"), float("inf")
        for call in calls:
            actual = call(x)
            with K.backend("reference"):
                assert torch.equal(actual.isfinite(), call(x).isfinite())


WINDOWS_OF_ANY_FACTOR = [
    *[(name, True) for name in ("bilinear", "bicubic", "lanczos")],
    *[(name, False) for name in ("bilinear", "bicubic", "area")],
]


@pytest.mark.native
@pytest.mark.large
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("size", [(224, 224), (333, 200), (150, 517), (400, 301), (160, 600), (20, 9)], ids=str)
def test_any_factor_of_large_images(size, dtype, device):
    """Rows that are no whole vectors, several strips of them, and factors of every kind: also of one side, and up."""
    x = torch.rand(1, 3, 333, 517, device=device)
    x = (x * 255).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    for layout in (torch.contiguous_format, torch.channels_last):
        for name, antialias in WINDOWS_OF_ANY_FACTOR[:: 1 if layout == torch.contiguous_format else 5]:
            image = x.contiguous(memory_format=layout)
            check_like_reference(
                lambda x, name=name, antialias=antialias: G.resize(x, size, name, antialias=antialias), image
            )


@pytest.mark.parametrize("size", [(299, 299), (335, 513), (321, 481), (96, 130)], ids=str)
def test_pyramids_of_odd_sizes(size, device):
    x = torch.rand(2, 3, *size, device=device)
    for border in ("reflect", "replicate", "constant"):
        check_like_reference(lambda x, border=border: G.pyrdown(x, border), x)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16], ids=str)
@pytest.mark.parametrize("border", ["reflect", "replicate", "constant"])
def test_numbers_without_weight_are_harmless_to_pyramids(border, dtype, device):
    """The middle pixel of an odd side is a pixel of the source: the last of its six taps has no weight."""
    x = torch.rand(1, 3, 35, 299, device=device).to(dtype)
    x[0, 0, 20] = x[0, 2, 0, 0] = float("inf")
    x[0, 1, :, 152] = x[0, 2, 34, 298] = float("nan")
    result = G.pyrdown(x, border)
    with K.backend("reference"):
        expected = G.pyrdown(x, border)
    assert result[0, :, 8, 74].isfinite().all()
    assert torch.equal(result.isnan(), expected.isnan())
    assert torch.equal(result.isfinite(), expected.isfinite())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
def test_bits_do_not_depend_on_where_rows_begin(dtype, device):
    x = torch.rand(2, 3, 100, 264, device=device)
    x = (x * 255).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    for size in ((70, 184), (31, 40), (150, 300), (100, 100)):
        for name, antialias in WINDOWS_OF_ANY_FACTOR:
            expected = G.resize(x, size, name, antialias=antialias)
            for before in (1, 2, 3):
                wider = torch.zeros(2, 3, 103, 264 + 2 * before + 1, dtype=dtype, device=device)
                inner = wider[..., 2:-1, before : 264 + before].copy_(x)
                assert torch.equal(G.resize(inner, size, name, antialias=antialias), expected)


@pytest.mark.parametrize("name, antialias", WINDOWS_OF_ANY_FACTOR)
def test_numbers_out_of_a_window_are_harmless(name, antialias, device):
    x = torch.rand(1, 2, 120, 301, device=device)
    x[0, 0, 60, 150], x[0, 1, 119, 300] = float("inf"), float("nan")
    for size in ((53, 140), (120, 90), (200, 500)):
        result = G.resize(x, size, name, antialias=antialias)
        with K.backend("reference"):
            expected = G.resize(x, size, name, antialias=antialias)
        assert torch.equal(result.isfinite(), expected.isfinite())
        assert_close(result.nan_to_num(0, 0, 0), expected.nan_to_num(0, 0, 0), 0, 4e-6)


def check_like_reference(call, x):
    """Values and gradients."""
    tolerance = {torch.float32: 2e-6, torch.float16: 2e-3, torch.uint8: 1}[x.dtype]
    inputs = [x.clone().requires_grad_(x.is_floating_point()) for _ in range(2)]
    result = call(inputs[0])
    with K.backend("reference"):
        expected = call(inputs[1])
        if x.is_floating_point():
            weights = torch.rand(result.shape, device=x.device).to(x.dtype)
            (expected_grad,) = torch.autograd.grad(expected, inputs[1], weights)
    assert_close(result.detach().float(), expected.detach().float(), 1e-3 if x.dtype == torch.float16 else 0, tolerance)
    if x.is_floating_point():
        (grad,) = torch.autograd.grad(result, inputs[0], weights)
        assert_close(grad.float(), expected_grad.float(), 1e-3 if x.dtype == torch.float16 else 1e-6, 2 * tolerance)


@pytest.mark.parametrize("mode", ["bilinear", "bicubic"])
def test_antialias_equals_torch(mode, device):
    x = torch.rand(2, 3, 33, 40, device=device)
    expected = F.interpolate(x, (9, 50), mode=mode, antialias=True)
    assert_close(G.resize(x, (9, 50), mode, antialias=True), expected)


def test_gaussian_antialias_equals_kornia(device):
    kornia = pytest.importorskip("kornia")
    x = torch.rand(2, 3, 33, 40)
    expected = kornia.geometry.resize(x, (9, 13), antialias=True)
    assert_close(G.resize(x.to(device), (9, 13), antialias="gaussian").cpu(), expected, 1e-4, 1e-5)


IMAGE = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1)).double()
FUNCTIONS = {
    "resize": (lambda x: G.resize(x, (3, 9)), (IMAGE,)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.resize(X, 1.5), TypeError, "resize: expected size"),
    (lambda: G.resize(X, (0, 3)), ValueError, "resize: expected size"),
    (lambda: G.resize(X, 3, side="top"), ValueError, "resize: side must be one of short, long, vert, horz"),
    (lambda: G.resize(X, 3, antialias="box"), TypeError, "resize: expected antialias to be a bool"),
    (lambda: G.resize(X[0, 0, 0], 3), ValueError, r"resize: expected input of shape \(\*, H, W\)"),
    (lambda: G.rescale(X, 0.1), ValueError, "rescale: expected factor to leave a pixel"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
