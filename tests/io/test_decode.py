"""Decoding of files in memory: one meaning for all backends, EXIF, damaged files in lists."""

from __future__ import annotations

import io
import struct

import cv2
import numpy as np
import PIL.Image
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import kvision as K
from kvision.core.exceptions import ImageError, ShapeError, TypeCheckError, ValueCheckError
from kvision.io import ImageLoadType, decoding
from kvision.io._jpeg import jpeg_header

MODES = {"RGB": "RGB8", "GRAY": "GRAY8", "RGBA": "RGBA8", "UNCHANGED": "UNCHANGED"}


def photograph(height=96, width=141):
    """Smooth colors, edges and a little noise."""
    y, x = torch.meshgrid(torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij")
    image = torch.stack([x, y, 0.5 + 0.5 * torch.sin(9 * x * y)]) * 0.7 + 0.1
    image[:, 20:50, 30:90] = torch.tensor([0.9, 0.2, 0.1])[:, None, None]
    return ((image + 0.02 * torch.randn_like(image)).clamp(0, 1) * 255).byte().movedim(0, -1).numpy()


def file(image, kind="JPEG", mode=None, **options):
    picture, buffer = PIL.Image.fromarray(image), io.BytesIO()
    (picture.convert(mode) if mode else picture).save(buffer, kind, **options)
    return buffer.getvalue()


def turned(orientation):
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    return exif


@pytest.fixture(params=["torchcodec", "torchvision", "opencv"])
def backend(request):
    if isinstance(decoding._made(request.param), Exception):
        pytest.skip(f"{request.param} is not installed")
    return request.param


def test_all_backends_give_the_values_of_opencv(backend):
    """JPEG of every subsampling, progressive, gray, CMYK, stored as RGB, with bytes behind its end; and other formats."""
    rgb = photograph()
    gray = rgb[..., 1].copy()
    files = [
        *(file(rgb, subsampling=s, quality=90, progressive=p) for s in (0, 1, 2) for p in (False, True)),
        file(rgb, subsampling=2) + b"behind the end",
        file(rgb, keep_rgb=True),
        file(gray),
        file(rgb, mode="CMYK"),
        file(rgb, "PNG"),
        file(rgb, "WEBP"),
    ]
    for i, image in enumerate(K.io.decode(files, backend=backend)):
        expected = cv2.imdecode(np.frombuffer(files[i], np.uint8), cv2.IMREAD_COLOR_RGB)
        assert np.array_equal(image.movedim(0, -1), expected), i
    assert K.io.decode(file(gray), mode="UNCHANGED", backend=backend).shape == (1, 96, 141)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation(orientation, backend, device):
    upright = np.zeros((32, 64, 3), np.uint8)
    upright[..., -1] = 200
    upright[:16, :32, 0], upright[16:, 32:, 1] = 250, 120
    stored = upright
    if orientation in (2, 3, 6, 7):
        stored = stored[:, ::-1]
    if orientation in (3, 4, 7, 8):
        stored = stored[::-1]
    if orientation >= 5:
        stored = stored.swapaxes(0, 1)
    stored = np.ascontiguousarray(stored)
    data = file(stored, exif=turned(orientation), quality=100, subsampling=0)
    gray = file(stored[..., 1], exif=turned(orientation), quality=100)
    images = K.io.decode([data, gray], device, backend=backend)
    for image, expected in zip(images, (upright, upright[..., 1:2].repeat(3, -1))):
        assert image.shape == (3, 32, 64) and image.device.type == device.type
        assert np.abs(image.cpu().movedim(0, -1).numpy().astype(int) - expected).max() <= 4


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_of_16_bits(orientation):
    image = np.arange(0, 60000, 5000, dtype=np.uint16).reshape(3, 4)
    turned_image = K.io.decode(file(image, "PNG", exif=turned(orientation)), mode="UNCHANGED")
    levels = K.io.decode(file((image // 1000).astype(np.uint8), "PNG", exif=turned(orientation)), mode="UNCHANGED")
    assert turned_image.dtype == torch.uint16 and turned_image.is_contiguous()
    assert torch.equal(turned_image.int(), 1000 * levels.int())


def test_alpha_is_straight_and_kept():
    """OpenCV multiplies colors of TIFF files of bytes by alpha, drops it for gray ones, and drops a transparent gray of PNG."""
    rgba = np.concatenate([photograph(20, 30), np.linspace(1, 255, 600).reshape(20, 30, 1).astype(np.uint8)], -1)
    files = [file(rgba, "PNG"), file(rgba, "TIFF")]
    expected, unmultiplied = K.io.decode(files, mode="UNCHANGED")
    assert torch.equal(unmultiplied[3], expected[3])
    error = (unmultiplied.int() - expected.int()).abs()
    assert (error <= 128 / expected[3].clamp(min=1) + 1).all()
    over_white, expected = K.io.decode(files[1]), K.io.decode(files[0])
    assert (over_white.int() - expected.int()).abs().max() <= 1
    with pytest.raises(ImageError, match="drops the alpha of gray TIFF"):
        K.io.decode(file(rgba[..., 2:], "TIFF"))
    level = np.arange(12, dtype=np.uint8).reshape(3, 4)
    for gray, transparent in ((level, 5), (level.astype(np.uint16) * 5000, 25000), (level > 5, 0)):
        image = K.io.decode(file(gray, "PNG", transparency=transparent), mode="UNCHANGED")
        top = torch.iinfo(image.dtype).max
        shown = gray != transparent
        assert image.shape == (4, 3, 4) and np.array_equal(image[3].numpy(), shown * np.array(top, image.numpy().dtype))
        assert np.array_equal(image[0].numpy(), gray if gray.dtype != bool else gray * 255)


def test_values_are_those_of_load_image(tmp_path, device):
    """Of every format and mode: gray and RGB, with alpha, 16 bits, floating point."""
    rgb = photograph(20, 30)
    rgba = np.concatenate([rgb, rgb[..., :1]], -1)
    deep = cv2.imencode(".png", rgb.astype(np.uint16) * 250)[1].tobytes()
    files = [file(rgb), file(rgba, "PNG"), file(rgb[..., 0], "PNG"), file(rgb, "BMP"), deep, file(rgb, "PNG", mode="P")]
    files += [cv2.imencode(".tif", rgb.astype(np.float32) / 255)[1].tobytes(), file(rgba, "WEBP", lossless=True)]
    for mode, kind in MODES.items():
        for i, image in enumerate(K.io.decode(files, device, mode, backend="opencv")):
            (tmp_path / "x").write_bytes(files[i])
            loaded = K.io.load_image(tmp_path / "x", ImageLoadType[kind], device)
            assert image.dtype == loaded.dtype and torch.equal(image, loaded), (mode, i)


def test_forms_of_bytes():
    data = file(photograph())
    expected = K.io.decode(data)
    tensor = torch.frombuffer(bytearray(data), dtype=torch.uint8)
    strided = torch.stack([tensor, tensor], 1)[:, 0]
    for same in (bytearray(data), memoryview(data), tensor, strided):
        before = bytes(same) if not isinstance(same, torch.Tensor) else same.clone()
        assert torch.equal(K.io.decode(same), expected)
        assert before == same if isinstance(before, bytes) else torch.equal(before, same)
    for files in ([data, tensor], (data, tensor)):
        first, second = K.io.decode(files)
        assert torch.equal(first, second)
    assert K.io.decode([]) == []


@pytest.mark.parametrize("threads", [1, 2])
def test_a_damaged_file_is_named_or_skipped(threads, backend, device):
    whole = file(photograph())
    files = [
        whole,
        b"",
        b"no image at all",
        whole[: len(whole) // 2],
        file(photograph(), "PNG")[:200],
        whole,
    ]
    reasons = [
        "",
        "the file is empty",
        "it is in no format that OpenCV reads",
        *2 * ["the file is damaged or cut short"],
        "",
    ]
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        images = K.io.decode(files, device, backend=backend, errors="skip")
        assert [image is None for image in images] == [bool(reason) for reason in reasons]
        assert torch.equal(images[0], images[-1])
        for i in range(1, 5):
            with pytest.raises(ImageError, match=rf"^decode: cannot decode files\[1\]: {reasons[i]}"):
                K.io.decode([whole, files[i], b""], device, backend=backend)
    finally:
        torch.set_num_threads(before)
    assert K.io.decode(b"", device, backend=backend, errors="skip") is None
    with pytest.raises(ImageError, match="^decode: cannot decode the file: the file is empty$"):
        K.io.decode(b"", device, backend=backend)


def test_what_a_mode_cannot_hold(tmp_path):
    PIL.Image.fromarray(np.arange(12, dtype=np.int32).reshape(3, 4)).save(tmp_path / "x.tif")
    data = (tmp_path / "x.tif").read_bytes()
    assert K.io.decode(data, mode="UNCHANGED").dtype == torch.int32
    with pytest.raises(
        ImageError, match=r'files\[0\]: it holds 1 channels of torch.int32; decode it with mode="UNCHANGED"'
    ):
        K.io.decode([data])
    assert K.io.decode([data], errors="skip") == [None]


@pytest.mark.parametrize(
    ("args", "options", "error", "text"),
    [
        (("photo.jpg",), {}, TypeCheckError, "decode: expected files to be bytes or a uint8 tensor, got str"),
        (([b"", 3],), {}, TypeCheckError, r"expected files\[1\] to be bytes .* got int"),
        ((torch.zeros(3),), {}, TypeCheckError, "expected files of bytes in CPU memory, got torch.float32 on cpu"),
        ((torch.zeros(2, 3, dtype=torch.uint8),), {}, ShapeError, r"expected files of shape \(N,\), got \(2, 3\)"),
        ((b"",), {"mode": "rgb"}, ValueCheckError, "mode must be one of RGB, GRAY, RGBA, UNCHANGED; got 'rgb'"),
        ((b"",), {"errors": "ignore"}, ValueCheckError, "errors must be one of raise, skip; got 'ignore'"),
        (
            (b"",),
            {"backend": "pil"},
            ValueCheckError,
            "backend must be one of torchcodec, torchvision, opencv; got 'pil'",
        ),
    ],
)
def test_wrong_arguments(args, options, error, text):
    with pytest.raises(error, match=text):
        K.io.decode(*args, **options)


def test_a_backend_that_does_not_load(monkeypatch):
    def fails():
        raise OSError("undefined symbol")

    monkeypatch.setattr(decoding, "_DECODERS", {"torchcodec": fails, "opencv": decoding._OpenCV})
    decoding._made.cache_clear()
    try:
        assert K.io.decode(file(photograph())).shape == (3, 96, 141)
        with pytest.raises(ImportError, match="decode: backend 'torchcodec' does not load here: undefined symbol"):
            K.io.decode(b"", backend="torchcodec")
    finally:
        decoding._made.cache_clear()


def test_headers():
    rgb = photograph(16, 16)
    adobe = struct.pack(">BBH5sHHHB", 0xFF, 0xEE, 14, b"Adobe", 100, 0, 0, 0)  # says that three components are RGB
    plain = file(rgb, exif=turned(7))
    assert jpeg_header(memoryview(plain)) == (3, 7)
    assert jpeg_header(memoryview(file(rgb[..., 0].copy()))) == (1, 1)
    without_jfif = plain[:2] + plain[2 + 2 + plain[4] * 256 + plain[5] :]
    for other in (
        file(rgb, mode="CMYK"),
        file(rgb, "PNG"),
        plain[:-2],
        without_jfif[:2] + adobe + without_jfif[2:],
        b"",
    ):
        assert jpeg_header(memoryview(other)) is None


@given(st.binary(max_size=60), st.integers(2, 700), st.integers(2, 700))
def test_any_bytes_are_a_header_or_none(junk, position, end):
    data = bytearray(file(np.zeros((8, 8, 3), np.uint8)))
    data[position : position + len(junk)] = junk
    header = jpeg_header(memoryview(data[:end] + b"\xff\xd9"))
    assert header is None or (header.components in (1, 3) and 1 <= header.orientation <= 8)


def test_nvjpeg_agrees_where_chroma_is_whole(device, backend):
    """4:4:4 and gray within 3 levels, .5 on average; of 4:2:0 the mean, and luma, which has all of its pixels."""
    if device.type != "cuda" or backend == "opencv":
        pytest.skip("nvJPEG runs on CUDA")
    rgb = photograph(240, 333)
    files = [file(rgb, subsampling=0, quality=95), file(rgb[..., 1].copy()), file(rgb, subsampling=2, quality=95)]
    differences = [
        (ours.cpu().double() - theirs.double()).abs()
        for ours, theirs in zip(K.io.decode(files, device, backend=backend), K.io.decode(files, backend="opencv"))
    ]
    for difference in differences[:2]:
        assert difference.max() <= 3 and difference.mean() <= 0.5
    assert differences[2].mean() <= 3


def test_photographs_of_all_backends(data, backend):
    for path in sorted((data / "photos").glob("kodim*.png")):
        photo = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
        for subsampling in (0, 2):
            encoded = file(photo, quality=88, subsampling=subsampling)
            assert torch.equal(K.io.decode(encoded, backend=backend), K.io.decode(encoded, backend="opencv"))
