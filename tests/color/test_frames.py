"""Frames of video decoders: to RGB, whole, resized and warped, and back."""

from __future__ import annotations

import itertools
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from op_tests import OpTests, assert_close

C = K.color
SITINGS = ("left", "center", "topleft")


def codes(*shape: int, dtype: torch.dtype = torch.uint8) -> Tensor:
    return torch.randint(0, 256, shape).to(dtype)


def frame(
    size: tuple[int, int] = (13, 18), batch: int = 2, dtype: torch.dtype = torch.float64
) -> tuple[Tensor, Tensor]:
    """Codes of colors that are far from black and white, so that none is clamped."""
    h, w = size
    return (
        0.4 + 0.2 * torch.rand(batch, 1, h, w, dtype=dtype),
        0.45 + 0.1 * torch.rand(batch, (h + 1) // 2, (w + 1) // 2, 2, dtype=dtype),
    )


def to_opencv(rgb: Tensor) -> np.ndarray:
    return rgb.movedim(-3, -1).contiguous().cpu().numpy()


@pytest.mark.parametrize("layout", ["nv12", "nv21", "i420", "yuy2"])
def test_opencv(layout, device):
    x = codes(24, 32, 2) if layout == "yuy2" else codes(36, 32)
    luma = x[..., 0] if layout == "yuy2" else x[:24]
    luma.clamp_(min=16)  # OpenCV takes what is blacker than black for black
    expected = cv2.cvtColor(x.numpy(), getattr(cv2, f"COLOR_YUV2RGB_{layout.upper()}"))
    actual = to_opencv(C.frames_to_rgb(x.to(device), layout))
    assert abs(actual.astype(int) - expected).max() <= 1
    name = f"COLOR_RGB2YUV_{layout.upper()}"
    if not hasattr(cv2, name):  # NV12 is the same planes
        back = C.rgb_to_frames(torch.from_numpy(expected).movedim(-1, 0).to(device), "i420", split=True)
        y, uv = C.rgb_to_frames(torch.from_numpy(expected).movedim(-1, 0).to(device), layout, split=True)
        u, v = uv.unbind(-1) if layout == "nv12" else uv.flip(-1).unbind(-1)
        assert all(torch.equal(a, b) for a, b in zip(back, (y, u[None], v[None]), strict=True))
    else:
        # Of 4:2:2 OpenCV averages chroma.
        averaged = {"chroma": "linear", "siting": "center"} if layout == "yuy2" else {}
        back = C.rgb_to_frames(torch.from_numpy(expected).movedim(-1, 0).to(device), layout, **averaged).cpu().numpy()
        assert abs(back.astype(int) - cv2.cvtColor(expected, getattr(cv2, name))).max() <= 1


def test_red_of_opencv(device):
    red = torch.tensor([255, 0, 0], dtype=torch.uint8).expand(4, 4, 3).contiguous()
    x = torch.from_numpy(cv2.cvtColor(red.numpy(), cv2.COLOR_RGB2YUV_I420)).to(device)
    expected = red.movedim(-1, 0)
    assert_close(C.frames_to_rgb(x, "i420").cpu(), expected, rtol=0, atol=1)
    assert_close(C.frames_to_rgb(x, "i420", dtype=torch.float32).cpu(), expected / 255, rtol=0, atol=0.003)


# Codes of red, green and blue in limited range, those of color bars.
PRIMARIES = {
    "bt601": ((81, 90, 240), (145, 54, 34), (41, 240, 110)),
    "bt709": ((63, 102, 240), (173, 42, 26), (32, 240, 118)),
    "bt2020": ((74, 97, 240), (164, 47, 25), (29, 240, 119)),
}


@pytest.mark.parametrize("matrix", PRIMARIES)
@pytest.mark.parametrize("layout", ["nv12", "p010"])
def test_primaries(matrix, layout, device):
    rgb = torch.eye(3, device=device).view(3, 3, 1, 1).expand(3, 3, 2, 2)
    x = C.rgb_to_frames(rgb, layout, matrix=matrix, **({} if layout == "p010" else {"dtype": torch.uint8})).cpu()
    eighths = (x.int() / 256).round().int() if layout == "p010" else x.int()
    expected = torch.tensor(PRIMARIES[matrix], dtype=torch.int32)
    assert (eighths[:, 0, 0] - expected[:, 0]).abs().max() <= 1 and (eighths[:, 2] - expected[:, 1:]).abs().max() <= 1
    assert_close(C.frames_to_rgb(x.to(device), layout, matrix=matrix, dtype=torch.float32), rgb, rtol=0, atol=0.012)


def test_full_range_and_10_bits(device):
    gray = torch.tensor([0, 51, 255], dtype=torch.uint8).view(3, 1, 1).expand(3, 3, 2).clone()
    gray[:, 2] = 128
    expected = torch.tensor([0, 0.2, 1]).view(3, 1, 1, 1).expand(3, 3, 2, 2).to(device)
    assert_close(C.frames_to_rgb(gray.to(device), color_range="full", dtype=torch.float32), expected)
    ten = torch.tensor([0, 1023], dtype=torch.int32).view(2, 1, 1).expand(2, 3, 2).clone()
    ten[:, 2] = 512
    x = (ten * 64).to(torch.uint16).to(device)
    assert_close(C.frames_to_rgb(x, "p010", color_range="full"), expected[::2])
    limited = torch.tensor([64, 940], dtype=torch.int32).view(2, 1, 1).expand(2, 3, 2).clone()
    limited[:, 2] = 512
    x = (limited * 64).to(torch.uint16).to(device)
    assert_close(C.frames_to_rgb(x, "p010"), expected[::2])
    random = (torch.randint(0, 1024, (2, 12, 16), dtype=torch.int32) * 64).to(torch.uint16).to(device)
    by_floats = (random.float() / 64 / 4 / 255).double()
    for kwargs in ({"chroma": "linear"}, {}):
        assert_close(
            C.frames_to_rgb(random, "p010", **kwargs), C.frames_to_rgb(by_floats, **kwargs).float(), rtol=0, atol=2e-6
        )
    assert_close(
        C.resize_frames(random, (5, 7), layout="p010"), C.resize_frames(by_floats, (5, 7)).float(), rtol=0, atol=2e-6
    )


@pytest.mark.parametrize("siting", SITINGS)
@pytest.mark.parametrize("size", [(6, 8), (7, 5), (1, 1)], ids=str)
def test_linear_chroma(siting, size, device):
    """NumPy's interpolation between the positions of the samples."""
    y, uv = frame(size)
    (h, w), half = size, uv.shape[1:3]
    across = 2 * np.arange(half[1]) + (0.5 if siting == "center" else 0)
    down = 2 * np.arange(half[0]) + (0 if siting == "topleft" else 0.5)
    whole = torch.empty(2, 2, h, w, dtype=torch.float64)
    for b, k in itertools.product(range(2), range(2)):
        rows = np.stack([np.interp(np.arange(w), across, row) for row in uv[b, ..., k].numpy()])
        whole[b, k] = torch.from_numpy(np.stack([np.interp(np.arange(h), down, c) for c in rows.T], 1))
    luma, blue, red = (y[:, 0] * 255 - 16) / 219, (whole[:, 0] * 255 - 128) / 224, (whole[:, 1] * 255 - 128) / 224
    r, b = luma + 1.402 * red, luma + 1.772 * blue
    expected = torch.stack([r, (luma - 0.299 * r - 0.114 * b) / 0.587, b], 1)
    planes = (y.to(device), uv.to(device))
    assert_close(C.frames_to_rgb(planes, chroma="linear", siting=siting).cpu(), expected)
    # Means of pixels around the samples keep what is linear in the image.
    ramp = (0.4 + 0.02 * torch.arange(8.0, dtype=torch.float64)).expand(1, 3, 6, 8).clone()
    ramp[:, 1] -= 0.1
    coded = C.rgb_to_frames(ramp.to(device), chroma="linear", siting=siting, split=True)
    inner = C.frames_to_rgb(coded, chroma="linear", siting=siting).cpu()[..., 2:-2]
    assert_close(inner, ramp[..., 2:-2], rtol=0, atol=1e-12)


def test_layouts_are_views(device):
    """Pitches, separate planes, sizes to display and frames of one batch give the same bits."""
    x = codes(2, 36, 40).to(device)
    wide = torch.zeros(2, 40, 64, dtype=torch.uint8, device=device)
    wide[:, :36, :40] = x
    y, uv = x[:, :24], x[:, 24:].unflatten(2, (20, 2))
    expected = C.frames_to_rgb(x)
    for planes in (wide[:, :36, :40], (y, uv), (y[:, None], uv), [y[:, None], uv.clone()]):
        assert torch.equal(C.frames_to_rgb(planes), expected)
    assert torch.equal(C.frames_to_rgb((y, uv.flip(-1)), "nv21"), expected)
    assert torch.equal(C.frames_to_rgb((y[:, None], *uv[:, None].unbind(-1)), "i420"), expected)
    assert torch.equal(C.frames_to_rgb(x[1]), expected[1])
    u, v = uv.unbind(-1)
    for call in (C.frames_to_rgb, lambda planes, layout: C.resize_frames(planes, (11, 19), layout=layout)):
        assert torch.equal(call((y, u, v.contiguous()), "i420"), call((y, uv), "nv12"))
    for size in ((23, 39), (10, 16)):
        assert torch.equal(C.frames_to_rgb(x, size=size), expected[..., : size[0], : size[1]])
    packed = C.rgb_to_frames(expected, "yuy2")
    assert torch.equal(C.frames_to_rgb(packed, "yuy2", size=(9, 13)), C.frames_to_rgb(packed, "yuy2")[..., :9, :13])
    i420 = C.rgb_to_frames(expected, "i420")
    assert torch.equal(C.frames_to_rgb(i420, "i420"), C.frames_to_rgb(C.rgb_to_frames(expected)))
    odd = C.rgb_to_frames(expected[..., :5, :7], split=True)
    assert [tuple(p.shape) for p in odd] == [(2, 1, 5, 7), (2, 3, 4, 2)]
    assert C.frames_to_rgb(odd).shape == (2, 3, 5, 7)


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize("chroma", ["nearest", "left"])
def test_resizes_of_all_layouts_have_the_same_bits(chroma, antialias, device):
    """Large factors, where windows end at the borders of the frame and of words, and the smallest of columns on CUDA."""
    kwargs = {} if chroma == "nearest" else {"chroma": "linear", "siting": chroma}
    x = codes(2, 84, 96).to(device)
    y, uv = x[:, :56], x[:, 56:].unflatten(2, (48, 2))
    u, v = (p.contiguous() for p in uv.unbind(-1))
    vu = torch.stack((v, u), -1)
    yvu = torch.cat((y.flatten(1), v.flatten(1), u.flatten(1)), 1)  # v first in memory, as in YV12
    v_first = yvu[:, 56 * 96 :].unflatten(1, (2, 28, 48))
    boxes = torch.tensor([[3.0, 2, 90.5, 55], [96, 50, 10, 0]], device=device)
    for dsize, dtype in itertools.product(((9, 11), (14, 24), (14, 32)), (torch.uint8, torch.float16, torch.float32)):
        resized = partial(C.resize_frames, dsize=dsize, boxes=boxes, dtype=dtype, antialias=antialias, **kwargs)
        expected = resized(x)
        assert torch.equal(resized((y, vu), layout="nv21"), expected)
        for chroma_planes in ((u, v), (v_first[:, 1], v_first[:, 0])):
            assert torch.equal(resized((y, *chroma_planes), layout="i420"), expected)


@pytest.mark.parametrize("chroma", ["nearest", *SITINGS])
def test_resize_is_a_resize_of_colors(chroma, device):
    kwargs = {} if chroma == "nearest" else {"chroma": "linear", "siting": chroma}
    y, uv = (p.to(device) for p in frame((37, 53)))
    rgb = C.frames_to_rgb((y, uv), **kwargs)
    boxes = torch.tensor([[3.0, 5, 40, 33], [41, 2, 7, 37]], device=device, dtype=torch.float64)  # one is mirrored
    crops = rgb[:1, :, 5:33, 3:40], rgb[1:, :, 2:37, 7:41].flip(-1)
    for dsize, antialias in itertools.product([(17, 20), (37, 53), (90, 31), (1, 1)], [False, True]):
        same = {"antialias": antialias, **kwargs}
        expected = K.geometry.resize(rgb, dsize, antialias=antialias)
        assert_close(C.resize_frames((y, uv), dsize, **same), expected)
        expected = torch.cat([K.geometry.resize(crop, dsize, antialias=antialias) for crop in crops])
        assert_close(C.resize_frames((y, uv), dsize, boxes, **same), expected)
    # Many boxes of one frame; normalized colors; a whole number of pixels, at odd offsets.
    boxes = torch.tensor([[3.0, 5, 40, 33], [1, 1, 38, 29]], device=device)
    normal = C.resize_frames((y[:1], uv[:1]), (28, 37), boxes, mean=(0.4, 0.5, 0.6), std=0.25, **kwargs)
    expected = torch.cat([rgb[:1, :, 5:33, 3:40], rgb[:1, :, 1:29, 1:38]])
    assert_close(normal, (expected - rgb.new_tensor([0.4, 0.5, 0.6]).view(3, 1, 1)) / 0.25)
    matrices = torch.tensor([[[0.8, 0.3, 2], [-0.2, 0.9, 5], [1e-3, 2e-3, 1]]], device=device, dtype=torch.float64)
    for m, warp in ((matrices, K.geometry.warp_perspective), (matrices[:, :2], K.geometry.warp_affine)):
        assert_close(C.warp_frames((y, uv), m, (30, 40), **kwargs), warp(rgb, m.expand(2, -1, -1), (30, 40)))


def test_awkward_boxes_and_matrices(device):
    """Outside of the frame its border continues; what is not finite reads no memory that is not there."""
    x = codes(1, 12, 8).to(device)
    rgb = C.frames_to_rgb(x, dtype=torch.float32)
    inf, nan = float("inf"), float("nan")
    boxes = torch.tensor(
        [[-4.0, 0, 0, 8], [20, 0, 30, 8], [-2, -2, 10, 10], [nan, 0, 8, 8], [0, 0, inf, 8], [-1e30, 0, 1e30, 8]],
        device=device,
    )
    actual = C.resize_frames(x, (8, 4), boxes, dtype=torch.float32, antialias=True)
    assert_close(actual[0], rgb[0, :, :, :1].expand(3, 8, 4), rtol=0, atol=1e-6)
    assert_close(actual[1], rgb[0, :, :, -1:].expand(3, 8, 4), rtol=0, atol=1e-6)
    singular = torch.zeros(1, 3, 3, device=device)
    assert not C.warp_frames(x, singular, (4, 4)).any()
    assert not C.warp_frames(x, torch.full((1, 2, 3), nan, device=device), (4, 4)).any()
    far = torch.tensor([[[1.0, 0, 1e9], [0, 1, 0]]], device=device)
    assert not C.warp_frames(x, far, (4, 4)).any()


def test_capture(device):
    """No copy waits for the host: a call is captured, and replayed with other codes and matrices."""
    if device.type != "cuda":
        pytest.skip("CUDA graphs")
    x, other = codes(2, 36, 32).to(device), codes(2, 36, 32).to(device)
    M, moved = (torch.tensor([[[0.8, 0.3, dx], [-0.2, 0.9, 5]]], device=device) for dx in (2.0, 4.0))
    boxes = torch.tensor([[3.0, 5, 20, 21]], device=device)

    def all_of(x: Tensor, M: Tensor) -> list[Tensor]:
        rgb = C.frames_to_rgb(x)
        return [rgb, C.warp_frames(x, M, (20, 24)), C.resize_frames(x, 12, boxes, antialias=True), C.rgb_to_frames(rgb)]

    expected = all_of(other, moved)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        results = all_of(x, M)
    x.copy_(other)
    M.copy_(moved)
    graph.replay()
    assert all(torch.equal(a, b) for a, b in zip(results, expected, strict=True))


def test_largest_windows(device):
    """Reductions whose windows exceed what a block of threads keeps."""
    y, uv = (p.to(device) for p in frame((80, 200), dtype=torch.float32))
    expected = K.geometry.resize(C.frames_to_rgb((y, uv)), (33, 4), antialias=True)
    assert_close(C.resize_frames((y, uv), (33, 4), antialias=True), expected)


def stored(layout: str, height: int, width: int, pitch: int, at: int, device: torch.device) -> tuple[Tensor, ...]:
    """Planes of random codes of 3 frames, whose rows are `pitch` elements apart and begin at element `at`."""
    half, dtype = ((height + 1) // 2, (width + 1) // 2), torch.uint16 if layout == "p010" else torch.uint8

    def plane(rows: int, columns: int) -> Tensor:
        x = torch.randint(0, 256 if dtype == torch.uint8 else 1 << 16, (3, rows, at + columns + pitch))
        return x.to(dtype).to(device)[:, :, at : at + columns]

    if layout == "yuy2":
        return (plane(height, 2 * width).unflatten(2, (width, 2)),)
    if layout == "i420":
        return plane(height, width), plane(*half), plane(*half)
    return plane(height, width), plane(half[0], 2 * half[1]).unflatten(2, (half[1], 2))


@pytest.mark.parametrize("layout", ["nv12", "nv21", "i420", "yuy2", "p010"])
@pytest.mark.parametrize("pitch, at", [(0, 0), (16, 16), (13, 3)], ids=["dense", "vectors", "bytes"])
def test_codes_by_words(layout, pitch, at, device):
    """Planes of integers of any width and pitch, whole, resized and back: what the definition gives."""
    sizes: dict[tuple[int, int], list[tuple[int, int]]] = {
        (36, 528): [(18, 264), (36, 528), (7, 100), (40, 600)],
        (21, 38): [(10, 19), (5, 9), (1, 1)],
        (34, 37): [(17, 18)],
        (3, 1): [(2, 2)],
    }
    for (height, width), results in sizes.items():
        if layout == "yuy2" and width % 2:
            continue
        planes = stored(layout, height, width, pitch, at, device)
        given = planes[0] if layout == "yuy2" else planes
        edges = [[0.0, 0, width, height], [0.8 * width, 1, 0.1 * width, height - 0.3], [0, 0.9 * height, width / 2, 0]]
        boxes = torch.tensor(edges, device=device)
        for dtype, limit in ((torch.uint8, 1.0), (torch.float16, 1e-3), (torch.float32, 4e-4)):  # of positions near 500
            colors: dict[str, Any] = {"layout": layout, "matrix": "bt709", "dtype": dtype}
            if dtype != torch.uint8:
                colors.update(mean=(0.4, 0.5, 0.6), std=0.2)
                limit *= 5
            calls: list[Any] = [partial(C.frames_to_rgb, given, **colors)]
            for dsize, antialias, chroma in itertools.product(results, (True, False), ("nearest", "linear")):
                same = {**colors, "antialias": antialias, "chroma": chroma}
                calls.append(partial(C.resize_frames, given, dsize, **same))
                calls.append(partial(C.resize_frames, given, dsize, boxes, **same))
            for call in calls:
                actual = call()
                with K.backend("reference"):
                    expected = call()
                assert actual.dtype == dtype
                assert (actual.double() - expected.double()).abs().max() <= limit
        if layout == "p010":
            continue
        for dtype in (torch.uint8, torch.float16, torch.float32):
            image = torch.rand(3, 3, height, width + at, device=device)[..., at:]
            image = (255 * image).round().byte() if dtype == torch.uint8 else image.to(dtype)
            for chroma in ("nearest", *SITINGS):
                same = {"split": layout != "yuy2", "dtype": torch.uint8} | (
                    {} if chroma == "nearest" else {"chroma": "linear", "siting": chroma}
                )
                actual = C.rgb_to_frames(image, layout, **same)
                with K.backend("reference"):
                    expected = C.rgb_to_frames(image, layout, **same)
                for a, b in zip(*((x,) if isinstance(x, Tensor) else x for x in (actual, expected))):
                    assert (a.int() - b.int()).abs().max() <= 1 and (a != b).float().mean() < 0.01


def test_errors(device):
    x = codes(2, 12, 16).to(device)
    y, uv = x[:, :8], codes(2, 4, 8, 2).to(device)
    cases = [
        ((x,), {"layout": "nv16"}, ValueCheckError, "layout must be one of nv12"),
        ((x,), {"matrix": "bt470"}, ValueCheckError, "matrix must be one of bt601"),
        ((x,), {"color_range": "tv"}, ValueCheckError, "color_range must be"),
        ((x,), {"chroma": "cubic"}, ValueCheckError, "chroma must be"),
        ((x,), {"siting": "right"}, ValueCheckError, "siting must be"),
        ((x.int(),), {}, TypeCheckError, "uint8 or one floating-point type, got torch.int32"),
        ((x,), {"layout": "p010"}, TypeCheckError, "'p010' to be torch.uint16, got torch.uint8"),
        ((x[:, :10],), {}, ShapeError, r"\(B, 3 H / 2, W\)"),
        ((x[:, :11],), {"layout": "i420"}, ShapeError, "even W and H"),
        ((x[..., :15],), {}, ShapeError, "even W"),
        (((y, uv[:, :3]),), {}, ShapeError, r"expected chroma of shape \(2, 4, 8, 2\) for y of shape \(2, 8, 16\)"),
        (((y, uv.float()),), {}, TypeCheckError, "got torch.uint8, torch.float32"),
        (((y, uv, uv),), {}, ShapeError, r"as one tensor or \(y, uv\), got 3 tensors"),
        (((y, uv),), {"layout": "yuy2"}, ShapeError, "as one tensor, got 2"),
        ((y[:, :7, :2],), {"layout": "yuy2"}, ShapeError, r"even W, got \(2, 7, 2\)"),
        ((x[0, :10],), {}, ShapeError, r"got \(10, 16\)"),
        ((x,), {"size": (9, 16)}, ShapeError, r"size within the frame of \(8, 16\)"),
        ((x,), {"std": 0.0}, ValueCheckError, "std above 0"),
        ((x,), {"mean": (0.5, 0.5)}, ValueCheckError, "mean to be a number or three"),
        ((x,), {"dtype": torch.int16}, TypeCheckError, "dtype to be torch.uint8 or a floating-point type"),
        ((x,), {"dtype": torch.uint8, "mean": 0.5}, TypeCheckError, "floating-point dtype of normalized colors"),
    ]
    for args, kwargs, error, message in cases:
        with pytest.raises(error, match=f"^frames_to_rgb: .*{message}"):
            C.frames_to_rgb(*args, **kwargs)
    for call, error in [
        (lambda: C.resize_frames(x, 4, torch.zeros(2, 5, device=device)), ShapeError),
        (lambda: C.resize_frames(x, 4, torch.zeros(3, 4, device=device)), ShapeError),
        (lambda: C.resize_frames(x, 0), ValueCheckError),
        (lambda: C.resize_frames(x, 4, antialias=1), TypeCheckError),
        (lambda: C.warp_frames(x, torch.eye(3, device=device), 4), ShapeError),
        (lambda: C.rgb_to_frames(x), ShapeError),
        (lambda: C.rgb_to_frames(torch.zeros(3, 4, 5)), ShapeError),
        (lambda: C.rgb_to_frames(torch.zeros(3, 4, 4), "p010", dtype=torch.uint8), TypeCheckError),
        (lambda: C.rgb_to_frames(torch.zeros(3, 4, 4, dtype=torch.int32)), TypeCheckError),
    ]:
        with pytest.raises(error, match="^(resize|warp|rgb_to)_(frames): |^rgb_to_frames: "):
            call()


def planes_of(x: Tensor) -> tuple[Tensor, Tensor]:
    """A frame whose chroma is made of its luma."""
    gray = x[:, 0, ::2, ::2]
    if x.dtype == torch.uint8:
        return x, torch.stack([gray, 255 - gray], -1)
    return x, torch.stack([0.4 + gray * 0.2, 0.6 - gray * 0.2], -1)


def of_planes(function):
    def call(x, **kwargs):
        is_luma = isinstance(x, Tensor) and x.dim() == 4 and 0 not in x.shape[1:] and not x.is_complex()
        return function(planes_of(x) if is_luma else x, **kwargs)

    call.__name__ = function.__name__
    return staticmethod(call)


class FrameTests(OpTests):
    operators = ("planes_to_rgb", "planes_to_rgb_backward")
    bytes = True
    channels = 1
    shape = (2, 1, 13, 18)
    small = (1, 1, 4, 5)
    max_size = 9

    def input(self, shape, dtype, device):
        if dtype == torch.uint8:
            return super().input(shape, dtype, device)
        return (0.4 + 0.2 * torch.rand(shape, dtype=torch.float64)).to(dtype).to(device)

    def test_other_integers_become_float32(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.uint8)
        with pytest.raises(TypeCheckError, match="uint8 or one floating-point type"):
            self.call(x.int(), kwargs)

    def test_nan_stays_in_its_window(self, variant, device, backend):
        self.needs_native(backend)  # of boxes the reference is a product of matrices
        x, kwargs = self.setup(variant, device, torch.float32)
        expected = self.call(x, kwargs)
        x[0, 0, 6, 7] = float("nan")
        actual = self.call(x, kwargs)
        assert 3 <= actual[0].isnan().sum() <= 120 and not actual[1].isnan().any()
        self.check(actual[~actual.isnan()], expected[~actual.isnan()])


@pytest.mark.slow
class TestFramesToRgb(FrameTests):
    function = of_planes(C.frames_to_rgb)
    accepted = ("y cut along axis -1", "y cut along axis -2")  # a smaller frame, which is resized


class TestResizeFrames(FrameTests):
    function = of_planes(C.resize_frames)
    variants = [
        {
            "dsize": (5, 7),
            "boxes": lambda x: x.new_tensor([[0.31, 0.42, 0.93 * x.shape[3], 0.87 * x.shape[2]]], dtype=torch.float64),
            **{"antialias": True, "chroma": "linear", "siting": "center"},
        }
    ]
    accepted = ("y cut along axis -1", "y cut along axis -2")


@pytest.mark.slow
class TestWarpFrames(FrameTests):
    function = of_planes(C.warp_frames)
    variants = [
        {
            "dsize": (7, 9),
            "M": lambda x: x.new_tensor(
                [[[0.61, 0.13, 0.37], [-0.11, 0.57, 1.29], [0.003, 0.001, 1]]], dtype=torch.float64
            ),
        }
    ]
    # A matrix without its last row is an affine one.
    accepted = ("y cut along axis -1", "y cut along axis -2", "map cut along axis -2")


@pytest.mark.parametrize("layout", ["nv12", "nv21", "i420", "yuy2", "p010"])
@pytest.mark.parametrize("chroma", ["nearest", *SITINGS])
def test_codes_of_colors(layout, chroma, device):
    """Codes of BT.709 in float64, rounded once, of any size."""
    kwargs = {} if chroma == "nearest" else {"chroma": "linear", "siting": chroma}
    for height, width in [(4, 6), (5, 7), (1, 1), (2, 66), (7, 64)]:
        if layout == "yuy2" and width % 2:
            continue
        image = torch.rand(2, 3, height, width, dtype=torch.float64)
        r, g, b = image.unbind(1)
        luma = 0.2126 * r + 0.7152 * g + 0.0722 * b
        y, u, v = 16 + 219 * luma, 128 + 224 * (b - luma) / 1.8556, 128 + 224 * (r - luma) / 1.5748

        def reduced(x: Tensor, dim: int, site: str) -> Tensor:
            even = torch.arange(0, x.shape[dim], 2)
            before, after = (even - 1).clamp(min=0), (even + 1).clamp(max=x.shape[dim] - 1)
            x, a, b = (x.index_select(dim, i) for i in (even, before, after))
            return x if site == "nearest" else (x + b) / 2 if site == "between" else x / 2 + (a + b) / 4

        across = {"nearest": "nearest", "center": "between"}.get(chroma, "cosited")
        down = {"nearest": "nearest", "topleft": "cosited"}.get(chroma, "between")
        u, v = (reduced(c, 2, across) for c in (u, v))
        if layout != "yuy2":
            u, v = (reduced(c, 1, down) for c in (u, v))
        x, split = image.to(device), layout != "yuy2"
        floats = None if layout == "p010" else C.rgb_to_frames(x, layout, matrix="bt709", split=split, **kwargs)
        integers = C.rgb_to_frames(
            x, layout, matrix="bt709", split=split, dtype=None if layout == "p010" else torch.uint8, **kwargs
        )
        for found_codes, scale in ((floats, 255.0), (integers, 256.0 if layout == "p010" else 1.0)):
            if found_codes is None:
                continue
            if layout == "yuy2":
                parts = [found_codes[..., 0], found_codes[:, :, ::2, 1], found_codes[:, :, 1::2, 1]]
            else:
                luma_codes, *rest = found_codes
                pairs = rest if layout == "i420" else list(rest[0].unbind(-1))
                parts = [luma_codes[:, 0], *(c.squeeze(1) if layout == "i420" else c for c in pairs)]
                parts = [parts[0], parts[2], parts[1]] if layout == "nv21" else parts
            for part, expected in zip(parts, (y, u, v)):
                found = part.cpu().double() * (scale if scale == 255 else 1 / scale)
                limit = 1e-9 if scale == 255 else 0.51 / (4 if scale == 256 else 1)
                assert (found - expected).abs().max() <= limit
    # Images of bytes, of other layouts and single ones.
    levels = codes(2, 3, 6, 8).to(device)
    expected = C.rgb_to_frames(levels, layout)
    assert torch.equal(C.rgb_to_frames(levels.contiguous(memory_format=torch.channels_last), layout), expected)
    assert torch.equal(C.rgb_to_frames(levels[1], layout), expected[1])


def all_codes(image, **kwargs):
    """The codes of all planes of each frame, in one row."""
    planes = C.rgb_to_frames(image, split=True, **kwargs)
    return (
        torch.cat([plane.flatten(1) for plane in planes], 1)
        if isinstance(image, Tensor) and image.dim() == 4
        else planes
    )


all_codes.__name__ = "rgb_to_frames"


class TestRgbToFrames(OpTests):
    function = staticmethod(all_codes)
    operators = ("coded_frames",)
    bytes = True
    channels = 3
    shape = (2, 3, 8, 10)
    small = (1, 3, 4, 6)
    max_size = 9
    variants = [{"chroma": "linear", "siting": "topleft"}, {"matrix": "bt2020", "layout": "i420"}]

    def test_other_integers_become_float32(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.uint8)
        with pytest.raises(TypeCheckError, match="uint8"):
            self.call(x.int(), kwargs)
