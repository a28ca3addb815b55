"""Resizing and pyramids: kernels against their definition, and both against torch, OpenCV, Pillow and known values."""

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F

import kvision as K
from kvision.geometry.transform.pyramid import _detail
from op_tests import OpTests, assert_close

G = K.geometry
OPERATORS = ("resize", "resize_backward")


class ResizeTests(OpTests):
    operators = OPERATORS
    bytes = True
    # Weights are fractions of small integers, so many means lie just between two bytes.
    tolerances = {torch.uint8: (0, 1)}

    def test_operators_refuse_bad_arguments(self, device, backend, monkeypatch):
        """An image may have any size beside its result's, and only pyramids have a border."""
        import raw_calls

        every, fine = raw_calls.wrong_calls, (" cut along ", " around a pixel")
        monkeypatch.setattr(
            raw_calls, "wrong_calls", lambda *a: [c for c in every(*a) if not any(f in c[0] for f in fine)]
        )
        super().test_operators_refuse_bad_arguments(device, backend)


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


class TestPyrdown(ResizeTests):
    function = staticmethod(G.pyrdown)
    module = G.PyrDown
    max_size = 7
    small = (1, 2, 4, 6)
    variants = [
        {},
        {"border_type": "replicate", "align_corners": True, "factor": 1.4},
        {"border_type": "constant", "factor": 0.7},
    ]
    errors = [
        ({"border_type": "wrap"}, ValueError, "border_type must be one of"),
        ({"factor": 99.0}, ValueError, "expected factor to leave a pixel"),
        ({"align_corners": None}, TypeError, "align_corners to be a bool"),
    ]


class TestPyrup(ResizeTests):
    function = staticmethod(G.pyrup)
    module = G.PyrUp
    max_size = 7
    variants = [{}, {"border_type": "replicate", "align_corners": True}, {"border_type": "constant"}]
    errors = [({"border_type": "wrap"}, ValueError, "border_type must be one of")]


# --- torch, Pillow, OpenCV ------------------------------------------------------------------------------------------

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
        found = G.resize(b, size, name, align_corners, antialias=antialias)
        assert_close(found.cpu(), expected, 1e-12, 1e-12)
        weights = torch.rand(expected.shape, dtype=torch.float64)
        (expected * weights).sum().backward()
        (found * weights.to(device)).sum().backward()
        assert_close(b.grad.cpu(), a.grad, 1e-11, 1e-11)


def lanczos_of_torch():
    try:
        F.interpolate(torch.zeros(1, 1, 2, 2), (1, 1), mode="lanczos", antialias=True)
    except (NotImplementedError, ValueError):  # the latter up to torch 2.11, which knows no such mode
        return False
    return True


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ["bilinear", "bicubic", "lanczos"])
def test_antialias_is_that_of_pillow(name, size, device):
    pillow = pytest.importorskip("PIL.Image")
    x = np.random.default_rng(0).random((33, 40), np.float32)
    filter = getattr(pillow.Resampling, name.upper())
    expected = torch.from_numpy(np.asarray(pillow.fromarray(x).resize(size[::-1], filter)).copy())
    found = G.resize(torch.from_numpy(x).to(device), size, name, antialias=True)
    assert_close(found.cpu(), expected, 0, 2e-6)


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
    """Places of OpenCV are float32 numbers; ours are fractions."""
    x = np.random.default_rng(0).random((50, 40), np.float32)
    expected = cv2.resize(x, size[::-1], interpolation=flag)
    found = G.resize(torch.from_numpy(x).to(device), size, name)
    assert_close(found.cpu(), torch.from_numpy(expected), 0, tolerance)


@pytest.mark.parametrize("size", [(17, 13), (9, 50), (50, 77), (100, 80)])
def test_nearest_exact_is_that_of_opencv(size, device):
    """But for places between two pixels, which its 16 bits of fraction may round to either."""
    x = np.random.default_rng(0).random((50, 40), np.float32)
    expected = cv2.resize(x, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    between = [(2 * np.arange(n) + 1) * m % (2 * n) == 0 for n, m in zip(size, x.shape)]
    unsure = between[0][:, None] | between[1]
    found = G.resize(torch.from_numpy(x).to(device), size, "nearest-exact").cpu().numpy()
    assert (found == expected)[~unsure].all() and unsure.mean() < 0.3


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_area_of_whole_factors_is_that_of_opencv(factor, device):
    x = np.random.default_rng(0).random((60, 30), np.float32)
    expected = cv2.resize(x, (30 // factor, 60 // factor), interpolation=cv2.INTER_AREA)
    found = G.resize(torch.from_numpy(x).to(device), (60 // factor, 30 // factor), "area")
    assert_close(found.cpu(), torch.from_numpy(expected))


@pytest.mark.parametrize("factor", [0.5, 0.37, 1.5])
def test_bytes_of_opencv(factor, device):
    """OpenCV computes bytes with weights of 11 bits."""
    x = np.random.default_rng(0).integers(0, 256, (64, 48, 3), np.uint8)
    size = (int(64 * factor), int(48 * factor))
    expected = torch.from_numpy(cv2.resize(x, size[::-1])).permute(2, 0, 1)
    found = G.resize(torch.from_numpy(x).permute(2, 0, 1).to(device), size)
    assert (found.cpu().int() - expected.int()).abs().max() <= 1


# --- what must be exact ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bilinear", "bicubic", "lanczos", "nearest", "nearest-exact", "area"])
@pytest.mark.parametrize("align_corners", [False, True])
def test_the_same_size_is_the_same_image(name, align_corners, device):
    x = torch.rand(2, 3, 37, 41, device=device)
    x[0, 0, 3, 4], x[1, 1, 5, 6] = float("nan"), float("inf")
    for antialias in (False, True):
        found = G.resize(x, (37, 41), name, align_corners, antialias=antialias)
        assert_close(found, x, 0, 0)


def test_nearest_is_exact_at_any_size(device):
    """floor(i in / out) in whole numbers; in float32 torch misses it by a pixel here and there."""
    for source in (49, 1023, 4095):
        for result in (3, 98, 147, 6141):
            x = torch.arange(float(source), device=device).expand(1, 1, 1, source)
            i = torch.arange(result, device=device)
            found = G.resize(x, (1, result), "nearest")[0, 0, 0].long()
            assert torch.equal(found, i * source // result)
            found = G.resize(x, (1, result), "nearest-exact")[0, 0, 0].long()
            assert torch.equal(found, (2 * i + 1) * source // (2 * result))


def test_places_in_long_rows_are_exact(device):
    """As good at the far end as at the near one: places in float32 would be off by 1e-3 of a pixel there."""
    teeth = (torch.arange(20000, dtype=torch.float64, device=device) % 16).expand(1, 1, 1, -1)
    with K.backend("reference"):
        expected = G.resize(teeth, (1, 29989))
    assert_close(G.resize(teeth.float(), (1, 29989)).double(), expected, 0, 4e-6)


@pytest.mark.parametrize("size", [(1, 1), (2, 7)])
def test_large_windows(size, device):
    """Thousands of pixels for one: beyond what a block of threads has memory for on CUDA."""
    x = torch.rand(1, 2, 40, 12007, device=device)
    for name in ("bilinear", "area"):
        found = G.resize(x, size, name, antialias=name == "bilinear")
        with K.backend("reference"):
            assert_close(found, G.resize(x.double(), size, name, antialias=name == "bilinear").float(), 2e-5)


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


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize("size", [(16, 16), (74, 48), (40, 528)], ids=str)
def test_half_and_twice_the_size(size, down, dtype, device):
    """CUDA has kernels for these: with rims of their own, several strips across and down, and NaN that stay where they are."""
    x = torch.rand(2, 3, *size, device=device)
    x = (x * 255).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    result = [n // 2 if down else 2 * n for n in size]
    calls = [lambda x, how=how: G.resize(x, result, how[0], antialias=how[1]) for how in OCTAVES]
    pyramid = G.pyrdown if down else G.pyrup
    calls += [lambda x, border=border: pyramid(x, border) for border in ("reflect", "replicate", "constant")]
    for call in calls:
        check_like_reference(call, x)
    if dtype == torch.float32:
        x[0, 0, 5, 7], x[1, 2, -1, -1] = float("nan"), float("inf")
        for call in calls:
            found = call(x)
            with K.backend("reference"):
                assert torch.equal(found.isfinite(), call(x).isfinite())


def check_like_reference(call, x):
    """Values and gradients."""
    tolerance = {torch.float32: 2e-6, torch.float16: 2e-3, torch.uint8: 1}[x.dtype]
    inputs = [x.clone().requires_grad_(x.is_floating_point()) for _ in range(2)]
    found = call(inputs[0])
    with K.backend("reference"):
        expected = call(inputs[1])
        if x.is_floating_point():
            weights = torch.rand(found.shape, device=x.device).to(x.dtype)
            (expected_grad,) = torch.autograd.grad(expected, inputs[1], weights)
    assert_close(found.detach().float(), expected.detach().float(), 1e-3 if x.dtype == torch.float16 else 0, tolerance)
    if x.is_floating_point():
        (grad,) = torch.autograd.grad(found, inputs[0], weights)
        assert_close(grad.float(), expected_grad.float(), 1e-3 if x.dtype == torch.float16 else 1e-6, 2 * tolerance)


# --- pyramids -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("border", ["reflect", "constant", "replicate", "circular"])
def test_pyramids_are_a_blur_and_a_resize(border, device):
    x = torch.rand(2, 3, 15, 18, dtype=torch.float64, device=device)
    kernel = torch.tensor([[1.0, 4, 6, 4, 1]], dtype=torch.float64, device=device) / 16

    def blur(x):
        return K.filters.filter2d_separable(x, kernel, kernel, border)

    for align_corners in (False, True):
        down = G.resize(blur(x), (7, 9), align_corners=align_corners)
        assert_close(G.pyrdown(x, border, align_corners), down, 1e-12, 1e-12)
        up = blur(G.resize(x, (30, 36), align_corners=align_corners))
        assert_close(G.pyrup(x, border, align_corners), up, 1e-12, 1e-12)


@pytest.mark.parametrize("border", ["reflect", "constant", "replicate"])
@pytest.mark.parametrize("size", [(5, 7), (24, 136)], ids=str)
def test_details_are_differences(size, border, device, backend):
    how = (False, border)
    smaller = torch.rand(2, 3, *size, device=device)
    image = torch.rand(2, 3, *(2 * n for n in size), device=device)
    for dtype in (torch.float32, torch.float64, torch.float16, torch.bfloat16):
        a, b = smaller.to(dtype), image.to(dtype)
        expected = b.float() - G.pyrup(a.float(), border)
        for layout in (torch.contiguous_format, torch.channels_last):
            found = _detail(a.contiguous(memory_format=layout), b, *how)
            rounded = {torch.float16: 1e-3, torch.bfloat16: 8e-3}.get(dtype, 1e-6)
            assert found.dtype == dtype and (found.float() - expected).abs().max() <= rounded
        assert_close(_detail(a, b.mT.contiguous().mT, *how), _detail(a, b, *how), 0, 0)
        moved = torch.empty(b.numel() + 1, dtype=dtype, device=device)[1:].view(b.shape).copy_(b)
        assert_close(
            _detail(a, moved, *how),
            _detail(a, b, *how),
            0,
            1e-2 if dtype == torch.bfloat16 else 2e-3 if dtype == torch.float16 else 2e-6,
        )
    a, b = (x[:1, :1, :4, :6].double().requires_grad_() for x in (smaller[..., :2, :3], image))
    assert torch.autograd.gradcheck(lambda a, b: _detail(a, b, *how), (a, b))
    assert torch.autograd.gradgradcheck(lambda a, b: _detail(a, b, *how), (a, b))
    each = torch.func.vmap(lambda a, b: _detail(a[None], b[None], *how)[0])(smaller, image)
    assert_close(each, _detail(smaller, image, *how))
    if backend != "reference":
        torch.library.opcheck(torch.ops.kvision.pyramid_detail.default, (a, b, *how))
        with pytest.raises(RuntimeError, match="^pyramid_detail: image differs"):
            torch.ops.kvision.pyramid_detail(smaller, image[..., 1:], *how)


def test_a_pyramid_of_a_constant_is_constant(device):
    x = torch.full((1, 1, 64, 48), 0.37, device=device)
    for level in G.build_pyramid(x, 4):
        assert_close(level, torch.full_like(level, 0.37))
    for detail in G.build_laplacian_pyramid(x, 3)[:-1]:
        assert detail.abs().max() < 1e-6
